"""Seams between interfaces: which stretch of which edge is sewn to which.

An interface is a walk along named edges, perhaps of several panels. Two interfaces are sewn in the order of their
walks: where one has a corner and the other has not, the other's edge is divided, so that every seam of the finished
pattern joins one edge with one edge.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import TypeAlias

__all__ = ["Interface", "Join", "Section", "backwards", "shared_breaks"]

EDGE_BY_EDGE = 0.05  # share of a seam by which corners may differ and still be sewn to each other, GarmentCode
SAME_BREAK = 0.01  # share of a seam below which two breaks are one, GarmentCode
UNDER_HALF = 0.49  # of the shortest edge: no break may count as one with both ends of an edge


@dataclass(frozen=True, slots=True)
class Section:
    """One named edge of an interface, with all the pieces that darts left of it."""

    panel: str
    edge: str
    backward: bool = False
    """Walked against the direction in which it was drawn."""
    ruffle: float = 1.0
    """Its length over the length it counts for in the seam: more than 1 is gathered."""


Interface: TypeAlias = tuple[Section, ...]


@dataclass(frozen=True, slots=True)
class Join:
    """Two interfaces to be sewn together, walked the same way along the seam."""

    left: Interface
    right: Interface
    gathered: bool = False
    """Whether the longer side is gathered to the other; else they are meant to be equally long."""


def backwards(interface: Interface) -> Interface:
    """The same interface, walked from its other end."""
    return tuple(replace(section, backward=not section.backward) for section in reversed(interface))


def shared_breaks(left: Sequence[float], right: Sequence[float]) -> tuple[list[list[float]], list[list[float]]]:
    """Where to divide the edges of two interfaces so that both have the same number, from their projected lengths.

    Returns, for each edge of each side, the shares of its own length at which it is divided. Breaks of the two sides
    that lie closer than a hundredth of the seam (or nearly half its shortest edge) count as one.

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
    """Shares of the whole at which one edge ends and the next begins; the two ends are left out."""
    total = sum(lengths)
    return [reached / total for reached in accumulate(lengths[:-1])]


def _shortest_share(lengths: Sequence[float]) -> float:
    return min(lengths) / sum(lengths)


def _missing(own: Sequence[float], other: Sequence[float], tolerance: float) -> list[float]:
    return [share for share in other if all(abs(share - mine) > tolerance for mine in own)]


def _divisions(breaks: Sequence[float], added: Sequence[float]) -> list[list[float]]:
    """The added breaks sorted into the edges they fall on, as shares of each edge."""
    bounds = [0.0, *breaks, 1.0]
    return [[(share - low) / (high - low) for share in added if low < share < high] for low, high in pairwise(bounds)]
