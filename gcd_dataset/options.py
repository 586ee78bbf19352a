"""Options defined once, as the annotated fields of a frozen dataclass.

The command line, TOML files and keyword arguments take names, types, defaults, units and help from these fields.
"""

import argparse
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from gcd_dataset.errors import ConfigError, did_you_mean, shown
from gcd_dataset.jsonfile import read_toml


@dataclass(frozen=True)
class Option:
    """Help and unit of a field, as in ``Annotated[float, Option("length of edges", unit="cm")]``."""

    help: str
    unit: str = ""


@dataclass(frozen=True)
class OptionField:
    """An option of a dataclass: name, type, choices and default."""

    name: str
    kind: type
    """Type of its values; ``str`` for an option with choices."""
    choices: tuple[str, ...] | None
    default: Any
    option: Option

    @property
    def flag(self) -> str:
        """Its name on the command line: ``--on-fail`` for ``on_fail``."""
        return "--" + self.name.replace("_", "-")

    @property
    def help(self) -> str:
        """Help text with unit and default."""
        unit = f" [{self.option.unit}]" if self.option.unit else ""
        return f"{self.option.help}{unit} (default: {self.default})"


def options_of(config: type) -> tuple[OptionField, ...]:
    """The options of a dataclass: its fields that are ``Annotated`` with an ``Option``; each has a default."""
    hints = get_type_hints(config, include_extras=True)
    options = []
    for entry in fields(config):
        if get_origin(hints[entry.name]) is Annotated:
            kind, option = get_args(hints[entry.name])
            choices = get_args(kind) if get_origin(kind) is Literal else None
            options.append(OptionField(entry.name, str if choices else kind, choices, entry.default, option))
    return tuple(options)


def add_options(
    parser: argparse.ArgumentParser, config: type, more_choices: Mapping[str, Collection[str]] | None = None
) -> None:
    """Add the scalar options of a dataclass to a parser; an option that is not given parses as ``None``.

    ``more_choices``: option name to further values that only the command line accepts.
    """
    for entry in options_of(config):
        if entry.kind is bool:
            parser.add_argument(entry.flag, action=argparse.BooleanOptionalAction, help=entry.help)
        if entry.kind not in (str, int, float):
            continue
        choices = None if entry.choices is None else (*(more_choices or {}).get(entry.name, ()), *entry.choices)
        metavar = None if choices else (entry.option.unit or entry.name.partition("_")[2] or entry.name).upper()
        parser.add_argument(entry.flag, type=entry.kind, choices=choices, metavar=metavar, help=entry.help)


def given_options(options: argparse.Namespace, config: type) -> dict[str, Any]:
    """Name to value of the dataclass's options that were given on the command line."""
    values = {entry.name: getattr(options, entry.name, None) for entry in options_of(config)}
    return {name: value for name, value in values.items() if value is not None}


def read_options(path: Path, known: Collection[str]) -> dict[str, Any]:
    """Name to value of the options in a TOML file; ``-`` counts as ``_``. Raises ``ConfigError`` for an unknown one."""
    values = {name.replace("-", "_"): value for name, value in read_toml(path).items()}
    if unknown := sorted(set(values) - set(known)):
        nearest = did_you_mean(unknown[0], known)
        raise ConfigError(
            f"{path}: no option is called {shown(unknown[0])}: there are {', '.join(sorted(known))}{nearest}"
        )
    return values


def require_options(values: Mapping[str, Any], config: type) -> None:
    """Raise ``ConfigError`` for a name that is not an option of the dataclass."""
    known = [entry.name for entry in options_of(config)]
    for name in values:
        if name not in known:
            raise ConfigError(f"no option {shown(name)}: there are {', '.join(known)}{did_you_mean(name, known)}")
