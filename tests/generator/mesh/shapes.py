"""Panels with known meshes, and measures of triangles."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int

from gcd_dataset.curves import LINE, Curve
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import BoxMesh, Edge, EdgeRef, Panel, Pattern, Placement, Seam


def panel(
    name: str,
    corners: Sequence[tuple[float, float]],
    *,
    curves: Mapping[int, Curve] | None = None,
    labels: Mapping[int, str] | None = None,
    at: tuple[float, float, float] = (0.0, 0.0, 0.0),
    turned: float = 0.0,
) -> Panel:
    """A panel with edges from corner to corner, straight unless given; ``turned`` about the vertical [rad]."""
    n = len(corners)
    edges = tuple(Edge(i, (i + 1) % n, (curves or {}).get(i, LINE), (labels or {}).get(i, "")) for i in range(n))
    return Panel(name, np.array(corners, float), edges, Placement(np.array(at), np.array([0.0, turned, 0.0])))


def rectangle(width: float, height: float) -> list[tuple[float, float]]:
    """Edges: 0 bottom, 1 right, 2 top, 3 left."""
    return [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)]


def seam(left: tuple[str, int], right: tuple[str, int], *, right_wrong: bool = False) -> Seam:
    return Seam(EdgeRef(*left), EdgeRef(*right), right_wrong)


def sewn(*panels: Panel, seams: tuple[Seam, ...] = ()) -> Pattern:
    return Pattern("test", panels, seams)


def tube() -> Pattern:
    """Front and back of 10 × 20 cm, 6 cm apart, right sides out, sewn along both sides; open above and below."""
    front = panel("front", rectangle(10.0, 20.0), at=(-5.0, 0.0, 3.0), labels={2: "waist"})
    back = panel("back", rectangle(10.0, 20.0), at=(5.0, 0.0, -3.0), turned=np.pi)
    return sewn(front, back, seams=(seam(("front", 1), ("back", 3)), seam(("front", 3), ("back", 1))))


def loop(corners: list[tuple[float, float]], spacing: float) -> Float[np.ndarray, "n 2"]:
    """Points along a polygon, at most ``spacing`` apart."""
    ends = np.array(corners, float)
    sides = []
    for start, end in zip(ends, np.roll(ends, -1, axis=0), strict=True):
        count = int(np.ceil(np.linalg.norm(end - start) / spacing - 1e-9))
        sides.append(start + (end - start) * np.arange(count)[:, None] / count)
    return np.concatenate(sides)


def star(seed: int) -> list[tuple[float, float]]:
    """A random star-shaped outline of 5 to 16 corners, 6 to 20 cm from its centre."""
    random = np.random.default_rng(seed)
    count = int(random.integers(5, 17))
    angles = (np.arange(count) + random.uniform(0.1, 0.9, count)) * 2 * np.pi / count
    radii = random.uniform(6.0, 20.0, count)
    return list(zip((radii * np.cos(angles)).tolist(), (radii * np.sin(angles)).tolist(), strict=True))


def areas(points: Float[np.ndarray, "m 2"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, " f"]:
    """Signed areas, positive for counter-clockwise triangles [cm²]."""
    a, b, c = points[faces].transpose(1, 2, 0)
    return 0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def sides(points: Float[np.ndarray, "m 2"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "f 3"]:
    """Lengths of the sides opposite each corner [cm]."""
    return np.linalg.norm(points[np.roll(faces, -1, axis=1)] - points[np.roll(faces, 1, axis=1)], axis=2)


def angles(points: Float[np.ndarray, "m 2"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "f 3"]:
    """Angles at each corner [degrees]."""
    ahead = points[np.roll(faces, -1, axis=1)] - points[faces]
    behind = points[np.roll(faces, 1, axis=1)] - points[faces]
    cross = ahead[..., 0] * behind[..., 1] - ahead[..., 1] * behind[..., 0]
    return np.degrees(np.arctan2(np.abs(cross), (ahead * behind).sum(axis=2)))


def directed_edges(faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "e 2"]:
    """Every side of every face, in the direction of its winding."""
    return np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)


def euler_characteristic(mesh: BoxMesh) -> int:
    """Vertices minus edges plus faces: 2 for a ball, 1 for a disc, 0 for a tube."""
    return len(mesh.vertices) - len(mesh_edges(mesh.faces).ends) + len(mesh.faces)
