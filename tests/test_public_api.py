"""Public names, their signatures and the options of ``gcd`` are the recorded ones.

After a change that is meant, ``python -m tests.test_public_api`` records them again.
"""

import argparse
import difflib
import inspect
import re
from collections.abc import Callable, Iterator
from enum import Enum
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, is_typeddict

from gcd_dataset import __version__
from gcd_dataset.cli import _parser

ROOT = Path(__file__).resolve().parent.parent
RECORDED = ROOT / "tests" / "data" / "recorded" / "public_api.txt"
DOCUMENTED = re.compile(r"^::: (\S+)$", re.MULTILINE)
CALLED = ("__call__", "__getitem__", "__iter__", "__len__")  # public, though their names begin with _
LONG = 100  # characters: of a longer default only the type is recorded
ALIASES = ("typing", "types", "collections.abc")  # modules of the types of type aliases


def test_names_and_options_are_the_recorded_ones() -> None:
    recorded, found = RECORDED.read_text().splitlines(), public_api().splitlines()
    changes = "\n".join(difflib.unified_diff(recorded, found, "recorded", "found", lineterm="", n=0))
    assert not changes, f"{changes}\nrecord a change that is meant: python -m tests.test_public_api"


def public_api() -> str:
    """A line for each public name of the documented modules, and for each option of the command line."""
    pages = (page.read_text() for page in (ROOT / "docs" / "api").glob("*.md"))
    faces = sorted({"gcd_dataset", *(face for page in pages for face in DOCUMENTED.findall(page))})
    seen: dict[int, str] = {}
    return "\n".join([*(line for face in faces for line in face_lines(face, seen)), *command_lines()]) + "\n"


def face_lines(face: str, seen: dict[int, str]) -> Iterator[str]:
    """The public names of a module. ``seen``: id to first name of the classes and functions listed so far."""
    module = import_module(face)
    for name in getattr(module, "__all__", ()):
        path, value = f"{face}.{name}", getattr(module, name, None)
        if value is None or isinstance(value, ModuleType):
            yield from face_lines(path, seen)
        elif not (inspect.isclass(value) or inspect.isroutine(value) or hasattr(value, "__wrapped__")):
            yield f"{path}: {'alias' if type(value).__module__ in ALIASES else type(value).__name__}"
        elif seen.setdefault(id(value), path) != path:
            yield f"{path}: {seen[id(value)]}"
        else:
            yield from class_lines(path, value) if inspect.isclass(value) else [path + signature(value)]


def class_lines(path: str, kind: type) -> Iterator[str]:
    """A class and its public members; of inherited ones those that the package defines."""
    own = [base for base in kind.__mro__ if base.__module__.startswith("gcd_dataset")]
    members = {name for base in own for name in vars(base)}
    called = signature(kind) if members & {"__init__", "__new__"} else ""
    entries = kind.__annotations__ if is_typeddict(kind) else getattr(kind, "__members__", {})
    yield path if entries else path + called
    for name, entry in entries.items():
        yield f"{path}.{name} = {entry.value!r}" if isinstance(entry, Enum) else f"{path}.{name}"
    fields = {*entries, *(inspect.signature(kind).parameters if called else ())}
    for name in sorted(members - fields):
        if name in CALLED or not name.startswith("_"):
            member = getattr(kind, name)
            yield f"{path}.{name}" + (signature(member) if callable(member) else "")


def signature(function: Callable[..., Any]) -> str:
    """Names, kinds and defaults of the parameters, without the sections that the wardrobe adds to a design."""
    found = inspect.signature(function)
    added = {
        entry.name for entry in getattr(function, "__dataclass_fields__", {}).values() if "added" in entry.metadata
    }
    parameters = [
        parameter.replace(annotation=parameter.empty, default=shown(parameter.default))
        for name, parameter in found.parameters.items()
        if name not in added
    ]
    return str(found.replace(parameters=parameters, return_annotation=found.empty))


def shown(default: Any) -> Any:
    """A default that prints in a few words, the same in every process."""
    if default is inspect.Parameter.empty:
        return default
    if default is __version__:
        return Word("__version__")
    text = default.__name__ if inspect.isroutine(default) else repr(default)
    return Word(text if len(text) < LONG else f"{type(default).__name__}(...)")


class Word(str):
    """A text that is its own ``repr``."""

    __slots__ = ()
    __repr__ = str.__str__


def command_lines() -> Iterator[str]:
    """The options and arguments of each verb of ``gcd``, and of its actions."""
    verbs = list(_parser()[1].items())
    for verb, parser in verbs:
        if parser.add_slow_options is not None:
            parser.add_slow_options()
        for action in parser._actions:
            if isinstance(action, argparse._SubParsersAction):
                verbs += [(f"{verb} {name}", each) for name, each in action.choices.items()]
            elif action.default is not argparse.SUPPRESS:
                facts = {name: getattr(action, name) for name in ("nargs", "const", "choices", "required")}
                words = [f"{name}={value!r}" for name, value in facts.items() if value]
                names = ", ".join(action.option_strings) or action.metavar
                yield " ".join([f"gcd {verb} {names}", f"default={action.default!r}", *words])


if __name__ == "__main__":
    RECORDED.write_text(public_api())
