"""The box mesh of a pattern: panels triangulated flat, placed round the body, and joined along the seams.

Most seams join right side to right side, and the faces on both sides have the same winding. A seam of right side to
wrong side, such as a lapel's, turns the cloth over: beyond it the outside of the garment is the panel's wrong side.
A seam along a line turns no cloth over: there panels lie on each other.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
import shapely.ops
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from gcd_dataset.curves import reflection, sample_curve, signed_area
from gcd_dataset.errors import MeshError
from gcd_dataset.generator.mesh.regions import fill_regions
from gcd_dataset.generator.mesh.rows import distinct, stable_order
from gcd_dataset.generator.mesh.stitch import (
    MOST_POINTS,
    Border,
    edge_counts,
    mean_positions,
    merge_points,
    proper_faces,
    sample_border,
    seam_name,
    stitch_points,
)
from gcd_dataset.generator.mesh.triangulate import (
    Filling,
    Fillings,
    barycentric,
    fill_outline,
    flat_areas,
    lattice_size,
)
from gcd_dataset.meshedges import ON_FOLD, fold_edges, mesh_edges, on_line
from gcd_dataset.records import BoxMesh, Closure, EdgeRef, Panel, Pattern, Seam

SAMPLES = 17  # points of an edge, for the sign of a loop's area


def turned_panels(pattern: Pattern, mesh: BoxMesh) -> tuple[str, ...]:
    """Names of the panels with their wrong side out: their faces have the opposite winding of the pattern's loops."""
    flat = np.bincount(mesh.panel_id, flat_areas(mesh.uv[mesh.corners]), minlength=len(mesh.panel_names))
    loops = {}
    for panel in pattern.panels:
        edges = [sample_curve(*panel.edge_ends(i), edge.curve, SAMPLES)[:-1] for i, edge in enumerate(panel.edges)]
        loops[panel.name] = signed_area(np.concatenate(edges))
    return tuple(name for name, area in zip(mesh.panel_names, flat, strict=True) if area * loops[name] < 0)


def turned_over(names: Sequence[str], areas: Float[np.ndarray, " p"], seams: Sequence[Seam]) -> Bool[np.ndarray, " p"]:
    """Flags of the panels to turn over, so that all seams, of edges alone, join faces of the same winding.

    Of each set of connected panels the part with the larger area (``areas``, flat) stays right side out. A one-sided
    band (a Möbius strip) cannot satisfy all of its seams: at least one joins faces of opposite windings.
    """
    turned = np.zeros(len(names), bool)
    if not any(seam.right_wrong for seam in seams):
        return turned
    number, turns = {name: row for row, name in enumerate(names)}, dict[tuple[int, int], bool]()
    for seam in seams:
        left, right = number[seam.left.panel], number[seam.right.panel]
        turns[left, right] = turns[right, left] = turns.get((left, right), seam.right_wrong)
    graph = coo_array((np.ones(len(turns)), np.transpose(list(turns))), shape=(len(names), len(names))).tocsr()
    waiting = set(range(len(names)))
    while waiting:
        connected, before = breadth_first_order(graph, min(waiting), directed=False)
        for panel in connected[1:].tolist():
            turned[panel] = turned[before[panel]] != turns[int(before[panel]), panel]
        if areas[connected][turned[connected]].sum() > areas[connected][~turned[connected]].sum():
            turned[connected] = ~turned[connected]
        waiting -= set(connected.tolist())
    return turned


log = logging.getLogger(__name__)

NARROWEST = 0.05  # spacings: the least mean width of a panel; triangles of narrower panels are slivers
LAYERS = 1.0  # cm between two overlapping panels before sewing
TOUCH = 1e-6  # cm: an edge nearer than this to a reported crossing takes part in it


