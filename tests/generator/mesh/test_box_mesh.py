"""Box meshes: topology, geometry, labels and winding of patterns with known meshes, and of the reference's."""

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jaxtyping import Int
from scipy.spatial import cKDTree

from gcd_dataset.curves import Arc
from gcd_dataset.errors import MeshError
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.generator.garments.collar import Collar
from gcd_dataset.generator.garments.wardrobe import Upper
from gcd_dataset.generator.mesh import build_box_mesh, coarsen, turned_panels
from gcd_dataset.generator.mesh.triangulate import LONGEST
from gcd_dataset.generator.quality import sample_surface
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import BoxMesh, Closure, Panel, Pattern
from gcd_dataset.spec import read_pattern
from tests.generator.garments.conftest import DESIGNS, DRESS, WOMAN
from tests.generator.garments.measured import EXAMPLES
from tests.generator.mesh.shapes import (
    angles,
    areas,
    directed_edges,
    euler_characteristic,
    panel,
    rectangle,
    seam,
    sewn,
    sides,
    tube,
)

DART = [(0.0, 0.0), (8.0, 0.0), (10.0, 9.0), (12.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0)]
"""Edges 1 and 2 are the legs of a dart from the hem."""


def darted() -> Pattern:
    return sewn(panel("a", DART), seams=(seam(("a", 1), ("a", 2)),))


def patchwork() -> Pattern:
    """Two squares over two squares, all four sewn to their neighbours: edges 0 bottom, 1 right, 2 top, 3 left."""
    places = {"south_west": (0, 0), "south_east": (10, 0), "north_west": (0, 10), "north_east": (10, 10)}
    panels = [panel(name, rectangle(10.0, 10.0), at=(x, y, 0.0)) for name, (x, y) in places.items()]
    return sewn(
        *panels,
        seams=(
            seam(("south_west", 1), ("south_east", 3)),
            seam(("north_west", 1), ("north_east", 3)),
            seam(("south_west", 2), ("north_west", 0)),
            seam(("south_east", 2), ("north_east", 0)),
        ),
    )


def test_a_flat_panel_starts_unstretched_where_it_is_placed() -> None:
    mesh = build_box_mesh(sewn(panel("a", rectangle(12.0, 9.0), at=(1.0, 2.0, 3.0), turned=0.7)))
    ahead = mesh.vertices[np.roll(mesh.faces, -1, axis=1)] - mesh.vertices[np.roll(mesh.faces, 1, axis=1)]
    assert np.linalg.norm(ahead, axis=2) == pytest.approx(sides(mesh.uv, mesh.corners))
    assert mesh.vertices.min(axis=0)[1] == 2.0
    assert mesh.vertices[:, 0].max() == pytest.approx(1.0 + 12.0 * np.cos(0.7))


@pytest.mark.parametrize("clockwise", [False, True])
def test_faces_have_the_winding_of_the_loop(clockwise: bool) -> None:
    """The right side faces the viewer of a counter-clockwise loop: +z for one panel, -z for the other."""
    mesh = build_box_mesh(sewn(panel("a", rectangle(10.0, 10.0)[:: -1 if clockwise else 1])))
    assert (np.sign(areas(mesh.uv, mesh.corners)) == (-1 if clockwise else 1)).all()


def test_a_mirrored_panel_has_the_mirrored_mesh() -> None:
    """The same loop with negated x, as of a left and a right front: even the numbering is the same."""
    right = build_box_mesh(darted())
    left = build_box_mesh(sewn(panel("a", [(-x, y) for x, y in DART]), seams=(seam(("a", 1), ("a", 2)),)))
    assert left.uv == pytest.approx(right.uv * [-1, 1])
    assert np.array_equal(left.corners, right.corners)
    assert np.array_equal(left.faces, right.faces)


