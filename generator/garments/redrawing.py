"""Redraws: parts of a design drawn again because they break a rule, each counted with the rule and the parameter.

A parameter outside a limit is drawn again within the limit. For a fault that no limit describes, remedies are tried in
order: each draws one parameter, or some parts of the design, again and leaves the others as they are.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import NamedTuple, TypeAlias

import numpy as np

from gcd_dataset.generator.garments.design import GarmentDesign
from gcd_dataset.generator.garments.garment import GarmentChoice
from gcd_dataset.generator.garments.sewable import SewingFault
from gcd_dataset.generator.garments.space import Design, DesignSpace, redrawn, value_at, with_value

TRIES = 4  # redraws by one remedy
MOST_REPAIRS = 10  # removed faults of a design: removing one may cause another

FindFault: TypeAlias = Callable[[GarmentDesign], SewingFault | None]
"""Returns the first fault of a design, or ``None``."""


class Redraw(NamedTuple):
    """The reason for a redraw, and the path of the parameter or part drawn again."""

    rule: str
    path: str


class Remedy(NamedTuple):
    """A parameter, or parts of a design, to draw again."""

    paths: tuple[str, ...]
    low: bool = False
    """Whether each redraw must give a lower number than the last."""
    high: bool = False
    """Whether each redraw must give a higher number than the last."""


@dataclass(frozen=True)
class DrawnDesign:
    """A random design, and the number of each of its redraws."""

    design: GarmentDesign
    redraws: Mapping[Redraw, int]

    def by_rule(self) -> Counter[str]:
        """Rule to the number of redraws that it caused."""
        total: Counter[str] = Counter()
        for redraw, count in self.redraws.items():
            total[redraw.rule] += count
        return total


@dataclass(frozen=True)
class Redrawing:
    """Draws parameters of a design again and counts the redraws."""

    rng: np.random.Generator
    space: DesignSpace[GarmentDesign]
    counts: Counter[Redraw] = field(default_factory=Counter)

    def again(
        self, design: GarmentDesign, rule: str, *paths: str, low: float = -np.inf, high: float = np.inf
    ) -> GarmentDesign:
        """The design with the parameters or parts at some paths drawn again, between ``low`` and ``high``.

        A part keeps its choices of garments, such as the base of a levels skirt: another garment has another section.
        """
        for path in paths:
            garments = _garments(value_at(self.space, design, path))
            design = redrawn(self.space, design, path, self.rng, low, high)
            if garments:
                design = with_value(self.space, design, path, replace(value_at(self.space, design, path), **garments))
            self.counts[Redraw(rule, path)] += 1
        return design

    def within(self, design: GarmentDesign, rule: str, path: str, low: float, high: float) -> GarmentDesign:
        """The design; if the number at ``path`` is outside its limits, with this number drawn again within them."""
        if low <= value_at(self.space, design, path) <= high:
            return design
        return self.again(design, rule, path, low=low, high=high)

    def tried(self, design: GarmentDesign, rule: str, remedy: Remedy) -> Iterator[GarmentDesign]:
        """Up to ``TRIES`` designs, each the last one with the remedy applied again; unchanged designs are left out."""
        trial = design
        for _ in range(TRIES):
            low, high = -np.inf, np.inf
            if remedy.low or remedy.high:
                last = value_at(self.space, trial, remedy.paths[0])
                # Strictly beyond: a default equal to the last value would be kept with its probability.
                low, high = (low, np.nextafter(last, -np.inf)) if remedy.low else (np.nextafter(last, np.inf), high)
            trial = self.again(design, rule, *remedy.paths, low=low, high=high)
            if trial != design:
                yield trial

    def repaired(
        self,
        design: GarmentDesign,
        find: FindFault,
        remedies: Callable[[SewingFault], Sequence[Remedy]],
        *,
        limited: Callable[[GarmentDesign], GarmentDesign] = lambda design: design,
    ) -> GarmentDesign:
        """The design without faults; if no remedy helps, with the fault that no remedy could remove.

        ``limited`` puts a design with new parameters back within its limits.
        """
        fault = find(design)
        for _ in range(MOST_REPAIRS):
            if fault is None:
                break
            trials = chain.from_iterable(self.tried(design, fault.rule, remedy) for remedy in remedies(fault))
            found = ((trial, find(trial)) for trial in map(limited, trials))
            design, left = next((pair for pair in found if _is_other(pair[1], fault)), (design, fault))
            if left is fault:
                break
            fault = left
        return design


def _garments(part: object) -> dict[str, GarmentChoice]:
    """Parameter name to garment, for the parameters of a part that choose a garment; empty for a single parameter."""
    values = vars(part) if isinstance(part, Design) else {}
    return {name: value for name, value in values.items() if isinstance(value, GarmentChoice)}


def _is_other(found: SewingFault | None, fault: SewingFault) -> bool:
    return found is None or found.part != fault.part