def build_box_mesh(pattern: Pattern, *, spacing: float = 1.0) -> BoxMesh:
    """The box mesh of a pattern, its points at most ``spacing`` [cm] apart along every edge.

    Both sides of a seam get the number of points that the longer side needs. Inside a panel the median mesh edge is
    0.97 spacings long and the longest 1.43; angles exceed 20° except where the points of the outline forbid it: in
    sharper corners, beside slits, and along edges much shorter than the spacing.

    Faces on both sides of a seam have the same winding, counter-clockwise as seen from outside the garment. Outside is
    the right side of the cloth except on panels that their seams turn over, such as lapels: see ``turned_panels``.
    Where buttons join two lines, the overlapping panels start ``LAYERS`` apart, the left one of the seam outside.
    Folds with a rest angle over 90° start folded flat, mountain folds ``LAYERS`` outside of valley folds.

    Raises ``MeshError`` for a panel or a seam that cannot be meshed, with its name and a remedy.
    """
    if not 0.0 < spacing < np.inf:
        raise MeshError(f"a spacing of {spacing} cm makes no mesh: give a positive one")
    if not pattern.panels:
        raise MeshError(f"pattern {pattern.name} has no panels: there is nothing to mesh")
    panels = _mesh_panels(pattern, spacing)
    edges = panels.edges(pattern)
    panels = replace(panels, positions=_folded(panels, pattern))
    sewn = stitch_points(pattern.seams, [(edges[seam.left], edges[seam.right]) for seam in pattern.seams])
    vertex = merge_points(sewn, panels.panel_of_point, pattern.seams)
    corners = _consistent_corners(panels, pattern)
    faces = vertex[corners]
    proper = proper_faces(faces)  # sewing two corners together collapses a triangle
    _require_faces(faces[proper], vertex, panels, pattern)
    corners = _in_order(corners[proper])
    return BoxMesh(
        vertices=mean_positions(_layered(panels, pattern, edges, vertex), vertex),
        faces=vertex[corners],
        uv=panels.uv,
        corners=corners,
        uv_vertex=vertex,
        panel_id=panels.panel_of_point[corners[:, 0]],
        panel_names=tuple(panel.name for panel in pattern.panels),
        panel_labels=tuple(panel.label for panel in pattern.panels),
        seams=np.stack([vertex[sewn.left], sewn.seam], axis=1),
        labels=_labels(pattern, edges, vertex),
        folds=fold_edges(pattern, panels.uv, corners, panels.panel_of_point[corners[:, 0]]),
    )


@dataclass(frozen=True)
class _MeshedPanels:
    """All panels triangulated but not yet sewn; ``c`` counts the points of all panels."""

    uv: Float[np.ndarray, "c 2"]  # positions in the plane of each panel [cm]
    positions: Float[np.ndarray, "c 3"]  # positions round the body [cm]
    corners: Int[np.ndarray, "f 3"]
    panel_of_point: Int[np.ndarray, " c"]
    borders: tuple[Border, ...]
    first: Int[np.ndarray, " p"]  # the first point of each panel

    def points_of(self, panel: int) -> Int[np.ndarray, " n"]:
        """The points of a panel."""
        return np.flatnonzero(self.panel_of_point == panel)

    def edges(self, pattern: Pattern) -> dict[EdgeRef, Int[np.ndarray, " n"]]:
        """The points of every edge, from start to end."""
        return {
            EdgeRef(panel.name, index): first + border.edge(index)
            for panel, border, first in zip(pattern.panels, self.borders, self.first, strict=True)
            for index in range(len(panel.edges) + len(panel.lines))
        }


def _mesh_panels(pattern: Pattern, spacing: float) -> _MeshedPanels:
    counts = edge_counts(pattern, spacing)
    borders = tuple(sample_border(panel, counts) for panel in pattern.panels)
    _require_room(pattern, borders, spacing)
    cache: Fillings = {}
    meshes = [_mesh_panel(panel, border, spacing, cache) for panel, border in zip(pattern.panels, borders, strict=True)]
    sizes = np.array([len(points) for points, _ in meshes])
    first = np.cumsum(sizes) - sizes
    return _MeshedPanels(
        uv=np.concatenate([points for points, _ in meshes]),
        positions=np.concatenate(
            [panel.placement.apply(points) for panel, (points, _) in zip(pattern.panels, meshes, strict=True)]
        ),
        corners=np.concatenate([offset + faces for offset, (_, faces) in zip(first, meshes, strict=True)]),
        panel_of_point=np.repeat(np.arange(len(meshes)), sizes),
        borders=borders,
        first=first,
    )


