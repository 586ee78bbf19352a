"""Parameter spaces: the values of one design parameter, a number, an integer, a choice or a flag."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import Enum
from itertools import repeat
from math import ceil, floor
from reprlib import repr as short
from typing import Any, Self

import numpy as np

from gcd_dataset.errors import ConfigError

NONE = "none"  # in a file for ``None``: TOML has no null


@dataclass(frozen=True)
class Space(ABC):
    """The allowed values of one parameter, and the probability that a draw keeps its default."""

    default: Any
    keep: float | None
    """Probability of the default; ``None``: the default is drawn like any other value."""

    @property
    @abstractmethod
    def kind(self) -> str:
        """Its type in a design file: ``float``, ``int``, ``bool``, ``select`` or ``select_null``."""

    @property
    @abstractmethod
    def range(self) -> list[Any]:
        """Its range in a design file, as plain values: both ends for a number, all options for a choice."""

    @abstractmethod
    def accepts(self, value: Any) -> bool:
        """Whether the parameter can take this value."""

    @abstractmethod
    def read(self, value: Any) -> Any:
        """The parameter's value from a plain value, such as an enum member from its name. Raises ``ConfigError``."""

    @abstractmethod
    def within(self, value: Any, low: float, high: float) -> bool:
        """Whether a value lies between two numbers; always true for a choice."""

    @abstractmethod
    def pick(self, rng: np.random.Generator, low: float, high: float) -> Any:
        """A uniform value between two numbers; an integer or choice with a ``keep`` excludes its default."""

    @abstractmethod
    def narrowed(self, values: Sequence[Any]) -> Self:
        """The space restricted to a range, given by its two ends, or to some of its options.

        ``keep`` becomes ``None`` if the default is excluded. Raises ``ConfigError`` for values outside this space.
        """

    @abstractmethod
    def with_keep(self, keep: float) -> Self:
        """The space with another probability of its default. Raises ``ConfigError`` for a space left empty.

        If a narrowed range excludes the default, the nearer end of the range becomes the default.
        """

    def draw(self, rng: np.random.Generator, low: float = -np.inf, high: float = np.inf) -> Any:
        """A value between ``low`` and ``high``: the default with probability ``keep``, otherwise ``pick``."""
        kept = self.keep is not None and rng.random() < self.keep
        return self.default if kept and self.within(self.default, low, high) else self.pick(rng, low, high)

    def _checked(self, value: Any) -> Any:
        if not self.accepts(value):
            raise ConfigError(f"is {short(plain(value))}, not {self}")
        return value


@dataclass(frozen=True)
class Real(Space):
    """A real number from ``low`` to ``high``."""

    low: float
    high: float

    @property
    def kind(self) -> str:
        return "float"

    @property
    def range(self) -> list[Any]:
        return [self.low, self.high]

    def accepts(self, value: Any) -> bool:
        return isinstance(value, int | float) and not isinstance(value, bool) and self.low <= value <= self.high

    def read(self, value: Any) -> float:
        if isinstance(value, str):  # YAML takes 1e-05 for a text
            with suppress(ValueError):
                return self.read(float(value))
        return float(self._checked(value))

    def within(self, value: Any, low: float, high: float) -> bool:
        return bool(low <= value <= high)

    def pick(self, rng: np.random.Generator, low: float, high: float) -> float:
        return float(rng.uniform(*self._clipped(low, high)))

    def narrowed(self, values: Sequence[Any]) -> Self:
        if len(values) != 2:
            raise ConfigError(f"has a range of {len(values)} values: give two, the lowest and the highest")
        low, high = (self.read(value) for value in values)
        if low > high:
            raise ConfigError(f"has a range in descending order: write [{high:g}, {low:g}]")
        return replace(self, low=low, high=high, keep=self.keep if low <= self.default <= high else None)

    def with_keep(self, keep: float) -> Self:
        nearest = min(max(self.default, self.low), self.high)
        if keep == 0 and nearest != self.default:
            return self
        if keep == 0 and self.low == self.high:
            raise ConfigError(f"has no value left: keep is 0, and its range holds {nearest:g} alone")
        return replace(self, default=nearest, keep=keep)

    def _clipped(self, low: float, high: float) -> tuple[float, float]:
        low, high = (min(max(limit, self.low), self.high) for limit in (low, high))
        return low, max(low, high)

    def __str__(self) -> str:
        return f"a number from {self.low:g} to {self.high:g}"