def test_a_tube_is_open_at_both_ends_and_its_seams_merge_points_in_the_middle() -> None:
    """Euler characteristic 0, two rims of 22 points minus 2 shared ones, 21 points less on each of the two seams."""
    pattern = tube()
    mesh = build_box_mesh(pattern)
    assert euler_characteristic(mesh) == 0
    faces_of_edge = mesh_edges(mesh.faces).counts
    assert (faces_of_edge == 1).sum() == 2 * 20
    assert faces_of_edge.max() == 2
    alone = sum(len(build_box_mesh(sewn(each)).vertices) for each in pattern.panels)
    assert len(mesh.uv) == alone
    assert len(mesh.vertices) == alone - 2 * 21
    assert mesh.n_seam_vertices == 2 * 21
    # The tube's sides are at z = 3 and -3.
    assert mesh.vertices[: mesh.n_seam_vertices, 2] == pytest.approx(0.0, abs=1e-9)
    assert np.abs(mesh.vertices[mesh.n_seam_vertices :, 2]) == pytest.approx(3.0)


def test_an_open_seam_leaves_its_vertices_apart_and_a_zip_joins_its_closed_part() -> None:
    """A tube with one seam open is a sheet, whose rim has both edges of the seam; 11 of 21 pairs meet in half a zip."""
    pattern = tube()
    alone = sum(len(build_box_mesh(sewn(each)).vertices) for each in pattern.panels)
    first, second = pattern.seams
    opened = build_box_mesh(replace(pattern, seams=(replace(first, closure=Closure.OPEN), second)))
    assert len(opened.vertices) == alone - 21
    assert set(opened.seams[:, 1]) == {1}
    assert euler_characteristic(opened) == 1
    assert (mesh_edges(opened.faces).counts == 1).sum() == 2 * 20 + 2 * 20
    zipped = build_box_mesh(replace(pattern, seams=(replace(first, closure=Closure.ZIP, closed=(0.0, 0.5)), second)))
    assert len(zipped.vertices) == alone - 21 - 11
    on_zip = zipped.seams[zipped.seams[:, 1] == 0, 0]
    assert zipped.vertices[on_zip, 1] == pytest.approx(np.arange(11.0))  # the left edge runs upwards from the hem
    assert coarsen(zipped).mesh.seams[:, 1].tolist().count(0) == 6
    closed = replace(pattern, seams=(replace(first, closure=Closure.BUTTONS), second))
    assert build_box_mesh(closed) == build_box_mesh(pattern)


def test_a_dart_closes() -> None:
    """The mouth of the dart becomes one vertex, and its legs are no longer on the rim."""
    mesh = build_box_mesh(darted())
    legs = 10  # √(2² + 9²) = 9.2 cm
    assert mesh.n_seam_vertices == legs + 1
    assert len(mesh.uv) - len(mesh.vertices) == legs
    assert euler_characteristic(mesh) == 1
    assert (mesh_edges(mesh.faces).counts == 1).sum() == 8 + 8 + 20 + 20 + 20
    assert mesh.vertices[mesh.seams[0, 0]] == pytest.approx([10.0, 0.0, 0.0])
    assert mesh.vertices[mesh.seams[legs, 0]] == pytest.approx([10.0, 9.0, 0.0])


def cone(opening: float) -> Pattern:
    """A triangle with an ``opening`` [degrees] at the origin, whose sides are sewn to each other."""
    tip = np.radians(opening)
    corners = [(0.0, 0.0), (20.0, 0.0), (20.0 * np.cos(tip), 20.0 * np.sin(tip))]
    return sewn(panel("cone", corners), seams=(seam(("cone", 0), ("cone", 2)),))


def test_a_cone_is_a_disc_if_a_face_is_left_at_its_tip() -> None:
    mesh = build_box_mesh(cone(150.0))
    assert euler_characteristic(mesh) == 1
    faces_of_edge = mesh_edges(mesh.faces).counts
    assert (faces_of_edge == 1).sum() == 39  # the hem: 40 · sin 75° = 38.6 cm
    # Sewing collapses a triangle across a sharp corner, which would leave the tip without a face.
    with pytest.raises(MeshError, match=r"panel cone: the corner at \(0.00, 0.00\) cm is sewn to itself"):
        build_box_mesh(cone(35.0))


