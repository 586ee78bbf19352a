"""Designs with their patterns: drawn from values, or sampled, on a woman, a man and a stout woman in turn."""

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from gcd_dataset.generator.captions import captions
from gcd_dataset.generator.garments import GarmentDesign, Reject, design_from_dict, draw_garment, sample_design, try_on
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.records import Measurements, Pattern
from tests.generator.garments.conftest import MAN, STOUT, WOMAN


class Worn(NamedTuple):
    """A design, drawn for a wearer."""

    size: Measurements
    design: GarmentDesign
    pattern: Pattern

    def captions(self, index: int = 0) -> dict[str, str]:
        return dict(captions(self.size, self.design, self.pattern, seed=5, index=index))


def drawn(size: Measurements, **values: object) -> Worn:
    """A design of sections, with underscores in their names, drawn for a wearer."""
    design = design_from_dict({name.replace("_", "-"): part for name, part in values.items()})
    return Worn(size, design, draw_garment(size, design))


def sampled(count: int, *overlays: Mapping[str, Any]) -> Iterator[Worn]:
    """Accepted random designs, on a woman, a man and a stout woman in turn."""
    random = np.random.default_rng(21)
    for overlay in overlays or ({},):
        narrowed = Overlay.from_dict(overlay)
        for number in range(count):
            size = (WOMAN, MAN, STOUT)[number % 3]
            design = sample_design(random, [size], overlay=narrowed)
            pattern = try_on(size, design, name="sampled")
            if not isinstance(pattern, Reject):
                yield Worn(size, design, pattern)


@cache
def sampled_wardrobe() -> list[Worn]:
    """Sampled designs, with capes and ponchos, which only overlays choose."""
    alone = {"wb": "none", "bottom": "none"}
    rare = [{"meta": {"upper": name, **alone}} for name in ("Cape", "Poncho")]
    levels = {"meta": {"upper": "none", "bottom": "SkirtLevels"}}
    return [*sampled(180), *sampled(8, *rare), *sampled(25, levels)]


def edges(pattern: Pattern) -> set[str]:
    """The names of all edges, without number."""
    return {edge.name.partition(".")[0] for panel in pattern.panels for edge in panel.edges}


def hem_cut_depth(pattern: Pattern) -> float:
    """Distance from the tip of a hem cut to the middle of its mouth [cm]; 0 without a cut."""
    for panel in pattern.panels:
        ends = {edge.name: panel.edge_ends(index) for index, edge in enumerate(panel.edges)}
        if "hem_cut.0" in ends:
            (a, b), (c, d) = (ends[f"hem_cut.{number}"] for number in (0, 1))
            tip, *mouth = (b, a, d) if np.allclose(b, c) else (a, b, c)
            return float(np.linalg.norm(np.asarray(tip) - np.mean(mouth, axis=0)))
    return 0.0