@dataclass(frozen=True)
class Integer(Real):
    """An integer from ``low`` to ``high``, both included."""

    @property
    def kind(self) -> str:
        return "int"

    def accepts(self, value: Any) -> bool:
        return super().accepts(value) and float(value).is_integer()

    def read(self, value: Any) -> int:
        return int(super().read(value))

    def pick(self, rng: np.random.Generator, low: float, high: float) -> int:
        low, high = self._clipped(low, high)
        values = range(ceil(low), max(ceil(low), floor(high)) + 1)
        others = [value for value in values if self.keep is None or value != self.default] or values
        return others[int(rng.integers(len(others)))]

    def __str__(self) -> str:
        return f"a whole number from {self.low:g} to {self.high:g}"


@dataclass(frozen=True)
class Choice(Space):
    """One of several options: names, numbers, or ``None`` for none of them."""

    options: tuple[Any, ...]
    weights: tuple[int, ...] = ()
    """Sampling weight of each option; empty if all weigh 1."""

    @property
    def weighted_options(self) -> tuple[Any, ...]:
        """The options, each repeated by its weight; ``pick`` draws from them uniformly."""
        return (
            tuple(option for option, weight in self._weighed() for _ in range(weight)) if self.weights else self.options
        )

    @property
    def kind(self) -> str:
        return "select_null" if None in self.options else "select"

    @property
    def range(self) -> list[Any]:
        return [plain(option) for option, weight in self._weighed() if weight]

    def accepts(self, value: Any) -> bool:
        return any(_same(value, option) for option in self.options)

    def read(self, value: Any) -> Any:
        if isinstance(value, str) and value.lower() == NONE and self.accepts(None):
            return None
        return self._checked(next((option for option in self.options if _same(plain(option), value)), value))

    def within(self, value: Any, low: float, high: float) -> bool:
        return True

    def pick(self, rng: np.random.Generator, low: float, high: float) -> Any:
        options = self.weighted_options
        others = [option for option in options if self.keep is None or not _same(option, self.default)] or options
        return others[int(rng.integers(len(others)))]

    def narrowed(self, values: Sequence[Any]) -> Self:
        wanted = [self.read(value) for value in values]
        kept = [(o, weight) for o, weight in self._weighed() if any(_same(o, value) for value in wanted)]
        options = tuple(option for option, _ in kept)
        if not options:
            raise ConfigError("has no option left: name one or more")
        left_in = any(_same(self.default, option) for option in options)
        weights = tuple(max(weight, 1) for _, weight in kept) if self.weights else ()
        return replace(self, options=options, weights=weights, keep=self.keep if left_in else None)

    def with_keep(self, keep: float) -> Self:
        drawn = self.narrowed(self.range)
        left_in = drawn.accepts(self.default)
        if keep == 0 and left_in and len(drawn.options) == 1:
            raise ConfigError(f"has no option left: keep is 0, and {plain(self.default)} is the only option")
        if keep > 0 and not left_in:
            raise ConfigError(f"has keep, but no option {plain(self.default)}, its default: add it, or leave keep out")
        return replace(drawn, keep=keep if left_in else None)

    def only(self, *, present: bool) -> Self:
        """The choice without ``None`` (``present``), or of ``None`` alone."""
        return self.narrowed([option for option in self.range if (option is not None) == present])

    def _weighed(self) -> Iterable[tuple[Any, int]]:
        return zip(self.options, self.weights or repeat(1), strict=False)

    def __str__(self) -> str:
        return "one of " + ", ".join(str(plain(option)) for option in self.options)


@dataclass(frozen=True)
class Flag(Choice):
    """Yes or no."""

    @property
    def kind(self) -> str:
        return "bool"


def plain(value: Any) -> Any:
    """The value in a design file: an enum's member as its value, any other value itself."""
    return value.value if isinstance(value, Enum) else value


def _same(value: Any, option: Any) -> bool:
    """Whether both are the same option: 0 and 0.0 are, 0 and ``False`` are not."""
    return value is option or (value == option and isinstance(value, bool) == isinstance(option, bool))