def _folded(panels: _MeshedPanels, pattern: Pattern) -> Float[np.ndarray, "c 3"]:
    """The positions with all folds of more than 90° folded flat; of each panel the cloth nearest its middle stays.

    Heights above the panel's plane, on its right side: half of ``LAYERS`` at mountain folds, less at valley folds,
    linear between two folds.
    """
    positions = panels.positions.copy()
    for number, panel in enumerate(pattern.panels):
        creases = [line for line in panel.lines if abs(line.angle) > 90.0]
        if not creases:
            continue
        faces = panels.corners[panels.panel_of_point[panels.corners[:, 0]] == number]
        ends = panel.vertices[[[line.start, line.end] for line in creases]]
        layer, beside = _layers(faces, panels.uv, ends)
        turns, waiting = {0: np.eye(3)}, [0]
        while waiting:
            row = waiting.pop()
            for other, k in beside[row]:
                if other not in turns:
                    turns[other] = turns[row] @ reflection(*ends[k])
                    waiting.append(other)
        # Of the larger part of the cloth, which lies right side out, the layer nearest the middle stays.
        areas = np.bincount(layer, np.abs(flat_areas(panels.uv[faces])))
        out = np.array([np.linalg.det(turns[row]) > 0.0 for row in range(len(areas))])
        seen = out if areas[out].sum() >= areas[~out].sum() else ~out
        middle = panels.uv[panels.points_of(number)].mean(axis=0)
        at = np.array([panels.uv[faces[layer == row]].mean(axis=(0, 1)) for row in range(len(areas))])
        stays = np.linalg.inv(turns[int(np.argmin(np.where(seen, np.linalg.norm(at - middle, axis=1), np.inf)))])
        facing = signed_area(panel.vertices[[edge.start for edge in panel.edges]])
        outwards = np.copysign(1.0, facing) * panel.placement.matrix[:, 2]
        heights = 0.5 * LAYERS * np.sign([line.angle for line in creases])
        for row, turn in turns.items():
            points, bounds = np.unique(faces[layer == row]), [k for _, k in beside[row]]
            along = ends[bounds, 1] - ends[bounds, 0]
            along /= np.linalg.norm(along, axis=1)[:, None]
            off = panels.uv[points][:, None] - ends[bounds, 0]
            weights = 1.0 / np.maximum(np.abs(off[..., 0] * along[:, 1] - off[..., 1] * along[:, 0]), TOUCH)
            height = (weights * heights[bounds]).sum(axis=1) / weights.sum(axis=1)
            height[(weights < 1.0 / ON_FOLD).all(axis=1) & seen[row]] *= 1.5
            moved = stays @ turn
            flat = panels.uv[points] @ moved[:2, :2].T + moved[:2, 2]
            positions[points] = panel.placement.apply(flat) + height[:, None] * outwards
    return positions


def _layers(
    faces: Int[np.ndarray, "f 3"], uv: Float[np.ndarray, "c 2"], folds: Float[np.ndarray, "k 2 2"]
) -> tuple[Int[np.ndarray, " f"], list[list[tuple[int, int]]]]:
    """The part between folds of each face; for each part the parts beside it, with the folds between them."""
    edges = mesh_edges(faces)
    fold = np.full(len(edges.ends), -1)
    for k, ends in enumerate(folds):
        fold[on_line(uv[edges.ends], ends).all(axis=1)] = k
    sides = np.argsort(edges.of_faces.ravel(), kind="stable")
    number = edges.of_faces.ravel()[sides]
    inner = np.flatnonzero(number[1:] == number[:-1])
    pairs, between = np.stack([sides[inner], sides[inner + 1]]) // 3, fold[number[inner]]
    graph = coo_array((np.ones((between < 0).sum()), pairs[:, between < 0]), shape=(len(faces), len(faces)))
    count, layer = connected_components(graph, directed=False)
    beside: list[list[tuple[int, int]]] = [[] for _ in range(count)]
    rows = np.column_stack([layer[pairs].T, between])[between >= 0]
    for one, other, k in np.unique(rows, axis=0).tolist():
        beside[one].append((other, k))
        beside[other].append((one, k))
    return layer, beside


