"""Faces have the same winding across every seam, also with panels sewn in wrong side out."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from jaxtyping import Float, Int

from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.generator.garments.collar import Collar
from gcd_dataset.generator.garments.wardrobe import Upper
from gcd_dataset.generator.mesh import build_box_mesh, coarsen, turned_panels
from gcd_dataset.generator.quality import sample_surface
from gcd_dataset.records import BoxMesh
from tests.generator.garments.conftest import DRESS, OUTFITS, WOMAN
from tests.generator.mesh.shapes import areas, directed_edges, panel, rectangle, seam, sewn, tube

LAPELS = {"left_collar_front", "right_collar_front"}
ROUND = {"left_collar_back", "right_collar_back"}
BATTERY: dict[str, Mapping[str, Any]] = {
    **OUTFITS,
    **{
        f"{upper.value}, {collar.value}, standing {standing}": {
            "meta": DRESS | {"upper": upper.value},
            "collar": {"component": {"style": collar.value, "lapel_standing": standing}},
        }
        for upper in (Upper.FITTED, Upper.SHIRT)  # a cape has no collar
        for collar in Collar
        for standing in (False, True)
    },
}


def same_direction_edges(faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "n 2"]:
    """Edges with the same direction in two faces."""
    edges, times = np.unique(directed_edges(faces), axis=0, return_counts=True)
    return edges[times > 1]


@pytest.mark.parametrize("name", BATTERY)
def test_no_directed_edge_occurs_twice(name: str) -> None:
    mesh = build_box_mesh(draw_garment(WOMAN, design_from_dict(BATTERY[name])), spacing=5.0)
    assert not len(same_direction_edges(mesh.faces))
    assert not len(same_direction_edges(coarsen(mesh).mesh.faces))


@pytest.mark.parametrize(("standing", "expected"), [(True, LAPELS), (False, LAPELS | ROUND)])
def test_lapels_are_sewn_in_wrong_side_out(standing: bool, expected: set[str]) -> None:
    collar = {"component": {"style": "SimpleLapel", "lapel_standing": standing}}
    pattern = draw_garment(WOMAN, design_from_dict({"meta": {"upper": "Shirt"}, "collar": collar}))
    mesh = build_box_mesh(pattern, spacing=5.0)
    assert set(turned_panels(pattern, mesh)) == expected
    assert set(turned_panels(pattern, coarsen(mesh).mesh)) == expected


@pytest.mark.parametrize("name", ["shirt", "Pants", "Shirt, Hood2Panels, standing False"])
def test_other_garments_have_no_turned_panel(name: str) -> None:
    pattern = draw_garment(WOMAN, design_from_dict(BATTERY[name]))
    assert turned_panels(pattern, build_box_mesh(pattern, spacing=5.0)) == ()


def test_a_seam_of_right_to_wrong_turns_the_smaller_panel_over() -> None:
    """Both panels then have normals of one direction; the larger panel keeps the winding of its loop."""
    a, b = panel("a", rectangle(10.0, 10.0)), panel("b", rectangle(5.0, 10.0), at=(15.0, 0.0, 0.0), turned=np.pi)
    pattern = sewn(b, a, seams=(seam(("a", 1), ("b", 1), right_wrong=True),))
    mesh = build_box_mesh(pattern, spacing=1.0)
    assert turned_panels(pattern, mesh) == ("b",)
    assert not len(same_direction_edges(mesh.faces))
    points = sample_surface(mesh.vertices, mesh.faces, 200, np.random.default_rng(0))
    assert points[:, 5] == pytest.approx(1.0)
    assert np.bincount(mesh.panel_id, signed(mesh)) == pytest.approx([-50.0, 100.0])


def test_seams_of_right_sides_turn_no_panel_over() -> None:
    pattern = tube()
    assert turned_panels(pattern, build_box_mesh(pattern, spacing=2.0)) == ()


def test_the_faces_of_a_moebius_strip_disagree_in_one_seam(caplog: pytest.LogCaptureFixture) -> None:
    """Three panels in a ring with one seam of right to wrong side form a one-sided band."""
    ring = [panel(name, rectangle(20.0, 5.0), at=(20.0 * k, 0.0, 0.0)) for k, name in enumerate("abc")]
    seams = (
        seam(("a", 1), ("b", 3)),
        seam(("b", 1), ("c", 3)),
        seam(("c", 1), ("a", 3), right_wrong=True),
    )
    mesh = build_box_mesh(sewn(*ring, seams=seams), spacing=1.0)
    on_seam = [set(mesh.seams[mesh.seams[:, 1] == number, 0].tolist()) for number in range(3)]
    edges = same_direction_edges(mesh.faces)
    assert len(edges) == 5
    assert "closes a band with one side only" in caplog.text
    assert sum(set(edges.ravel().tolist()) <= vertices for vertices in on_seam) == 1


def signed(mesh: BoxMesh) -> Float[np.ndarray, " f"]:
    return areas(mesh.uv, mesh.corners)
