"""Designs as rows of numbers: they come back whole, and parameters without effect change no pattern."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from benchmarks.reconstruction.design_codes import PARAMETERS, decode_design, encode_design, have_effect, options_of
from gcd_dataset.errors import PatternError
from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.generator.garments import GarmentDesign, design_from_dict, design_to_dict, draw_garment, sample_design
from gcd_dataset.generator.garments.parameter import Choice

PATHS = [leaf.path for leaf in PARAMETERS]


def row_of(design: GarmentDesign) -> np.ndarray:
    return encode_design(design_to_dict(design))


@pytest.mark.parametrize("seed", range(8))
def test_a_design_comes_back_from_its_row(seed: int) -> None:
    design = sample_design(np.random.default_rng(seed))
    again = decode_design(row_of(design))
    assert np.array_equal(row_of(again), row_of(design), equal_nan=True)
    assert again.meta == design.meta
    assert again.shirt.length == pytest.approx(design.shirt.length, rel=1e-6)


def test_missing_and_impossible_values_are_unknown_and_become_defaults() -> None:
    row = encode_design({"meta": {"upper": "Shirt", "wb": "Rope"}, "shirt": {"length": 99.0, "width": 1.2}})
    known = {path for path, code in zip(PATHS, row, strict=True) if not np.isnan(code)}
    assert known == {"meta.upper", "shirt.width"}
    assert decode_design(row).shirt.length == GarmentDesign().shirt.length
    assert decode_design(row).shirt.width == pytest.approx(1.2)


def test_numbers_beyond_their_range_are_moved_into_it() -> None:
    row = row_of(design_from_dict({"meta": {"upper": "Shirt"}}))
    row[PATHS.index("shirt.length")] = 7.0
    row[PATHS.index("collar.fc_angle")] = 88.4
    design = decode_design(row)
    assert (design.shirt.length, design.collar.fc_angle) == (3.5, 88)


DESIGNS: dict[str, dict[str, Any]] = {
    "strapless": {"meta": {"upper": "FittedShirt"}, "shirt": {"strapless": True}},
    "lapel": {
        "meta": {"upper": "Shirt", "bottom": "GodetSkirt", "wb": "FittedWB"},
        "collar": {"f_collar": "Bezier2NeckHalf", "component": {"style": "SimpleLapel"}},
        "sleeve": {"sleeveless": False, "cuff": {"type": "CuffBandSkirt"}},
    },
    "levels": {"meta": {"upper": "FittedShirt", "bottom": "SkirtLevels"}, "levels-skirt": {"base": "SkirtCircle"}},
    "ruffled levels": {
        "meta": {"bottom": "SkirtLevels"},
        "levels-skirt": {"base": "Skirt2", "level": "SkirtCircle"},
        "skirt": {"bottom_cut": 0.3, "ruffle": 1.4},
        "flare-skirt": {"cut": {"add": True}},
    },
    "godets": {
        "meta": {"bottom": "GodetSkirt", "wb": "FittedWB"},
        "godet-skirt": {"base": "PencilSkirt"},
        "pencil-skirt": {"length": 0.7, "left_slit": 0.4, "front_slit": 0.3},
    },
    "pants": {"meta": {"bottom": "Pants"}, "pants": {"cuff": {"type": "CuffBand"}}},
    "poncho": {"meta": {"upper": "Poncho"}},
}


def changed_rows(row: np.ndarray, *, effective: bool) -> Iterator[tuple[str, np.ndarray]]:
    """Rows with another value of one parameter with or without effect, in the sections that the design uses."""
    design = decode_design(row)
    for k in np.flatnonzero(have_effect(design) == effective).tolist():
        path, space = PARAMETERS[k]
        section = path.partition(".")[0].replace("-", "_")
        if np.isnan(row[k]) or section == "meta" or section not in design.sections_used():
            continue
        other = row.copy()
        if isinstance(space, Choice):
            other[k] = (row[k] + 1) % len(options_of(space))
        else:
            low, high = space.range
            other[k] = low if row[k] - low > high - row[k] else high
        yield path, other


@pytest.mark.parametrize("name", DESIGNS)
def test_parameters_without_effect_change_no_pattern(name: str) -> None:
    size = measure(build_body(neutral_shape()))
    row = row_of(design_from_dict(DESIGNS[name]))

    def drawn(codes: np.ndarray) -> str:
        pattern = draw_garment(size, decode_design(codes))
        return repr((pattern.panels, pattern.seams))

    truth = drawn(row)
    for path, other in changed_rows(row, effective=False):
        try:
            assert drawn(other) == truth, path
        except PatternError as error:
            pytest.fail(f"{path}: {error}")


@pytest.mark.parametrize("name", [name for name in DESIGNS if name not in ("lapel", "strapless", "poncho")])
def test_parameters_with_effect_change_the_pattern(name: str) -> None:
    size = measure(build_body(neutral_shape()))
    row = row_of(design_from_dict(DESIGNS[name]))
    truth = draw_garment(size, decode_design(row)).panels
    unchanged = []
    for path, other in changed_rows(row, effective=True):
        try:
            unchanged += [path] if repr(draw_garment(size, decode_design(other)).panels) == repr(truth) else []
        except PatternError:  # an ornament, which is not drawn
            assert path == "pencil-skirt.style_side_cut"
    assert not unchanged
    assert len(list(changed_rows(row, effective=True))) >= 7
