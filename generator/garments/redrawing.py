"""Redraws: parts of a design drawn again because they break a rule, each counted with the rule and the parameter.

A limit redraws one parameter within it. A fault that no limit describes is removed by remedies, tried in order: each
names the parameters to draw again while all others stay.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

import numpy as np

from gcd_dataset.generator.garments.design import OutfitDesign
from gcd_dataset.generator.garments.sewable import Fault
from gcd_dataset.generator.garments.space import DesignSpace, redrawn, value_at

__all__ = ["DrawnDesign", "FindFault", "Redraw", "Redrawing", "Remedy"]

TRIES = 5  # of one remedy
MOST_REPAIRS = 10  # a remedy may remove one fault and cause another

FindFault: TypeAlias = Callable[[OutfitDesign], Fault | None]
"""The first fault of a design."""
Remedy: TypeAlias = tuple[str, ...]
"""Paths of the parameters and parts that are drawn again together."""


class Redraw(NamedTuple):
    """The reason for a redraw, and the path of the parameter or part drawn again."""

    rule: str
    path: str


@dataclass(frozen=True)
class DrawnDesign:
    """A random design and the redraws that it took."""

    design: OutfitDesign
    redraws: Mapping[Redraw, int]

    def by_rule(self) -> Counter[str]:
        """Rule to its number of redraws."""
        total: Counter[str] = Counter()
        for redraw, count in self.redraws.items():
            total[redraw.rule] += count
        return total


@dataclass(frozen=True)
class Redrawing:
    """Draws parameters of a design again and counts the redraws."""

    rng: np.random.Generator
    space: DesignSpace[OutfitDesign]
    counts: Counter[Redraw] = field(default_factory=Counter)

    def again(
        self, design: OutfitDesign, rule: str, *paths: str, low: float = -np.inf, high: float = np.inf
    ) -> OutfitDesign:
        """The design with the parameters or parts at some paths drawn again, between ``low`` and ``high``."""
        for path in paths:
            design = redrawn(self.space, design, path, self.rng, low, high)
            self.counts[Redraw(rule, path)] += 1
        return design

    def within(self, design: OutfitDesign, rule: str, path: str, low: float, high: float) -> OutfitDesign:
        """The design with a number outside its limits drawn again within them."""
        if low <= value_at(self.space, design, path) <= high:
            return design
        return self.again(design, rule, path, low=low, high=high)

    def repaired(
        self,
        design: OutfitDesign,
        find: FindFault,
        remedies: Callable[[Fault], Sequence[Remedy]],
        *,
        limited: Callable[[OutfitDesign], OutfitDesign] = lambda design: design,
    ) -> OutfitDesign:
        """The design without faults, or, if no remedy helps, with the last one left.

        ``limited`` puts a design with new parameters back within its limits.
        """
        fault = find(design)
        for _ in range(MOST_REPAIRS):
            if fault is None:
                break
            trials = (
                limited(self.again(design, fault.rule, *paths)) for paths in remedies(fault) for _ in range(TRIES)
            )
            found = ((trial, find(trial)) for trial in trials)
            design, left = next((pair for pair in found if _is_other(pair[1], fault)), (design, fault))
            if left is fault:
                break
            fault = left
        return design


def _is_other(found: Fault | None, fault: Fault) -> bool:
    return found is None or found.part != fault.part
