"""The design that was made last: its other wearers are often asked for next, one by one."""

from collections.abc import Callable
from dataclasses import dataclass

from gcd_dataset.records import Sample

__all__ = ["LastDesign", "MadeDesign"]


@dataclass(frozen=True)
class MadeDesign:
    """A design that all of its wearers wear."""

    number: int
    sample_of: Callable[[int], Sample]
    """Index of one of them to its sample."""


class LastDesign:
    """Room for one design, of one seed and recipe, of which not all samples were asked for.

    Comes out of a pickle empty: each process remembers what it made itself.
    """

    def __init__(self) -> None:
        self.made: MadeDesign | None = None

    def __reduce__(self) -> tuple[type["LastDesign"], tuple[()]]:
        return LastDesign, ()
