"""Our meshes of GarmentCode's patterns compared with the meshes of its own mesher."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.generator.mesh.triangulate import LONGEST
from gcd_dataset.records import BoxMesh
from gcd_dataset.spec import read_pattern
from tests.generator.mesh.shapes import angles, areas, directed_edges, sides, undirected_edges

DESIGNS = (
    "asymm_circle_skirt_lapel_dress", "asymmetric_top", "circle_skirt", "dress", "fitted_shirt", "godet_skirt",
    "jumpsuit", "levels_skirt", "pants_cuff", "pencil_skirt", "shirt_sleeves_hood", "strapless_dress",
)  # fmt: skip
MESHES = {
    "dress_pencil": "dress_pencil_specification.json",
    **{
        f"ex_{name}": f"{name}/default_body/{name}_specification.json"
        for name in ("circle_skirt", "dress", "godet_skirt", "jumpsuit", "pants_cuff", "shirt_sleeves_hood")
    },
}


@pytest.mark.parametrize("spacing", [1.0, 2.0])
@pytest.mark.parametrize("body", ["default_body", "random_body"])
@pytest.mark.parametrize("name", DESIGNS)
def test_every_design_has_a_sound_mesh(examples: Path, name: str, body: str, spacing: float) -> None:
    """Manifold, without long edges and unused vertices; only the outline may force slivers."""
    pattern = read_pattern(examples / "patterns" / name / body / f"{name}_specification.json")
    mesh = build_box_mesh(pattern, spacing=spacing)
    _, faces_of_edge = undirected_edges(mesh.faces)
    assert faces_of_edge.max() == 2
    assert np.array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices)))
    assert sides(mesh.uv, mesh.corners).max() <= LONGEST * spacing
    assert np.median(sides(mesh.uv, mesh.corners)) == pytest.approx(0.97 * spacing, abs=0.01 * spacing)
    on_border = outline_points(mesh)
    over_border = on_border[np.roll(mesh.corners, -1, axis=1)] & on_border[np.roll(mesh.corners, 1, axis=1)]
    assert (angles(mesh.uv, mesh.corners)[~over_border] > 20.0).all()


def outline_points(mesh: BoxMesh) -> np.ndarray:
    """Flags of the rows of ``uv`` on the outline of their panel."""
    edges, faces_of_edge = undirected_edges(mesh.corners)
    on_border = np.zeros(len(mesh.uv), bool)
    on_border[edges[faces_of_edge == 1]] = True
    return on_border


@pytest.fixture(scope="module", params=MESHES)
def both(request: pytest.FixtureRequest, examples: Path) -> tuple[BoxMesh, Any]:
    """This package's mesh and the reference's of the same pattern."""
    pattern = read_pattern(examples / "patterns" / MESHES[request.param])
    return build_box_mesh(pattern), np.load(examples / "meshes" / f"{request.param}.npz")


def test_panels_have_the_reference_order(both: tuple[BoxMesh, Any]) -> None:
    ours, reference = both
    assert ours.panel_names == tuple(reference["panel_names"])
    assert ours.panel_labels == tuple(reference["panel_labels"])


def test_numbers_of_vertices_and_faces_agree(both: tuple[BoxMesh, Any]) -> None:
    ours, reference = both
    assert len(ours.vertices) == pytest.approx(len(reference["vertices"]), rel=0.01)
    assert len(ours.faces) == pytest.approx(len(reference["faces"]), rel=0.015)


def test_panels_have_the_same_area_and_face_the_same_way(both: tuple[BoxMesh, Any]) -> None:
    """Sides are compared by normals in space: a panel may be drawn from behind, so signed flat areas can differ."""
    ours, reference = both
    ours_flat = np.bincount(ours.panel_id, np.abs(areas(ours.uv, ours.corners)))
    flat = np.bincount(reference["face_panel"], np.abs(areas(reference["panel_xy"], reference["face_uv"])))
    assert ours_flat == pytest.approx(flat, rel=1e-6)
    looks = facing(ours.vertices, ours.faces, ours.panel_id)
    assert (looks * facing(reference["vertices"], reference["faces"], reference["face_panel"])).sum(axis=1).min() > 0.99


def facing(vertices: np.ndarray, faces: np.ndarray, panel: np.ndarray) -> np.ndarray:
    """The mean normal of each panel."""
    a, b, c = vertices[faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    total = np.stack([np.bincount(panel, column) for column in normals.T], axis=1)
    return total / np.linalg.norm(total, axis=1, keepdims=True)


def test_seams_run_through_the_same_points(both: tuple[BoxMesh, Any]) -> None:
    """Except where several seams meet: there the reference uses a running mean, this package the mean."""
    ours, reference = both
    count = int(reference["n_stitch_vertices"])
    assert ours.n_seam_vertices == count
    apart, _ = cKDTree(reference["vertices"][:count]).query(ours.vertices[:count])
    single = np.bincount(ours.uv_vertex)[:count] <= 2
    assert apart[single].max() < 1e-3
    assert single.mean() > 0.8


def test_seams_have_the_reference_lengths(both: tuple[BoxMesh, Any]) -> None:
    """Lengths in points; the reference lists fewer seams at a vertex where several meet."""
    ours, reference = both
    names = [name for row in reference["stitch_segmentation"] for name in str(row).split(",") if "stitch_" in name]
    theirs = np.unique(names, return_counts=True)[1]
    mine = np.bincount(ours.seams[:, 1])
    assert len(mine) == len(theirs)
    assert np.abs(np.sort(mine) - np.sort(theirs)).max() <= 2


def test_labels_hold_as_many_vertices(both: tuple[BoxMesh, Any]) -> None:
    ours, reference = both
    labels = json.loads(str(reference["vertex_labels_json"]))
    assert {label: len(vertices) for label, vertices in ours.labels.items()} == {
        label: len(set(vertices)) for label, vertices in labels.items()
    }


def test_cloth_faces_out_on_both_sides_of_every_seam(both: tuple[BoxMesh, Any]) -> None:
    ours, _ = both
    edges = directed_edges(ours.faces)
    assert len(np.unique(edges, axis=0)) == len(edges)
