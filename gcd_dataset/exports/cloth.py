"""What the mesh formats share: texture coordinates, normals, colours and seam lines of a draped garment."""

import numpy as np
import shapely
from jaxtyping import Float, Int

from gcd_dataset.curves import sample_curve
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.lay_plan import PALETTE
from gcd_dataset.records import BoxMesh, Pattern

TILE = 10.0  # cm of cloth that a texture covers
SMALLEST_TILE, LARGEST_TILE = 0.01, 10_000.0  # cm: beyond, texture coordinates lose their digits as f32
SKIN = (0.80, 0.77, 0.74)
CURVE_POINTS = 129  # of an edge, to order the vertices of a seam along it


def texture_coordinates(mesh: BoxMesh, tile: float = TILE) -> Float[np.ndarray, "c 2"]:
    """Texture coordinates of the seam-split vertices: 1 is ``tile`` cm of cloth in all panels; v runs along the grain.

    Panels drawn from the inside are mirrored, so that a print reads from the outside. Raises ``ConfigError`` for
    a ``tile`` under 0.1 mm or over 100 m.
    """
    if not SMALLEST_TILE <= tile <= LARGEST_TILE:
        raise ConfigError(f"a texture tile of {tile:g} cm: give one from {SMALLEST_TILE:g} to {LARGEST_TILE:g} cm")
    a, b, c = (mesh.uv[mesh.corners[:, i]] for i in range(3))
    doubled = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    is_mirrored = np.bincount(mesh.panel_id, doubled, minlength=len(mesh.panel_names)) < 0
    side = np.ones(len(mesh.uv))
    side[mesh.corners.ravel()] = np.repeat(np.where(is_mirrored, -1.0, 1.0)[mesh.panel_id], 3)
    return mesh.uv * np.stack([side, np.ones(len(side))], axis=1) / tile


def panel_colour(number: int) -> tuple[float, float, float]:
    """Colour of panel ``number``, as in pictures, 0 … 1."""
    red, green, blue = PALETTE[number % len(PALETTE)]
    return red, green, blue


def smooth_normals(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "v 3"]:
    """Unit normals of the vertices, weighted by the areas of the faces; continuous across seams."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    of_face = np.cross(b - a, c - a)
    normals = np.stack(
        [np.bincount(faces.ravel(), np.repeat(of_face[:, i], 3), minlength=len(vertices)) for i in range(3)], axis=1
    )
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 0, normals / np.maximum(length, 1e-30), [0.0, 0.0, 1.0])


def seam_vertices(mesh: BoxMesh, pattern: Pattern) -> tuple[Int[np.ndarray, " n"], ...]:
    """The vertices of each seam, from the start of its left edge to the end, in the order of ``pattern.seams``."""
    panel_of = np.zeros(len(mesh.uv), int)
    panel_of[mesh.corners.ravel()] = np.repeat(mesh.panel_id, 3)
    by_vertex = np.argsort(mesh.uv_vertex, kind="stable")
    first = np.searchsorted(mesh.uv_vertex[by_vertex], np.arange(len(mesh.vertices) + 1))
    ordered = []
    for number, seam in enumerate(pattern.seams):
        panel = pattern.panel(seam.left.panel)
        edge = panel.edges[seam.left.edge]
        line = shapely.LineString(sample_curve(*panel.edge_ends(seam.left.edge), edge.curve, CURVE_POINTS))
        number_of_panel = mesh.panel_names.index(panel.name)
        vertices = np.unique(mesh.seams[mesh.seams[:, 1] == number, 0])
        along = []
        for vertex in vertices.tolist():
            rows = by_vertex[first[vertex] : first[vertex + 1]]
            points = shapely.points(mesh.uv[rows[panel_of[rows] == number_of_panel]])
            along.append(float(line.project(points[np.argmin(line.distance(points))])) if len(points) else np.inf)
        ordered.append(vertices[np.argsort(along, kind="stable")])
    return tuple(ordered)
