"""Patterns compared with GarmentCode's for the same design and body."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from jaxtyping import Float

from gcd_dataset.curves import curve_length, sample_curve
from gcd_dataset.generator.body import read_measurements
from gcd_dataset.generator.garments import GarmentDesign, design_from_dict, design_to_dict, draw_garment, read_design
from gcd_dataset.generator.garments.mends import ALL_MENDS, Mend
from gcd_dataset.generator.garments.waistband import Waistband, WaistbandDesign, waistband
from gcd_dataset.generator.pattern import assemble
from gcd_dataset.records import Measurements, Panel, Pattern
from gcd_dataset.spec import read_pattern

EXACT = 0.01  # cm: accuracy of the reference's solvers
PLACED = 1.0  # cm: the reference shifts a panel by the fractional part of its first corner (a truncated pivot)

BODIES = pytest.mark.parametrize("body", ["default_body", "random_body"])
ROUND = {"collar": {"f_collar": "CircleNeckHalf", "b_collar": "CircleNeckHalf"}}

RISES = {  # design sections that hold the rise of the bottom; without one the rise is 1 (under a fitted shirt)
    "circle_skirt": ("flare-skirt",),
    "godet_skirt": ("pencil-skirt",),
    "levels_skirt": ("levels-skirt",),
    "pants_cuff": ("pants",),
    "dress": (),
    "jumpsuit": (),
}


def read(folder: Path) -> tuple[Measurements, dict[str, Any], Pattern]:
    """Measures, plain design and the reference's pattern in a folder of the examples."""
    (path,) = folder.glob("*_specification.json")
    design = read_design(folder / "design_params.yaml")
    return read_measurements(folder / "body_measurements.yaml"), design_to_dict(design), read_pattern(path)


def load(folder: Path, changes: dict[str, dict[str, Any]]) -> tuple[Measurements, GarmentDesign, Pattern]:
    """Like ``read``, with the design as ``GarmentDesign``; ``changes`` replace values of the file, by section."""
    size, values, reference = read(folder)
    return size, design_from_dict(values | {key: values[key] | changed for key, changed in changes.items()}), reference


def contour(panel: Panel, *, placed: bool = False) -> Float[np.ndarray, "n k"]:
    points = np.concatenate([sample_curve(*panel.edge_ends(i), edge.curve, 60) for i, edge in enumerate(panel.edges)])
    return panel.placement.apply(points) if placed else points - panel.vertices[0]


def distance(a: Float[np.ndarray, "n 2"], b: Float[np.ndarray, "m 2"]) -> float:
    """Largest distance of a point of one line from the other line, both ways [cm]."""
    return float(shapely.hausdorff_distance(shapely.LineString(a), shapely.LineString(b)))


def displacement(a: Panel, b: Panel) -> float:
    """Distance between two placed panels [cm]: of their contours seen from the front, and of their depths."""
    (xy, z), (xy_b, z_b) = ((points[:, :2], points[:, 2]) for points in (contour(p, placed=True) for p in (a, b)))
    return max(distance(xy, xy_b), abs(float(z.mean() - z_b.mean())))


def lengths(panel: Panel) -> list[float]:
    return [curve_length(*panel.edge_ends(i), edge.curve) for i, edge in enumerate(panel.edges)]


def seams(pattern: Pattern, panels: set[str]) -> set[frozenset[tuple[str, int]]]:
    return {
        frozenset({(seam.left.panel, seam.left.edge), (seam.right.panel, seam.right.edge)})
        for seam in pattern.seams
        if {seam.left.panel, seam.right.panel} <= panels
    }


@BODIES
def test_circle_skirt_with_fitted_waistband(examples: Path, body: str) -> None:
    size, design, reference = load(examples / "patterns" / "circle_skirt" / body, ROUND)
    ours = draw_garment(size, design, mends=ALL_MENDS - {Mend.WORN_LENGTH})
    assert [panel.name for panel in ours.panels] == [panel.name for panel in reference.panels]
    assert seams(ours, {p.name for p in ours.panels}) == seams(reference, {p.name for p in reference.panels})
    assert not any(seam.right_wrong for seam in (*ours.seams, *reference.seams))
    for panel in ours.panels:
        theirs = reference.panel(panel.name)
        assert distance(contour(panel), contour(theirs)) < EXACT
        assert lengths(panel) == pytest.approx(lengths(theirs), abs=EXACT)
        assert displacement(panel, theirs) < PLACED
        assert [edge.label for edge in panel.edges] == [edge.label for edge in theirs.edges]
        assert panel.label == theirs.label


@BODIES
@pytest.mark.parametrize("example", RISES)
def test_waistbands(examples: Path, example: str, body: str) -> None:
    size, values, reference = read(examples / "patterns" / example / body)
    rise = min([values[section]["rise"] for section in RISES[example]], default=1.0)
    band = waistband(size, WaistbandDesign(**values["waistband"]), Waistband(values["meta"]["wb"]), rise=rise)
    for panel in assemble(band, "band").panels:
        assert distance(contour(panel), contour(reference.panel(panel.name))) < EXACT