def _layered(
    panels: _MeshedPanels,
    pattern: Pattern,
    edges: Mapping[EdgeRef, Int[np.ndarray, " n"]],
    vertex: Int[np.ndarray, " c"],
) -> Float[np.ndarray, "c 3"]:
    """The positions, where buttons join two lines moved along the panels' normals, so that no layer starts in another.

    Of each panel the extension, the smaller part beyond the line, is moved by ``LAYERS``, the line by half of it, and
    the cloth before the line by less the further it is, down to nothing at the extension's width. Then the extension
    follows the cloth under it that seams draw aside, as to a collar.
    """
    number = {panel.name: row for row, panel in enumerate(pattern.panels)}
    positions, extensions = panels.positions.copy(), []
    for seam in pattern.seams:
        if seam.closure != Closure.BUTTONS:
            continue
        for side, other, outwards in ((seam.left, seam.right, LAYERS), (seam.right, seam.left, -LAYERS)):
            panel, own = pattern.panels[number[side.panel]], panels.points_of(number[side.panel])
            if side.edge < len(panel.edges):
                continue
            line = shapely.LineString(panels.uv[edges[side]])
            parts = shapely.ops.split(shapely.Polygon(panels.borders[number[side.panel]].points), line).geoms
            smaller, points = min(parts, key=lambda part: part.area), shapely.points(panels.uv[own])
            beyond = shapely.distance(line, points) * np.where(shapely.intersects(smaller, points), 1.0, -1.0)
            share = np.clip(0.5 + 0.5 * beyond / beyond.max(), 0.0, 1.0)
            positions[own] += outwards * share[:, None] * panel.placement.matrix[:, 2]
            extensions.append((own[beyond > TOUCH], number[other.panel]))
    if not extensions:
        return positions
    drawn = mean_positions(positions, vertex)[vertex] - positions
    for own, under in extensions:
        faces = panels.corners[panels.panel_of_point[panels.corners[:, 0]] == under]
        placement = pattern.panels[under].placement
        at = (panels.positions[own] - placement.translation) @ placement.matrix[:, :2]
        rows, found = shapely.STRtree(shapely.polygons(panels.uv[faces])).query(shapely.points(at), "intersects")
        rows, first = np.unique(rows, return_index=True)
        faces = faces[found[first]]
        positions[own[rows]] += np.einsum("kn,nkd->nd", barycentric(panels.uv, faces, at[rows]), drawn[faces])
    return positions


def _consistent_corners(panels: _MeshedPanels, pattern: Pattern) -> Int[np.ndarray, "f 3"]:
    """The corners of all faces, in reversed order on panels that are sewn in wrong side out."""
    edges = {panel.name: len(panel.edges) for panel in pattern.panels}
    seams = {
        number: seam
        for number, seam in enumerate(pattern.seams)
        if all(side.edge < edges[side.panel] for side in (seam.left, seam.right))
    }
    if not any(seam.right_wrong for seam in seams.values()):
        return panels.corners
    panel = panels.panel_of_point[panels.corners[:, 0]]
    areas = np.bincount(panel, np.abs(flat_areas(panels.uv[panels.corners])), minlength=len(pattern.panels))
    names = [panel.name for panel in pattern.panels]
    turned = turned_over(names, areas, tuple(seams.values()))
    over = dict(zip(names, turned.tolist(), strict=True))
    for number, seam in seams.items():
        if seam.right_wrong != (over[seam.left.panel] != over[seam.right.panel]):
            name = seam_name(number, seam)
            log.warning(
                "%s: %s closes a band with one side only: the faces along it have opposite windings", pattern.name, name
            )
    return np.where(turned[panel, None], panels.corners[:, [0, 2, 1]], panels.corners)


def _in_order(corners: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "f 3"]:
    """The faces sorted, each from its least corner: panel by panel, and small when stored.

    No two faces share their first two corners in the same order.
    """
    a, b, c = np.ascontiguousarray(corners.T)
    first = np.minimum(np.minimum(a, b), c)
    second = np.where(a == first, b, np.where(b == first, c, a))
    order = stable_order(first * np.int64(second.max(initial=0) + 1) + second)
    return np.stack([first[order], second[order], (a + b + c - first - second)[order]], axis=1)


def _mesh_panel(panel: Panel, border: Border, spacing: float, cache: Fillings) -> Filling:
    """Points of a panel, border first, and triangles with the winding of its loop: counter-clockwise from outside."""
    _require_outline(panel, border, spacing)
    try:
        if not border.lines:
            return fill_outline(border.points, spacing, cache)
        return fill_regions(
            np.concatenate([border.points, border.inner]), len(border.points), border.lines, spacing, cache
        )
    except MeshError as error:
        raise MeshError(f"panel {panel.name}: {error}") from error


