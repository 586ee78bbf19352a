"""Names of a package that are imported on first use."""

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def lazy_names(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """``__getattr__`` and ``__dir__`` (PEP 562) of a package.

    The names are those that its ``__init__.py`` imports under ``if TYPE_CHECKING:``; a module is imported when one of
    its names is first used. ``dir`` lists ``__all__``.
    """
    module_of_name = {
        entry.asname or entry.name: line.module
        for block in ast.parse(Path(str(sys.modules[package].__file__)).read_text("utf-8")).body
        if isinstance(block, ast.If) and isinstance(block.test, ast.Name) and block.test.id == "TYPE_CHECKING"
        for line in block.body
        if isinstance(line, ast.ImportFrom)
        for entry in line.names
    }

    def get(name: str) -> Any:
        if (module := module_of_name.get(name)) is None:
            raise AttributeError(f"module {package} has no attribute {name}")
        value = getattr(import_module(module), name)
        setattr(sys.modules[package], name, value)  # found without this function from now on
        return value

    return get, lambda: sorted(sys.modules[package].__all__)