def test_four_panels_meet_in_one_vertex() -> None:
    mesh = build_box_mesh(patchwork())
    middle = np.flatnonzero(np.bincount(mesh.uv_vertex) == 4)
    assert mesh.vertices[middle] == pytest.approx(np.array([[10.0, 10.0, 0.0]]))
    assert mesh.seams[mesh.seams[:, 0] == middle[0], 1].tolist() == [0, 1, 2, 3]
    assert euler_characteristic(mesh) == 1
    assert areas(mesh.vertices[:, :2], mesh.faces).sum() == pytest.approx(400.0)


def test_a_seam_ends_in_the_middle_of_another() -> None:
    """A yoke over two panels that are sewn to each other: the T-point is one vertex of three panels."""
    yoke = panel("yoke", [(0.0, 0.0), (10.0, 0.0), (20.0, 0.0), (20.0, 5.0), (0.0, 5.0)], at=(0.0, 10.0, 0.0))
    left, right = panel("left", rectangle(10.0, 10.0)), panel("right", rectangle(10.0, 10.0), at=(10.0, 0.0, 0.0))
    seams = (seam(("yoke", 0), ("left", 2)), seam(("yoke", 1), ("right", 2)), seam(("left", 1), ("right", 3)))
    mesh = build_box_mesh(sewn(yoke, left, right, seams=seams))
    meeting = np.flatnonzero(np.bincount(mesh.uv_vertex) == 3)
    assert mesh.vertices[meeting] == pytest.approx(np.array([[10.0, 10.0, 0.0]]))
    assert euler_characteristic(mesh) == 1
    assert areas(mesh.vertices[:, :2], mesh.faces).sum() == pytest.approx(300.0)


def test_a_patch_sewn_on_with_its_wrong_side_stays_in_place() -> None:
    """A copy of a panel, sewn to it start to start along an edge: nothing moves. End to start, the edge shrinks."""
    a, b = panel("a", rectangle(10.0, 10.0)), panel("b", rectangle(10.0, 10.0))
    on_top, twisted = (
        build_box_mesh(sewn(a, b, seams=(seam(("a", 1), ("b", 1), right_wrong=flag),))) for flag in (True, False)
    )
    assert on_top.vertices[on_top.uv_vertex][:, :2] == pytest.approx(on_top.uv)
    assert twisted.vertices[:11] == pytest.approx(np.tile([10.0, 5.0, 0.0], (11, 1)))


def test_a_gathered_seam_joins_all_points_of_both_sides() -> None:
    band = panel("band", rectangle(20.0, 3.0), at=(0.0, 20.0, 0.0))
    skirt = panel("skirt", rectangle(44.0, 20.0))
    mesh = build_box_mesh(sewn(band, skirt, seams=(seam(("band", 0), ("skirt", 2)),)))
    assert mesh.n_seam_vertices == 45
    assert (mesh_edges(mesh.faces).counts == 1).sum() == (20 + 3 + 3) + (44 + 20 + 20)  # no other edge gets more points
    assert euler_characteristic(mesh) == 1
    assert np.bincount(mesh.panel_id, areas(mesh.uv, mesh.corners)) == pytest.approx([60.0, 880.0])


def test_the_rest_shape_is_the_flat_panels() -> None:
    """The corners of each face are ``uv`` rows of its panel, and every row belongs to one panel."""
    mesh = build_box_mesh(patchwork())
    assert np.array_equal(mesh.uv_vertex[mesh.corners], mesh.faces)
    assert np.bincount(mesh.panel_id, areas(mesh.uv, mesh.corners)) == pytest.approx([100.0] * 4)
    assert np.array_equal(mesh.panel_of_row[mesh.corners], np.repeat(mesh.panel_id[:, None], 3, axis=1))
    assert mesh.panel_names == ("south_west", "south_east", "north_west", "north_east")
    assert (np.diff(mesh.panel_id) >= 0).all()


