"""Garments cut for a size of a chart and worn by a body: the size, the place on the body, the labels of the fit."""

from dataclasses import dataclass, replace

import numpy as np

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.sizes import SizeChart
from gcd_dataset.generator.garments import GarmentDesign
from gcd_dataset.generator.garments.rules import fit_labels
from gcd_dataset.records import POSITION_STEP, BoxMesh, Drape, Fit, FitLabel, Measurements, Outcome, Pattern, as_stored


@dataclass(frozen=True)
class Cut:
    """A size of a chart, for a wearer of another size or of the same."""

    chart: SizeChart
    size: str
    wearer_size: str
    """Empty for a wearer outside the chart."""

    @property
    def measures(self) -> Measurements:
        """The measures for which the garment is drawn."""
        return self.chart.body(self.size)

    def fit(self, pattern: Pattern, design: GarmentDesign, wearer: Measurements) -> Fit:
        """The size and the labels of a pattern drawn for it."""
        sizes = list(self.chart.bodies)
        step = sizes.index(self.size) - sizes.index(self.wearer_size) if self.wearer_size else 0
        labels = fit_labels(pattern, design, cut_for=self.measures, wearer=wearer)
        return Fit(self.chart.name, self.size, self.wearer_size, step, labels)


def size_or_none(chart: SizeChart, wearer: Measurements) -> str:
    """The size of a body; empty for one outside the chart."""
    try:
        return chart.size_of(wearer)
    except BodyError:
        return ""


def draw_cut(chart: SizeChart, wearer_size: str, steps: tuple[int, int], rng: np.random.Generator) -> Cut:
    """A size ``steps`` (least, most) away, each with equal probability; of those that the chart has, or the nearest."""
    sizes = list(chart.bodies)
    least, most = np.clip(np.add(steps, sizes.index(wearer_size)), 0, len(sizes) - 1)
    return Cut(chart, sizes[rng.integers(least, most + 1)], wearer_size)


def lifted(pattern: Pattern, design: GarmentDesign, *, cut_for: Measurements, wearer: Measurements) -> Pattern:
    """A pattern drawn for one size, moved up or down: its nape, or the waist of a bottom, is at the wearer's height."""
    nape = wearer.height - wearer.head_l - (cut_for.height - cut_for.head_l)
    rise = nape if design.meta.upper else wearer.waist_level - cut_for.waist_level
    places = (panel.placement for panel in pattern.panels)
    higher = (replace(place, translation=place.translation + [0.0, rise, 0.0]) for place in places)
    panels = (replace(panel, placement=place) for panel, place in zip(pattern.panels, higher, strict=True))
    return replace(pattern, panels=tuple(panels))


def undraped(mesh: BoxMesh, obstacle: FitLabel | None, unsettled: str) -> Drape:
    """The drape of a garment that cannot be put on: before sewing, without figures.

    ``unsettled``: without an obstacle, the fault of a garment under it.
    """
    outcome, reason = (Outcome.CANNOT_BE_PUT_ON, obstacle.reason) if obstacle else (Outcome.REFUSED, unsettled)
    return Drape(as_stored(mesh.vertices, POSITION_STEP), outcome, 0, 0, 0, np.nan, np.nan, reason=reason)
