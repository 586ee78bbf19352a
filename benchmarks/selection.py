"""How far a sampler's rules move the distribution of a parameter: proposed against accepted values."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from math import pi, sqrt
from typing import Any, TypeAlias

from gcd_dataset.generator.garments.parameter import Choice
from gcd_dataset.generator.garments.space import Leaf

UNUSED = "unused"
"""The value of a parameter in a design that does not use it."""
FEWEST = 20  # least number of designs for a comparison
BINS = 20  # equal parts of a number's range
RARE = 0.2  # ratio of the accepted to the proposed share of a value: smaller for a rare value
Bin: TypeAlias = int | str
"""Number of one of ``BINS`` parts of the range; or the name of an option, of the default, or ``UNUSED``."""


@dataclass(frozen=True)
class Shift:
    """How far selection moves the distribution of a parameter."""

    moved: float
    """Total variation between proposed and accepted values, 0 to 1."""
    noise: float
    """The expected ``moved`` if designs were changed or accepted at random."""
    rare: tuple[str, ...]
    """Proposed values with an accepted share below ``RARE`` times the proposed share."""


def shift(leaf: Leaf, proposed: Sequence[Any], accepted: Sequence[Any], *, paired: bool) -> Shift:
    """The shift of one parameter.

    ``paired``: value k was accepted in place of proposed value k; otherwise the accepted values are some of the
    proposed ones.
    """
    before, after = ([_bin(leaf, value) for value in values] for values in (proposed, accepted))
    old, new = (Counter(used(names)) for names in (before, after))
    shares = {name: (old[name] / max(old.total(), 1), new[name] / max(new.total(), 1)) for name in old | new}
    if paired:
        changed = Counter(name for pair in zip(before, after, strict=True) if pair[0] != pair[1] for name in pair)
        variances = [changed[name] / max(new.total(), 1) ** 2 for name in shares]
    else:
        left_out = max(1 / max(new.total(), 1) - 1 / max(old.total(), 1), 0.0)
        variances = [share * (1 - share) * left_out for share, _ in shares.values()]
    rare = [name for name, (share, kept) in shares.items() if old[name] >= FEWEST and kept < RARE * share]
    moved = 0.5 * sum(abs(kept - share) for share, kept in shares.values())
    return Shift(moved, 0.5 * sum(sqrt(2 / pi * variance) for variance in variances), tuple(_named(leaf, rare)))


def used(values: Iterable[Any]) -> list[Any]:
    """The values in designs that use the parameter."""
    return [value for value in values if value is not UNUSED]


def _bin(leaf: Leaf, value: Any) -> Bin:
    if value is UNUSED:
        return UNUSED
    if isinstance(leaf.space, Choice) or value == leaf.space.default:
        return str(value)
    low, high = leaf.space.range
    return min(int(BINS * (value - low) / (high - low)), BINS - 1)


def _named(leaf: Leaf, bins: Iterable[Bin]) -> Iterator[str]:
    """The bins in words; adjacent bins as one range."""
    yield from sorted(name for name in bins if isinstance(name, str))
    numbers = enumerate(sorted(name for name in bins if isinstance(name, int)))
    for _, run in groupby(numbers, key=lambda pair: pair[1] - pair[0]):
        parts = [number for _, number in run]
        low, high = leaf.space.range
        ends = (low + (high - low) * number / BINS for number in (parts[0], parts[-1] + 1))
        yield " to ".join(f"{end:.4g}" for end in ends)
