"""Lines inside panels: edges of the mesh follow them, and their seams join layers."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcd_dataset.curves import LINE, Curve, Quadratic, sample_curve
from gcd_dataset.errors import MeshError
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.generator.mesh import build_box_mesh, coarse_start, coarsen
from gcd_dataset.generator.mesh.box_mesh import LAYERS
from gcd_dataset.generator.mesh.triangulate import flat_areas
from gcd_dataset.meshedges import mesh_edges, on_line
from gcd_dataset.records import BoxMesh, Closure, InnerLine, Panel, Pattern
from tests.generator.drape.garments import neutral
from tests.generator.mesh.shapes import panel, rectangle, seam, sewn
from tests.pleats import pleated_square

WIDTH, HEIGHT = 40.0, 30.0


def lined(
    points: Sequence[tuple[float, float]], lines: Sequence[tuple[int, int, Curve]], *, clockwise: bool = False
) -> Panel:
    """A rectangle with further vertices, from number 4 on, and lines."""
    corners = rectangle(WIDTH, HEIGHT)
    bare = panel("a", corners[:1] + corners[:0:-1] if clockwise else corners)
    vertices = np.concatenate([bare.vertices, np.array(points).reshape(-1, 2)])
    return replace(bare, vertices=vertices, lines=tuple(InnerLine(*line) for line in lines))


SQUARE = [(10.0, 10.0), (20.0, 10.0), (20.0, 20.0), (10.0, 20.0)]
DRAWN: dict[str, tuple[list[tuple[float, float]], list[tuple[int, int, Curve]]]] = {
    "from corner to corner": ([], [(0, 2, LINE)]),
    "into the panel": ([(20.0, 15.0)], [(0, 4, LINE)]),
    "off the outline": ([(10.0, 10.0), (20.0, 15.0), (25.0, 10.0)], [(4, 5, LINE), (5, 6, LINE)]),
    "a pocket with a flap": (
        [*SQUARE, (12.0, 12.0), (15.0, 15.0)],
        [*((4 + k, 4 + (k + 1) % 4, LINE) for k in range(4)), (8, 9, LINE)],
    ),
    "curved, and met by another": ([(10.0, 10.0), (30.0, 10.0)], [(4, 5, Quadratic((0.5, 0.5))), (0, 4, LINE)]),
    "a fork": ([(10.0, 10.0), (30.0, 10.0), (20.0, 25.0)], [(0, 4, LINE), (4, 5, LINE), (4, 6, LINE)]),
}


def edges_along(mesh: BoxMesh, own: Panel, index: int, spacing: float) -> np.ndarray:
    """Whether two neighbouring points of a line are an edge of the mesh, for each pair."""
    points = sample_curve(*own.edge_ends(index), own.edge(index).curve, round(own.lengths()[index] / spacing + 0.5) + 1)
    away = np.linalg.norm(mesh.uv[:, None] - points, axis=2)
    assert away.min(axis=0).max() < 1e-9
    rows = away.argmin(axis=0)
    known = set(map(tuple, np.sort(mesh_edges(mesh.corners).ends, axis=1).tolist()))
    return np.array([tuple(sorted(pair)) in known for pair in zip(rows[:-1].tolist(), rows[1:].tolist(), strict=True)])


@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("name", DRAWN)
def test_edges_of_the_mesh_follow_a_line(name: str, clockwise: bool) -> None:
    own = lined(*DRAWN[name], clockwise=clockwise)
    mesh = build_box_mesh(sewn(own), spacing=1.5)
    for index in range(4, 4 + len(own.lines)):
        assert edges_along(mesh, own, index, 1.5).all()
    areas = flat_areas(mesh.uv[mesh.corners])
    assert areas.sum() == pytest.approx((-1 if clockwise else 1) * WIDTH * HEIGHT)
    assert (np.sign(areas) == np.sign(areas.sum())).all()
    assert set(mesh.corners.ravel().tolist()) == set(range(len(mesh.uv)))  # no point is left out


inside = st.tuples(st.floats(3, WIDTH - 3), st.floats(3, HEIGHT - 3))


@given(inside, inside, st.booleans())
def test_any_line_is_followed(start: tuple[float, float], end: tuple[float, float], from_corner: bool) -> None:
    if np.hypot(start[0] - end[0], start[1] - end[1]) < 1.0:
        return
    own = lined([start, end], [(0 if from_corner else 4, 5, LINE)])
    mesh = build_box_mesh(sewn(own), spacing=3.0)
    assert edges_along(mesh, own, 4, 3.0).all()
    assert flat_areas(mesh.uv[mesh.corners]).min() > 0.0


def test_rounding_adds_no_point_between_a_line_and_the_outline() -> None:
    """A line, three spacings from a corner where the outline turns inwards; numpy may find 3.0000000000000004."""
    corners = [(0, 0), (0, -20), (20, -20), (20, 20), (-20, 20), (-20, 0)]
    sizes = set()
    for away in (3.0 - 1e-12, 3.0, 3.0 + 1e-12):
        start = away * np.array([np.cos(0.68), np.sin(0.68)])
        own = replace(panel("a", corners), vertices=np.array([*corners, start, 3 * start]), lines=(InnerLine(6, 7),))
        sizes.add(len(build_box_mesh(sewn(own), spacing=1.0).vertices))
    assert len(sizes) == 1


def overlapping(closed: tuple[float, float] = (0.0, 1.0)) -> Pattern:
    """Two squares of 10 cm that overlap by 4 cm: each has a line 2 cm from its edge, and the two lines are sewn."""
    halves = []
    for name, x, at in (("left", 8.0, 0.0), ("right", 2.0, 6.0)):
        corners = [(0.0, 0.0), (x, 0.0), (10.0, 0.0), (10.0, 10.0), (x, 10.0), (0.0, 10.0)]
        halves.append(replace(panel(name, corners, at=(at, 0.0, 0.0)), lines=(InnerLine(1, 4),)))
    joined = replace(seam(("left", 6), ("right", 6), right_wrong=True), closure=Closure.BUTTONS, closed=closed)
    return sewn(*halves, seams=(joined,))


def test_a_seam_of_lines_joins_two_layers_over_each_other() -> None:
    mesh = build_box_mesh(overlapping(), spacing=1.0)
    assert mesh.n_seam_vertices == 11
    assert len(mesh.vertices) == len(mesh.uv) - 11
    counts = mesh_edges(mesh.faces).counts
    assert (counts == 4).sum() == 10
    assert counts.max() == 4
    assert mesh.vertices[:11, 0] == pytest.approx(8.0)
    assert mesh.vertices[:11, 2] == pytest.approx(0.0)
    for number, sign in ((0, 1.0), (1, -1.0)):  # the left side of the seam lies outside
        assert (sign * mesh.vertices[np.unique(mesh.faces[mesh.panel_id == number]), 2]).min() >= 0.0
    with pytest.raises(MeshError, match="a seam runs inside a panel"):
        coarsen(mesh)
    assert coarse_start(build_box_mesh(overlapping(), spacing=0.3)) is None


def test_layers_are_apart_where_their_lines_are_open() -> None:
    mesh = build_box_mesh(overlapping((0.5, 1.0)), spacing=1.0)
    assert mesh.n_seam_vertices == 6
    at_line = np.abs(mesh.vertices[:, 0] - 8.0) < 1e-9
    heights = mesh.vertices[at_line & (mesh.vertices[:, 1] < 4.5), 2]
    assert sorted(set(np.round(heights, 6).tolist())) == [-0.5, 0.5]


def test_lines_that_meet_the_outline_are_named() -> None:
    for points, lines in (
        ([(20.0, 15.0), (50.0, 15.0)], [(4, 5, LINE)]),
        ([(20.0, 15.0), (30.0, 15.0)], [(0, 5, LINE), (1, 4, LINE)]),
    ):
        with pytest.raises(MeshError, match=r"panel a: a line near .* meets the outline or another line: part them"):
            build_box_mesh(sewn(lined(points, lines)), spacing=2.0)


def test_a_pleat_starts_folded_in_three_layers_in_order() -> None:
    """The cloth keeps its shape, and is as wide as the band; the mountain fold lies outside of the valley fold."""
    mesh = build_box_mesh(pleated_square(), spacing=2.0)
    own = mesh.panel_id == mesh.panel_names.index("skirt")
    rows = np.unique(mesh.corners[own])
    rows = rows[mesh.uv[rows, 1] < 11.0]
    placed = mesh.vertices[mesh.uv_vertex[rows]]
    assert np.isclose(np.ptp(placed[:, 0]), 12.0)
    x, depth = mesh.uv[rows, 0], placed[:, 2] - 10.0
    assert np.allclose(depth[x == 8.0], 0.5)
    assert np.allclose(depth[x == 12.0], -0.5)
    upper, under, lower = (depth[(x > low) & (x < low + 4.0)] for low in (4.0, 8.0, 12.0))
    assert upper.mean() > under.mean() > lower.mean()
    edges = mesh.uv_vertex[mesh.folds[:, :2].astype(int)]
    assert sorted(set(mesh.folds[:, 2].tolist())) == [-180.0, 180.0]
    assert (edges[:, 0] != edges[:, 1]).all()


@pytest.mark.parametrize("pleats", ["knife", "box", "inverted"])
def test_a_folded_panel_reaches_from_side_to_side(pleats: str) -> None:
    """Even if the line of a fold, extended, meets the panel again."""
    section = {"pleats": pleats, "count": 2, "depth": 0.9, "hips": 1.2, "length": 0.1, "rise": 0.6}
    design = design_from_dict({"meta": {"bottom": "PleatedSkirt"}, "pleated-skirt": section})
    front = draw_garment(neutral()[1], design).panel("skirt_front")
    mesh = build_box_mesh(sewn(front), spacing=4.0)
    numbers = [number for number, edge in enumerate(front.edges) if edge.name in ("right", "left")]
    sides = np.any([on_line(mesh.uv, front.edge_ends(number)) for number in numbers], axis=0)
    x = mesh.vertices[:, 0]
    on_sides = x[mesh.uv_vertex[sides]]
    assert (x >= on_sides.min() - 1e-6).all() and (x <= on_sides.max() + 1e-6).all()
    assert np.ptp(mesh.vertices[:, 2]) <= 1.5 * LAYERS
