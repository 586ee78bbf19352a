"""Design spaces: parameters that say all about themselves in one place, and how chance chooses them.

A design is a frozen dataclass derived from ``Design``, its fields made by ``real``, ``integer``, ``choice``, ``flag``
and, for a design inside a design, ``part``. A value outside its range is refused when the design is made.

>>> from dataclasses import dataclass
>>> @dataclass(frozen=True)
... class HemDesign(Design):
...     depth: float = real(2.0, 1.0, 5.0, keep=0.5)
...     rows: int = integer(1, 1, 3)
>>> drawn = draw(HemDesign, np.random.default_rng(1))
>>> round(drawn.depth, 3), drawn.rows
(4.802, 1)
>>> to_dict(HemDesign())
{'depth': 2.0, 'rows': 1}
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import Enum
from typing import Any, TypeVar

import numpy as np

from gcd_dataset.errors import ConfigError

__all__ = ["Design", "choice", "draw", "flag", "from_dict", "integer", "part", "real", "to_dict"]

D = TypeVar("D", bound="Design")


@dataclass(frozen=True)
class _Space(ABC):
    """The values one parameter may take, and the probability with which a draw keeps its default."""

    default: Any
    keep: float | None
    """None: the default is not favoured, and may be drawn like any other value."""

    @abstractmethod
    def holds(self, value: Any) -> bool:
        """Whether the parameter can take this value."""

    @abstractmethod
    def within(self, value: Any, low: float, high: float) -> bool:
        """Whether a value lies between two numbers; a choice always does."""

    @abstractmethod
    def pick(self, rng: np.random.Generator, low: float, high: float) -> Any:
        """A value between two numbers, all equally likely, without a default that ``keep`` already favours."""

    def draw(self, rng: np.random.Generator, low: float = -np.inf, high: float = np.inf) -> Any:
        """A value between ``low`` and ``high``: the default with probability ``keep``, else uniform over the others."""
        kept = self.keep is not None and rng.random() < self.keep
        return self.default if kept and self.within(self.default, low, high) else self.pick(rng, low, high)


@dataclass(frozen=True)
class _Real(_Space):
    low: float
    high: float

    def holds(self, value: Any) -> bool:
        return isinstance(value, int | float) and not isinstance(value, bool) and self.low <= value <= self.high

    def within(self, value: Any, low: float, high: float) -> bool:
        return bool(low <= value <= high)

    def pick(self, rng: np.random.Generator, low: float, high: float) -> float:
        low, high = (min(max(limit, self.low), self.high) for limit in (low, high))
        return float(rng.uniform(low, max(low, high)))

    def __str__(self) -> str:
        return f"a number from {self.low:g} to {self.high:g}"


@dataclass(frozen=True)
class _Integer(_Real):
    def holds(self, value: Any) -> bool:
        return super().holds(value) and float(value).is_integer()

    def pick(self, rng: np.random.Generator, low: float, high: float) -> int:
        values = range(int(np.ceil(max(low, self.low))), int(np.floor(min(high, self.high))) + 1)
        others = [value for value in values if self.keep is None or value != self.default]
        return int(rng.choice(others or [self.default]))

    def __str__(self) -> str:
        return f"a whole number from {self.low:g} to {self.high:g}"


@dataclass(frozen=True)
class _Choice(_Space):
    options: tuple[Any, ...]

    def holds(self, value: Any) -> bool:
        return any(value is option for option in self.options)

    def within(self, value: Any, low: float, high: float) -> bool:
        return True

    def pick(self, rng: np.random.Generator, low: float, high: float) -> Any:
        others = [option for option in self.options if self.keep is None or option is not self.default]
        return others[int(rng.integers(len(others)))]

    def __str__(self) -> str:
        return "one of " + ", ".join(str(_plain(option)) for option in self.options)


@dataclass(frozen=True)
class Design:
    """A frozen bundle of parameters. Raises ``ConfigError`` for a value that its parameter cannot take."""

    def __post_init__(self) -> None:
        for entry in fields(self):
            space, value = entry.metadata.get("space"), getattr(self, entry.name)
            if space is not None and not space.holds(value):
                raise ConfigError(f"{type(self).__name__}: {entry.name} is {_plain(value)}, not {space}")


def real(default: float, low: float, high: float, *, keep: float | None = None, key: str | None = None) -> Any:
    """A number; ``key`` is its name in a design file where that differs from the field's."""
    return _parameter(_Real(default, keep, low, high), key)


def integer(default: int, low: int, high: int, *, keep: float | None = None, key: str | None = None) -> Any:
    """A whole number, both ends included."""
    return _parameter(_Integer(default, keep, low, high), key)


def choice(default: Enum | None, *options: Enum | None, keep: float | None = None, key: str | None = None) -> Any:
    """One of several options; ``None`` stands for none of them."""
    return _parameter(_Choice(default, keep, options), key)


def flag(default: bool, *, keep: float | None = None, key: str | None = None) -> Any:
    """Yes or no."""
    return _parameter(_Choice(default, keep, (True, False)), key)


def part(kind: type[Design], *, key: str | None = None) -> Any:
    """A design inside a design."""
    return field(default_factory=kind, metadata={"part": kind, "key": key})


def _parameter(space: _Space, key: str | None) -> Any:
    return field(default=space.default, metadata={"space": space, "key": key})


def draw(kind: type[D], rng: np.random.Generator, *, within: Mapping[str, tuple[float, float]] | None = None) -> D:
    """A random design, its fields drawn in their order; ``within`` narrows the ranges of some by name.

    Where a narrowed range misses the parameter's own, the nearest value that the parameter can take is drawn.
    """
    limits = within or {}
    values = {}
    for entry in fields(kind):
        if "part" in entry.metadata:
            values[entry.name] = draw(entry.metadata["part"], rng)
        else:
            values[entry.name] = entry.metadata["space"].draw(rng, *limits.get(entry.name, ()))
    return kind(**values)


def to_dict(design: Design) -> dict[str, Any]:
    """The design as nested plain values, under the names of a design file."""
    values = {_key(entry): getattr(design, entry.name) for entry in fields(design)}
    return {key: to_dict(value) if isinstance(value, Design) else _plain(value) for key, value in values.items()}


def from_dict(kind: type[D], values: Mapping[str, Any], *, path: str = "") -> D:
    """The design of nested plain values; what is not named keeps its default.

    Raises ``ConfigError`` with the path of a name that no parameter has, or of a value that it cannot take.
    """
    entries = {_key(entry): entry for entry in fields(kind)}
    if unknown := [key for key in values if key not in entries]:
        raise ConfigError(f"no design parameter is called {path}{unknown[0]}: there are {', '.join(entries)}")
    return kind(**{entries[key].name: _read(entries[key], value, f"{path}{key}") for key, value in values.items()})


def _read(entry: Any, value: Any, path: str) -> Any:
    if "part" in entry.metadata:
        if not isinstance(value, Mapping):
            raise ConfigError(f"{path} is {value!r}, not a table of parameters")
        return from_dict(entry.metadata["part"], value, path=f"{path}.")
    space = entry.metadata["space"]
    if isinstance(space, _Choice):
        options = {_plain(option): option for option in space.options}
        value = options[value] if isinstance(value, str | bool | None) and value in options else value
    if not space.holds(value):
        raise ConfigError(f"{path} is {value!r}, not {space}")
    return value


def _key(entry: Any) -> str:
    return str(entry.metadata.get("key") or entry.name)


def _plain(value: Any) -> Any:
    return value.value if isinstance(value, Enum) else value
