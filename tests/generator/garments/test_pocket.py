"""Patch pockets: panels on panels, sewn to lines inside them; and which data sets draw them."""

from typing import Any

import numpy as np
import pytest

from gcd_dataset.errors import MeshError
from gcd_dataset.generator.body import build_body, neutral_shape
from gcd_dataset.generator.drape import DrapeJob, drape_batch
from gcd_dataset.generator.garments import design_from_dict, design_to_dict, draw_garment, sample_design
from gcd_dataset.generator.garments.drawn import described
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.garments.pocket import LIFT
from gcd_dataset.generator.mesh import build_box_mesh, coarsen
from gcd_dataset.records import LineRole, Measurements, Outcome
from tests.generator.garments.measured import errors, ref_length

POCKETS: dict[str, dict[str, Any]] = {
    "left_ftorso": {"meta": {"upper": "Shirt"}, "pocket": {"chest": "left"}},
    "pant_b_r": {"meta": {"bottom": "Pants"}, "pocket": {"back": "right"}},
}


@pytest.mark.parametrize("under", POCKETS)
def test_a_pocket_lies_outside_on_its_panel_and_is_sewn_to_its_lines(woman: Measurements, under: str) -> None:
    pattern = draw_garment(woman, design_from_dict(POCKETS[under]))
    assert not errors(pattern)
    seams = [seam for seam in pattern.seams if seam.left.panel == f"{under}_pocket"]
    assert [line.role for line in pattern.panel(under).lines] == [LineRole.PLACEMENT] * 3
    assert len(seams) == 3
    for seam in seams:
        assert ref_length(pattern, seam.left) == pytest.approx(ref_length(pattern, seam.right))
    mesh = build_box_mesh(pattern, spacing=2.0)
    first, second = (mesh.faces[mesh.panel_id == mesh.panel_names.index(name)] for name in (under, f"{under}_pocket"))
    inner = np.setdiff1d(second, first)
    around = np.intersect1d(first, second)
    assert len(around) and set(around.tolist()) <= set(mesh.seams[:, 0].tolist())
    depth = np.sign(mesh.vertices[first, 2].mean()) * mesh.vertices[:, 2]
    assert depth[inner].min() == pytest.approx(depth[np.setdiff1d(first, mesh.seams[:, 0])].max() + LIFT)
    with pytest.raises(MeshError, match="a seam runs inside a panel"):
        coarsen(mesh)


@pytest.mark.parametrize("under", POCKETS)
def test_a_welt_is_a_line_where_a_patch_has_its_top_edge(woman: Measurements, under: str) -> None:
    values = POCKETS[under]
    patched = draw_garment(woman, design_from_dict(values))
    welted = draw_garment(woman, design_from_dict(values | {"pocket": values["pocket"] | {"kind": "welt"}}))
    pocket, panel = patched.panel(f"{under}_pocket"), welted.panel(under)
    [top] = [i for i, edge in enumerate(pocket.edges) if edge.name == "top"]
    edge, line = (p.placement.apply(np.array(p.edge_ends(i))) for p, i in ((pocket, top), (panel, len(panel.edges))))
    assert np.sort(line[:, :2], axis=0) == pytest.approx(np.sort(edge[:, :2], axis=0))
    assert [own.role for own in panel.lines] == [LineRole.PLACEMENT]
    assert len(welted.panels) == len(patched.panels) - 1


@pytest.mark.parametrize("under", POCKETS)
def test_a_draped_pocket_stays_outside(woman: Measurements, under: str) -> None:
    body = build_body(neutral_shape(legs_apart="pant" in under))
    mesh = build_box_mesh(draw_garment(woman, design_from_dict(POCKETS[under])), spacing=3.0)
    [drape] = drape_batch([DrapeJob(mesh, body, woman)], device="cpu", at_once=1)
    assert (drape.outcome, drape.self_crossings, drape.body_crossings) == (Outcome.SETTLED, 0, 0)


def test_pockets_are_drawn_on_request() -> None:
    overlay = Overlay.from_dict({"meta": {"upper": "Shirt"}, "pocket": {"chest": "both"}})
    design = sample_design(np.random.default_rng(0), overlay=overlay)
    assert design.pockets() == ("right_ftorso", "left_ftorso")
    assert design_from_dict(design_to_dict(design)) == design


def test_pockets_have_words(woman: Measurements) -> None:
    design = design_from_dict(POCKETS["left_ftorso"])
    shirt, _ = described(woman, design, draw_garment(woman, design))
    assert shirt is not None
    assert shirt.details[-1].words == ("a chest pocket on the left",)
