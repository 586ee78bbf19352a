"""Ease: lengths of cloth do not depend on stretch, folds and gathers, and agree with the pattern."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from jaxtyping import Float

from gcd_dataset.generator import make
from gcd_dataset.generator.body import named_body
from gcd_dataset.generator.drape import DrapeJob, drape_batch
from gcd_dataset.generator.ease import ease_of
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.generator.garments.waistband import Waistband
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.generator.pattern import Component, Outline, Piece, assemble
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.records import EASE, Body, BoxMesh, Ease, Measurements, Pattern
from gcd_dataset.shards.codec import decode_sample, encode_sample
from tests.generator.garments.measured import length, lengths

BODIES = ("neutral", "male:2", "random:5")
GARMENTS: Mapping[str, tuple[Mapping[str, Any], tuple[str, ...]]] = {
    "T-shirt": (
        {"meta": {"upper": "Shirt", "bottom": None}, "sleeve": {"sleeveless": False, "length": 0.6, "end_width": 1.0}},
        ("bust", "underbust", "waist", "upper_arm"),
    ),
    "skirt": ({"meta": {"upper": None, "wb": None, "bottom": "PencilSkirt"}}, ("thigh",)),
    "trousers": (
        {"meta": {"upper": None, "wb": "StraightWB", "bottom": "Pants"}, "pants": {"length": 0.9, "width": 1.2}},
        ("thigh", "knee", "calf"),
    ),
}


@pytest.fixture(scope="module")
def neutral() -> tuple[Body, Measurements]:
    return named_body("neutral")[:2]


def tube(*widths: float, height: float = 20.0, top: float = 118.0) -> tuple[Pattern, BoxMesh]:
    """Tubes round the trunk, each sewn under the one before; ``widths``: of half their cloth [cm]."""
    rows = []
    for row, width in enumerate(widths):
        outline = Outline.start(0, 0).line(width, 0, name="bottom").line(width, height, name="right")
        outline = outline.line(0, height, name="top").close(name="left")
        low = top - (row + 1) * height
        rows.append([Piece(f"{side}_{row}", outline).at(-0.5 * width, low, z) for side, z in (("f", 25), ("b", -20))])
    whole = Component.of(*(piece for row in rows for piece in row))
    for front, back in rows:
        whole = whole.sewn(front.along("right"), back.along("right")).sewn(front.along("left"), back.along("left"))
    for above, below in pairwise(rows):
        for upper, lower in zip(above, below, strict=True):
            whole = whole.sewn(upper.along("bottom"), lower.along("top"), gathered=True)
    pattern = assemble(whole, "tube")
    return pattern, build_box_mesh(pattern, spacing=2.0)


def rolled(
    mesh: BoxMesh, pattern: Pattern, radius: float, fold: float = 0.0, tilt: float = 0.0
) -> Float[np.ndarray, "v 3"]:
    """The tubes round a cylinder about the trunk, in folds of depth ``fold`` that rise and fall by twice that [cm].

    ``tilt``: rise of the cloth from the left side to the right side [cm].
    """
    panel, at = mesh.panel_of_row, np.zeros((len(mesh.vertices), 3))
    for row, each in enumerate(pattern.panels):
        own = panel == row
        u = mesh.uv[own, 0] / np.ptp(mesh.uv[own, 0])
        angle = np.pi * (u if each.name.startswith("f") else 2.0 - u)
        out = radius + fold * np.sin(24 * angle)
        height = each.placement.apply(mesh.uv[own])[:, 1] + 2.0 * fold * np.sin(5 * angle)
        height += tilt * (1.0 - np.abs(angle / np.pi - 1.0))
        at[mesh.uv_vertex[own]] = np.stack([-out * np.cos(angle), height, out * np.sin(angle)], axis=1)
    return at


def test_cloth_round_the_body_has_its_own_girth(neutral: tuple[Body, Measurements]) -> None:
    """Not that of the cylinder on which it lies, stretched, nor that of its folds."""
    pattern, mesh = tube(50.0)
    for radius, fold in ((100 / (2 * np.pi), 0.0), (20.0, 0.0), (15.0, 1.0)):
        ease = ease_of(pattern, mesh, *neutral, rolled(mesh, pattern, radius, fold))["waist"]
        assert [ease.cloth, ease.worn] == pytest.approx([100.0, 100.0], abs=0.02)
        assert ease.body == pytest.approx(neutral[1].waist, abs=0.2)


def test_a_tilted_ring_is_as_long_as_the_lines_on_its_panels(neutral: tuple[Body, Measurements]) -> None:
    """Each is straight, 40 cm wide, and falls by 12 cm from side to side."""
    pattern, mesh = tube(40.0, height=40.0, top=130.0)
    found = ease_of(pattern, mesh, *neutral, rolled(mesh, pattern, 14.0, tilt=12.0))["waist"]
    assert [found.cloth, found.worn] == pytest.approx([80.0, 2 * np.hypot(40.0, 12.0)], abs=0.1)


def test_gathers_count_by_the_shorter_side_of_the_seam(neutral: tuple[Body, Measurements]) -> None:
    """The seam of a tube of 90 cm and one of 150 cm is 1 cm above the waist, then 4 cm above it."""
    for above, girth in ((1.0, 90.0), (4.0, 150.0)):
        pattern, mesh = tube(45.0, 75.0, top=109.3 + above + 20.0)
        ease = ease_of(pattern, mesh, *neutral, rolled(mesh, pattern, 18.0))["waist"]
        assert [ease.cloth, ease.worn] == pytest.approx([girth, girth], abs=0.1)


@pytest.mark.parametrize("garment", GARMENTS)
def test_cloth_as_worn_is_as_wide_as_its_pattern(garment: str) -> None:
    """Where it is at least 2 cm wider than the body; narrower cloth may hang higher or lower than it was drawn."""
    design, levels = GARMENTS[garment]
    worn = []
    for name in BODIES:
        body, size, _ = named_body(name, legs_apart=garment == "trousers")
        pattern = draw_garment(size, design_from_dict(design))
        worn.append((pattern, DrapeJob(build_box_mesh(pattern, spacing=2.0), body, size)))
    for (pattern, job), drape in zip(worn, drape_batch([job for _, job in worn], device="cpu"), strict=True):
        found = ease_of(pattern, job.box_mesh, job.body, job.measurements, drape.vertices)
        for level in levels:
            assert found[level].ease > 2.0
            assert found[level].worn == pytest.approx(found[level].cloth, abs=0.5)
        assert len(found) == len(EASE)


@pytest.mark.parametrize("strapless", [False, True])
def test_a_fitted_top_is_cut_as_wide_as_the_bust(strapless: bool) -> None:
    """Its darts are drawn for that, at the height of the bust."""
    design = {"meta": {"upper": "FittedShirt", "bottom": None}, "shirt": {"strapless": strapless}}
    for name in BODIES:
        body, size, _ = named_body(name)
        pattern = draw_garment(size, design_from_dict(design))
        found = ease_of(pattern, build_box_mesh(pattern, spacing=2.0), body, size)
        assert found["bust"].cloth == pytest.approx(size.bust, abs=0.5)


def test_a_circle_skirt_widens_by_the_angle_that_it_is_cut_from(neutral: tuple[Body, Measurements]) -> None:
    size = neutral[1]
    pattern = draw_garment(size, design_from_dict({"meta": {"upper": None, "wb": None, "bottom": "SkirtCircle"}}))
    found = ease_of(pattern, build_box_mesh(pattern, spacing=1.0), *neutral)
    depth = size.crotch_hip_diff + 2.0  # from the hips to the section of the thigh
    inner, outer = (lengths(pattern, name) for name in ("top", "bottom"))
    angle = (outer - inner) / length(pattern.panels[0], "left")
    assert found["thigh"].cloth - found["hips"].cloth == pytest.approx(angle * depth, rel=0.02)


@pytest.mark.parametrize("kind", Waistband)
def test_a_waistband_is_cut_along_its_upper_edge(kind: Waistband, neutral: tuple[Body, Measurements]) -> None:
    """The waist is less than 2 cm below that edge: the band has widened by a small share there."""
    body, size = neutral
    design = {"meta": {"upper": None, "wb": kind.value, "bottom": "SkirtCircle"}, "waistband": {"width": 0.6}}
    pattern = draw_garment(size, design_from_dict(design))
    top, bottom = (lengths(pattern, edge, ("wb_front", "wb_back")) for edge in ("top", "bottom"))
    found = ease_of(pattern, build_box_mesh(pattern, spacing=2.0), body, size)["waist"]
    assert top - 0.01 <= found.cloth <= top + 2.0 / (0.6 * size.hips_line) * (bottom - top) + 0.01


def test_no_cloth_no_girth(neutral: tuple[Body, Measurements]) -> None:
    pattern, mesh = tube(50.0)
    found = ease_of(pattern, mesh, *neutral)
    assert np.isnan([found["hips"].cloth, found["wrist"].cloth, found["waist"].worn, found["back"].cloth]).all()
    assert found["wrist"].body == pytest.approx(neutral[1].wrist, abs=0.5)


def test_ease_is_stored_where_the_recipe_asks_and_changes_nothing_else() -> None:
    flat = MakeConfig(stage="mesh", resolution=5.0, points=64)
    plain, made = make(3, 0, flat), make(3, 0, replace(flat, ease=True))
    before, after = encode_sample(plain), encode_sample(made)
    assert {name for name in before | after if before.get(name) != after.get(name)} == {"meta.json"}
    assert b'"fit"' not in before["meta.json"]
    read = decode_sample(after).ease
    assert list(read) == list(EASE)
    assert all(str(read[name]) == str(made.ease[name]) for name in EASE)  # NaN differs from itself
    assert any(isinstance(ease, Ease) and ease.cloth > 0 for ease in read.values())
