"""Interfaces, joins of two interfaces, and the breaks that divide their edges to match.

An interface is a walk along named edges, perhaps of several panels. A join sews two interfaces in the order of their
walks. Where only one side has a corner, the edge on the other side is divided, so that every seam of the finished
pattern joins one edge to one edge.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import TypeAlias

EDGE_BY_EDGE = 0.05  # share of a seam: corners that differ by less are sewn to each other, GarmentCode
SAME_BREAK = 0.01  # share of a seam: breaks that differ by less count as one, GarmentCode
UNDER_HALF = 0.49  # fraction of the shortest edge: limit of SAME_BREAK, so that no break matches both ends of an edge


@dataclass(frozen=True, slots=True)
class Section:
    """One named edge of an interface, with all parts into which cuts have divided it."""

    panel: str
    edge: str
    backward: bool = False
    """Whether it is walked against its drawing direction."""
    ruffle: float = 1.0
    """Gathers: length of the edge over its projected length in the seam."""


Interface: TypeAlias = tuple[Section, ...]


@dataclass(frozen=True, slots=True)
class Join:
    """Two interfaces to sew together, walked in the same direction along the seam."""

    left: Interface
    right: Interface
    gathered: bool = False
    """Whether the longer side is gathered to the shorter; otherwise both should have the same length."""


def backwards(interface: Interface) -> Interface:
    """The interface walked from its other end."""
    return tuple(replace(section, backward=not section.backward) for section in reversed(interface))


def shared_breaks(left: Sequence[float], right: Sequence[float]) -> tuple[list[list[float]], list[list[float]]]:
    """The breaks that divide the edges of two interfaces into equally many parts, from their projected lengths.

    Returns, for each edge of each side, the shares of its length at which to divide it. Breaks of the two sides closer
    than a hundredth of the seam (or nearly half its shortest edge) count as one.

    >>> shared_breaks([10.0, 10.0], [5.0, 15.0])
    ([[0.5], []], [[], [0.3333333333333333]])
    """
    breaks_left, breaks_right = _breaks(left), _breaks(right)
    if len(left) == len(right) and all(
        abs(a - b) <= EDGE_BY_EDGE for a, b in zip(breaks_left, breaks_right, strict=True)
    ):
        return [[] for _ in left], [[] for _ in right]
    tolerance = min(SAME_BREAK, UNDER_HALF * _shortest_share(left), UNDER_HALF * _shortest_share(right))
    missing_left = _missing(breaks_left, breaks_right, tolerance)
    missing_right = _missing(breaks_right, breaks_left, tolerance)
    return _divisions(breaks_left, missing_left), _divisions(breaks_right, missing_right)


def _breaks(lengths: Sequence[float]) -> list[float]:
    """Shares of the total length where one edge ends and the next begins."""
    total = sum(lengths)
    return [length / total for length in accumulate(lengths[:-1])]


def _shortest_share(lengths: Sequence[float]) -> float:
    return min(lengths) / sum(lengths)


def _missing(breaks: Sequence[float], others: Sequence[float], tolerance: float) -> list[float]:
    return [share for share in others if all(abs(share - known) > tolerance for known in breaks)]


def _divisions(breaks: Sequence[float], added: Sequence[float]) -> list[list[float]]:
    """The added breaks by the edge that they divide, as shares of its length."""
    bounds = [0.0, *breaks, 1.0]
    return [[(share - low) / (high - low) for share in added if low < share < high] for low, high in pairwise(bounds)]