def labelled(left: str, right: str, free: str) -> Pattern:
    """Two squares side by side; the sides of their seam are labelled, and the top of the second."""
    a = panel("a", rectangle(5.0, 5.0), labels={1: left})
    b = panel("b", rectangle(5.0, 5.0), labels={3: right, 2: free}, at=(5.0, 0.0, 0.0))
    return sewn(a, b, seams=(seam(("a", 1), ("b", 3)),))


@pytest.mark.parametrize(("left", "right"), [("waist", ""), ("", "waist"), ("waist", "waist")])
def test_a_label_holds_all_vertices_of_a_seam_and_the_inner_vertices_of_a_free_edge(left: str, right: str) -> None:
    mesh = build_box_mesh(labelled(left, right, "collar"))
    assert set(mesh.labels) == {"waist", "collar"}
    assert mesh.labels["waist"].tolist() == [0, 1, 2, 3, 4, 5]
    collar = mesh.vertices[mesh.labels["collar"]]
    assert collar[:, 1] == pytest.approx(5.0)
    assert sorted(collar[:, 0].tolist()) == pytest.approx([6.0, 7.0, 8.0, 9.0])


def test_edges_with_one_label_form_one_set_of_vertices_and_contradictory_labels_are_an_error() -> None:
    """The collar is the seam and the free edge; their common point occurs once."""
    mesh = build_box_mesh(labelled("collar", "", "collar"))
    assert len(mesh.labels["collar"]) == 6 + 4
    assert (np.diff(mesh.labels["collar"]) > 0).all()
    with pytest.raises(MeshError, match=r"seam 0 \(a edge 1 to b edge 3\) joins labels left_collar and waist"):
        build_box_mesh(labelled("left_collar", "waist", ""))


BOW_TIE = panel("bow", [(0.0, 0.0), (10.0, 10.0), (10.0, 0.0), (0.0, 10.0)])
PINCHED = panel("pinched", [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (5.0, 0.0), (0.0, 10.0)])
NEEDLE = panel("needle", [(0.0, 0.0), (30.0, 0.0), (30.0, 0.02)])
LENS = panel("lens", [(0.0, 0.0), (0.4, 0.0)], curves={0: Arc(0.3, large=False, right=True)})


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (BOW_TIE, r"panel bow crosses or touches itself at \(5.00, 5.00\) cm, edges 0 and 2: move its edges apart"),
        (PINCHED, r"panel pinched crosses or touches itself at \(5.00, 0.00\) cm, edges 0 and 2 and 3"),
        (NEEDLE, r"panel needle is nearly a line, 0.01 cm wide: widen it or use a finer spacing"),
        (LENS, r"panel lens has 2 points at 1.0 cm: use a finer spacing"),
    ],
    ids=lambda value: value.name if isinstance(value, Panel) else "",
)
def test_a_panel_that_cannot_be_meshed_is_an_error(wrong: Panel, message: str) -> None:
    with pytest.raises(MeshError, match=message):
        build_box_mesh(sewn(panel("fine", rectangle(5.0, 5.0)), wrong))


@pytest.mark.parametrize(("side", "spacing"), [(1e9, 1.0), (1e5, 0.5), (2000.0, 1.0), (20.0, 1e-4), (20.0, 1e-12)])
def test_a_panel_with_too_many_points_is_an_error(side: float, spacing: float) -> None:
    with pytest.raises(MeshError, match=r"panel sail would get .* points.*: use a coarser spacing"):
        build_box_mesh(sewn(panel("sail", rectangle(side, side))), spacing=spacing)


