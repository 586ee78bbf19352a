"""Options written in one place: a frozen dataclass whose fields say, beside their types, what they are.

The command line, TOML files and keywords of functions take names, types, defaults, units and help from there.
"""

import argparse
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from gcd_dataset.errors import ConfigError, did_you_mean, shown
from gcd_dataset.tomlfile import read_toml

__all__ = ["Option", "OptionField", "add_options", "given_options", "options_of", "read_options", "require_options"]


@dataclass(frozen=True)
class Option:
    """What stands beside the type of a field, as ``Annotated[float, Option("length of edges", unit="cm")]``."""

    help: str
    unit: str = ""


@dataclass(frozen=True)
class OptionField:
    """An option of a dataclass."""

    name: str
    kind: type
    """Of its values; ``str`` where there are choices."""
    choices: tuple[str, ...] | None
    default: Any
    option: Option

    @property
    def flag(self) -> str:
        """Its name on the command line."""
        return "--" + self.name.replace("_", "-")

    @property
    def help(self) -> str:
        """What it is, its unit and its default."""
        unit = f" [{self.option.unit}]" if self.option.unit else ""
        return f"{self.option.help}{unit} (default: {self.default})"


def options_of(config: type) -> tuple[OptionField, ...]:
    """The options of a dataclass whose fields are ``Annotated`` with an ``Option`` and have a default."""
    hints = get_type_hints(config, include_extras=True)
    found = []
    for entry in fields(config):
        if get_origin(hints[entry.name]) is Annotated:
            kind, option = get_args(hints[entry.name])
            choices = get_args(kind) if get_origin(kind) is Literal else None
            found.append(OptionField(entry.name, str if choices else kind, choices, entry.default, option))
    return tuple(found)


def add_options(
    parser: argparse.ArgumentParser, config: type, more_choices: Mapping[str, Collection[str]] | None = None
) -> None:
    """Give a parser the options of a dataclass that fit in a word; ``None`` where one is not given.

    ``more_choices``: option to values that it takes on the command line alone.
    """
    for found in options_of(config):
        if found.kind not in (str, int, float):
            continue
        choices = None if found.choices is None else (*(more_choices or {}).get(found.name, ()), *found.choices)
        metavar = None if choices else (found.option.unit or found.name.partition("_")[2] or found.name).upper()
        parser.add_argument(found.flag, type=found.kind, choices=choices, metavar=metavar, help=found.help)


def given_options(options: argparse.Namespace, config: type) -> dict[str, Any]:
    """The options of a dataclass that stand on a command line."""
    values = {found.name: getattr(options, found.name, None) for found in options_of(config)}
    return {name: value for name, value in values.items() if value is not None}


def read_options(path: Path, known: Collection[str]) -> dict[str, Any]:
    """The options in a TOML file, with ``-`` or ``_`` in their names. Raises ``ConfigError`` for one not known."""
    values = {name.replace("-", "_"): value for name, value in read_toml(path).items()}
    if unknown := sorted(set(values) - set(known)):
        nearest = did_you_mean(unknown[0], known)
        raise ConfigError(
            f"{path}: no option is called {shown(unknown[0])}: there are {', '.join(sorted(known))}{nearest}"
        )
    return values


def require_options(values: Mapping[str, Any], config: type) -> None:
    """Raise ``ConfigError`` for a name that no option of a dataclass has."""
    known = [found.name for found in options_of(config)]
    for name in values:
        if name not in known:
            raise ConfigError(f"no option {shown(name)}: there are {', '.join(known)}{did_you_mean(name, known)}")
