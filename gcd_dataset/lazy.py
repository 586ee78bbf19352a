"""Names of a package that are imported on first use."""

import sys
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from typing import Any

ROOT = "gcd_dataset."


def lazy_names(
    package: str, names_of_module: Mapping[str, Iterable[str]]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """``__getattr__`` and ``__dir__`` (PEP 562) of a package.

    ``names_of_module``: module, with its whole name or below the package, to the names that it defines. A module is
    imported when one of its names is first used. ``dir`` lists ``__all__``.
    """
    module_of_name = {name: module for module, names in names_of_module.items() for name in names}

    def get(name: str) -> Any:
        if name not in module_of_name:
            raise AttributeError(f"module {package} has no attribute {name}")
        module = module_of_name[name]
        value = getattr(import_module(module if module.startswith(ROOT) else f"{package}.{module}"), name)
        setattr(sys.modules[package], name, value)  # found without this function from now on
        return value

    return get, lambda: sorted(sys.modules[package].__all__)