@pytest.mark.parametrize("spacing", [0.0, -1.0, np.nan, np.inf])
def test_a_spacing_that_is_no_length_is_an_error(spacing: float) -> None:
    with pytest.raises(MeshError, match="give a positive one"):
        build_box_mesh(tube(), spacing=spacing)
    with pytest.raises(MeshError, match="pattern test has no panels"):
        build_box_mesh(sewn())


LAPELS = {"left_collar_front", "right_collar_front"}
ROUND = {"left_collar_back", "right_collar_back"}
BATTERY: dict[str, Mapping[str, Any]] = {
    **DESIGNS,
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
    pattern = draw_garment(WOMAN, design_from_dict(BATTERY[name]))
    mesh = build_box_mesh(pattern, spacing=5.0)
    # Two layers under buttons both face out, as do a pocket and its panel. Layers of a stack face out and in by turns,
    # and share their folds' ends.
    on_lines = {(panel.name, k + len(panel.edges)) for panel in pattern.panels for k in range(len(panel.lines))}
    layered = [
        row
        for row, seam in enumerate(pattern.seams)
        if seam.closure == "buttons" or pattern.layers(seam) or (seam.right.panel, seam.right.edge) in on_lines
    ]
    on_layers = mesh.seams[np.isin(mesh.seams[:, 1], layered), 0]
    twice = same_direction_edges(mesh.faces)
    assert np.isin(twice, [*on_layers, *mesh.uv_vertex[mesh.folds[:, :2].astype(int)].ravel()]).all()
    times = Counter(map(tuple, directed_edges(mesh.faces).tolist()))
    assert all(abs(times[a, b] - times[b, a]) <= 1 for a, b in times)  # 1 at a border
    if not layered:
        assert not len(same_direction_edges(coarsen(mesh).mesh.faces))


TURNED: dict[str, set[str]] = {
    "Shirt, SimpleLapel, standing True": LAPELS,
    "Shirt, SimpleLapel, standing False": LAPELS | ROUND,
    "Shirt, Hood2Panels, standing False": set(),
    "Shirt": set(),
    "Pants": set(),
}


@pytest.mark.parametrize("name", TURNED)
def test_lapels_alone_are_sewn_in_wrong_side_out(name: str) -> None:
    pattern = draw_garment(WOMAN, design_from_dict(BATTERY[name]))
    mesh = build_box_mesh(pattern, spacing=5.0)
    for each in (mesh, coarsen(mesh).mesh):
        assert set(turned_panels(pattern, each)) == TURNED[name]


def test_a_seam_of_right_to_wrong_turns_the_smaller_panel_over() -> None:
    """Both panels then have normals of one direction; the larger panel keeps the winding of its loop."""
    a, b = panel("a", rectangle(10.0, 10.0)), panel("b", rectangle(5.0, 10.0), at=(15.0, 0.0, 0.0), turned=np.pi)
    pattern = sewn(b, a, seams=(seam(("a", 1), ("b", 1), right_wrong=True),))
    mesh = build_box_mesh(pattern, spacing=1.0)
    assert turned_panels(pattern, mesh) == ("b",)
    assert not len(same_direction_edges(mesh.faces))
    points = sample_surface(mesh.vertices, mesh.faces, 200, np.random.default_rng(0))
    assert points[:, 5] == pytest.approx(1.0)
    assert np.bincount(mesh.panel_id, areas(mesh.uv, mesh.corners)) == pytest.approx([-50.0, 100.0])


def test_the_faces_of_a_moebius_strip_disagree_in_one_seam(caplog: pytest.LogCaptureFixture) -> None:
    """Three panels in a ring with one seam of right to wrong side form a one-sided band."""
    ring = [panel(name, rectangle(20.0, 5.0), at=(20.0 * k, 0.0, 0.0)) for k, name in enumerate("abc")]
    seams = (seam(("a", 1), ("b", 3)), seam(("b", 1), ("c", 3)), seam(("c", 1), ("a", 3), right_wrong=True))
    mesh = build_box_mesh(sewn(*ring, seams=seams), spacing=1.0)
    on_seam = [set(mesh.seams[mesh.seams[:, 1] == number, 0].tolist()) for number in range(3)]
    edges = same_direction_edges(mesh.faces)
    assert len(edges) == 5
    assert "closes a band with one side only" in caplog.text
    assert sum(set(edges.ravel().tolist()) <= vertices for vertices in on_seam) == 1


MESHES = {
    "dress_pencil": "dress_pencil_specification.json",
    **{
        f"ex_{name}": f"{name}/default_body/{name}_specification.json"
        for name in ("circle_skirt", "dress", "godet_skirt", "jumpsuit", "pants_cuff", "shirt_sleeves_hood")
    },
}


@pytest.mark.parametrize(("body", "spacing"), [("default_body", 1.0), ("random_body", 2.0)])
@pytest.mark.parametrize("name", EXAMPLES)
def test_every_design_has_a_sound_mesh(examples: Path, name: str, body: str, spacing: float) -> None:
    """Manifold, without long edges and unused vertices; only the outline may force slivers."""
    pattern = read_pattern(examples / "patterns" / name / body / f"{name}_specification.json")
    mesh = build_box_mesh(pattern, spacing=spacing)
    assert mesh_edges(mesh.faces).counts.max() == 2
    assert np.array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices)))
    assert sides(mesh.uv, mesh.corners).max() <= LONGEST * spacing
    assert np.median(sides(mesh.uv, mesh.corners)) == pytest.approx(0.97 * spacing, abs=0.01 * spacing)
    flat = mesh_edges(mesh.corners)
    on_border = np.isin(mesh.corners, flat.ends[flat.counts == 1])
    over_border = np.roll(on_border, -1, axis=1) & np.roll(on_border, 1, axis=1)
    assert (angles(mesh.uv, mesh.corners)[~over_border] > 20.0).all()