def _require_room(pattern: Pattern, borders: Sequence[Border], spacing: float) -> None:
    """Raise ``MeshError`` for panels whose bounding boxes take too many lattice points together."""
    sizes = {
        panel.name: lattice_size(border.points, spacing) for panel, border in zip(pattern.panels, borders, strict=True)
    }
    if (total := sum(sizes.values())) > MOST_POINTS:
        largest = max(sizes, key=lambda name: sizes[name])
        raise MeshError(
            f"panel {largest} would get {sizes[largest]:.3g} points at {spacing:g} cm, all panels {total:.3g}, over "
            f"{MOST_POINTS:,}: use a coarser spacing"
        )


def _require_outline(panel: Panel, border: Border, spacing: float) -> None:
    """Raise ``MeshError`` for a panel that is nearly a line or crosses itself."""
    if len(border.points) < 3:
        raise MeshError(f"panel {panel.name} has {len(border.points)} points at {spacing} cm: use a finer spacing")
    outline = shapely.Polygon(border.points)
    if not outline.is_valid:
        raise MeshError(f"panel {panel.name} crosses or touches itself{_where(outline, border)}: move its edges apart")
    width = 2 * outline.area / outline.length
    if width < NARROWEST * spacing:
        raise MeshError(f"panel {panel.name} is nearly a line, {width:.2g} cm wide: widen it or use a finer spacing")


def _where(outline: shapely.Polygon, border: Border) -> str:
    """`` at (x, y) cm, edges i and j``: the crossing of an invalid outline; empty if Shapely gives no position."""
    reason = shapely.is_valid_reason(outline)
    if "[" not in reason:
        return ""
    x, y = (float(number) for number in reason.split("[")[1].rstrip("]").split()[:2])
    lines = [shapely.LineString(border.points[border.edge(index)]) for index in range(len(border.first) - 1)]
    near = [str(index) for index, line in enumerate(lines) if line.distance(shapely.Point(x, y)) < TOUCH]
    return f" at ({x:.2f}, {y:.2f}) cm, edges {' and '.join(near)}"


def _require_faces(
    faces: Int[np.ndarray, "f 3"], vertex: Int[np.ndarray, " c"], panels: _MeshedPanels, pattern: Pattern
) -> None:
    """Raise ``MeshError`` where sewing has left a vertex without a face: at the tip of a cone sharper than its mesh."""
    bare = np.flatnonzero(np.bincount(faces.ravel(), minlength=vertex.max() + 1)[vertex] == 0)
    if len(bare):
        x, y = panels.uv[bare[0]]
        raise MeshError(
            f"panel {pattern.panels[panels.panel_of_point[bare[0]]].name}: the corner at ({x:.2f}, {y:.2f}) cm is sewn "
            "to itself and too narrow for a triangle on either side: widen it, or cut its tip off"
        )


def _labels(
    pattern: Pattern, edges: Mapping[EdgeRef, Int[np.ndarray, " n"]], vertex: Int[np.ndarray, " c"]
) -> dict[str, Int[np.ndarray, " n"]]:
    """Vertices by edge label: all vertices of a labelled seam, the inner vertices of a labelled free edge.

    Raises ``MeshError`` for a seam whose sides have different labels.
    """
    label_of: dict[EdgeRef, str] = {
        EdgeRef(panel.name, index): edge.label for panel in pattern.panels for index, edge in enumerate(panel.edges)
    }
    found: dict[str, list[Int[np.ndarray, " n"]]] = {}
    for number, seam in enumerate(pattern.seams):
        left, right = label_of.pop(seam.left, ""), label_of.pop(seam.right, "")  # lines have no labels
        if left and right and left != right:
            raise MeshError(f"{seam_name(number, seam)} joins labels {left} and {right}: remove one of them")
        found.setdefault(left or right, []).extend([vertex[edges[seam.left]], vertex[edges[seam.right]]])
    for ref, label in label_of.items():
        found.setdefault(label, []).append(vertex[edges[ref][1:-1]])
    size = int(vertex.max(initial=-1)) + 1
    return {label: distinct(np.concatenate(found[label]), size) for label in sorted(found) if label}
