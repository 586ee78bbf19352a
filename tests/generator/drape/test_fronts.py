"""Fronts with buttons in the drape: two layers of cloth, joined along the centre front."""

import numpy as np
import pytest
import trimesh
from jaxtyping import Bool, Float, Int

from gcd_dataset.generator.device import to_host
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob, drape_batch
from gcd_dataset.generator.drape.topology import build_topology
from gcd_dataset.generator.ease import ease_of
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.records import BoxMesh, Outcome, Pattern
from tests.generator.drape.garments import neutral


def shirt(closure: str, **front: float | str) -> tuple[Pattern, BoxMesh]:
    """A shirt and its mesh."""
    design = design_from_dict({"meta": {"upper": "Shirt"}, "front": {"closure": closure, **front}})
    pattern = draw_garment(neutral()[1], design)
    return pattern, build_box_mesh(pattern, spacing=2.0)


def extension(pattern: Pattern, mesh: BoxMesh, panel: str) -> Int[np.ndarray, " n"]:
    """The vertices of a front beyond its line."""
    own = pattern.panel(panel)
    start, end = np.array(own.edge_ends(len(own.edges)))
    across = np.array([start[1] - end[1], end[0] - start[0]])
    across = across * np.sign(((own.vertices - start) @ across).sum())
    rows = np.unique(mesh.corners[mesh.panel_id == mesh.panel_names.index(panel)])
    return mesh.uv_vertex[rows[(mesh.uv[rows] - start) @ across < -1e-6]]


def lies_outside(
    mesh: BoxMesh, at: Float[np.ndarray, "v 3"], panel: str, vertices: Int[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Whether vertices lie on the outer side of the nearest face of a panel."""
    faces = mesh.faces[mesh.panel_id == mesh.panel_names.index(panel)]
    triangles = np.tile(at[faces], (len(vertices), 1, 1))
    nearest = trimesh.triangles.closest_point(triangles, np.repeat(at[vertices], len(faces), axis=0))
    away = at[vertices][:, None] - nearest.reshape(len(vertices), len(faces), 3)
    best = np.linalg.norm(away, axis=2).argmin(axis=1)
    normals = np.cross(at[faces[:, 1]] - at[faces[:, 0]], at[faces[:, 2]] - at[faces[:, 0]])[best]
    return (away[np.arange(len(best)), best] * normals).sum(axis=1) > 0.0


@pytest.mark.parametrize(("over", "under", "front"), [("left", "right", {}), ("right", "left", {"open_top": 0.25})])
def test_the_upper_front_stays_outside(over: str, under: str, front: dict[str, float]) -> None:
    body, size = neutral()
    pattern, mesh = shirt("buttons", over=over, **front)
    [drape] = drape_batch([DrapeJob(mesh, body, size)], device="cpu", at_once=1)
    assert (drape.outcome, drape.self_crossings, drape.body_crossings) == (Outcome.SETTLED, 0, 0)
    for positions in (mesh.vertices, drape.vertices):
        for side, other, is_over in ((over, under, True), (under, over, False)):
            own = extension(pattern, mesh, f"{side}_ftorso")
            assert len(own) > 10
            assert (lies_outside(mesh, np.asarray(positions, float), f"{other}_ftorso", own) == is_over).all()


def test_a_buttoned_shirt_is_as_wide_as_a_sewn_one() -> None:
    """Its extensions lie over the fronts and add nothing to its girth."""
    body, size = neutral()
    garments = [shirt(closure) for closure in ("sewn", "buttons")]
    drapes = drape_batch([DrapeJob(mesh, body, size) for _, mesh in garments], device="cpu", at_once=1)
    figures = [ease_of(*garment, body, size, drape.vertices) for garment, drape in zip(garments, drapes, strict=True)]
    for girth in ("bust", "underbust", "waist"):
        sewn, buttoned = (figure[girth] for figure in figures)
        assert (buttoned.cloth, buttoned.worn) == pytest.approx((sewn.cloth, sewn.worn), rel=0.01)


def test_each_layer_bends_on_its_own_over_a_sewn_line() -> None:
    """Every segment of the line is two edges, each with a hinge of the faces of one panel."""
    pattern, mesh = shirt("buttons")
    topology = build_topology([DrapeJob(mesh, *neutral())], DrapeConfig(), [np.zeros(0, int)], "cpu")
    ends, across = (to_host(array) for array in (topology.surface.edges, topology.surface.opposite))
    [row] = [row for row, seam in enumerate(pattern.seams) if seam.closure == "buttons"]
    on_line = mesh.seams[mesh.seams[:, 1] == row, 0]
    rows = np.isin(ends, on_line).all(axis=1)
    assert rows.sum() == 2 * (len(on_line) - 1)
    panels = np.zeros(len(mesh.vertices), int)
    panels[mesh.uv_vertex] = mesh.panel_of_row
    hinges = panels[across[rows]]
    assert (hinges[:, 0] == hinges[:, 1]).all()
    assert {mesh.panel_names[number] for number in hinges.ravel()} == {"left_ftorso", "right_ftorso"}