@pytest.fixture(scope="module", params=MESHES)
def both(request: pytest.FixtureRequest, examples: Path) -> tuple[BoxMesh, Any]:
    """This package's mesh and the reference's of the same pattern."""
    pattern = read_pattern(examples / "patterns" / MESHES[request.param])
    return build_box_mesh(pattern), np.load(examples / "meshes" / f"{request.param}.npz")


def test_panels_labels_and_numbers_are_the_references(both: tuple[BoxMesh, Any]) -> None:
    ours, reference = both
    assert ours.panel_names == tuple(reference["panel_names"])
    assert ours.panel_labels == tuple(reference["panel_labels"])
    assert len(ours.vertices) == pytest.approx(len(reference["vertices"]), rel=0.01)
    assert len(ours.faces) == pytest.approx(len(reference["faces"]), rel=0.015)
    labels = json.loads(str(reference["vertex_labels_json"]))
    assert {label: len(vertices) for label, vertices in ours.labels.items()} == {
        label: len(set(vertices)) for label, vertices in labels.items()
    }


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
    """Except where several seams meet: there the reference uses a running mean, this package the mean.

    It also lists fewer seams at such a vertex: the numbers of points of a seam may differ by 2.
    """
    ours, reference = both
    count = int(reference["n_stitch_vertices"])
    assert ours.n_seam_vertices == count
    apart, _ = cKDTree(reference["vertices"][:count]).query(ours.vertices[:count])
    single = np.bincount(ours.uv_vertex)[:count] <= 2
    assert apart[single].max() < 1e-3
    assert single.mean() > 0.8
    names = [name for row in reference["stitch_segmentation"] for name in str(row).split(",") if "stitch_" in name]
    theirs = np.unique(names, return_counts=True)[1]
    mine = np.bincount(ours.seams[:, 1])
    assert len(mine) == len(theirs)
    assert np.abs(np.sort(mine) - np.sort(theirs)).max() <= 2
