"""Distances between surfaces, and between a surface and a point cloud [cm].

The distance of two surfaces is the mean of two means: from points of the one to the other, and back. Points lie
uniformly by area; their distances to a mesh are distances to its nearest triangles, so that the distance of a surface
to itself is 0 and not the spacing of the points.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gcd_dataset.errors import SpecError
from gcd_dataset.files import open_regular
from gcd_dataset.generator.body.surface import SkinSurface
from gcd_dataset.generator.quality import sample_surface
from gcd_dataset.meshedges import mesh_edges

WORST = 100.0  # cm: the distance of a failed prediction, and the largest that is reported
SAMPLES = 4096  # points of a surface
NEIGHBOURS = 12  # points of a cloud whose plane is the surface near a point
ALONG_RIM = 8  # points of a mesh edge of an opening
SMALLEST = 5.0  # cm: an input whose largest extent is smaller is in metres
ENDINGS = (".ply", ".obj", ".glb", ".stl", ".npy")


class Shape(Protocol):
    """A surface, known by triangles or by points."""

    @property
    def samples(self) -> Float[np.ndarray, "n 3"]:
        """Points of the surface [cm]."""

    def distances(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Distances of points to the surface [cm]."""


@dataclass(frozen=True, eq=False)
class MeshShape:
    """A triangle mesh."""

    skin: SkinSurface
    samples: Float[np.ndarray, "n 3"]

    @staticmethod
    def of(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], *, count: int = SAMPLES) -> "MeshShape":
        """The surface of a mesh [cm], with ``count`` points on it; the same for the same mesh."""
        points = sample_surface(vertices, faces, count, np.random.default_rng(0))[:, :3]
        return MeshShape(SkinSurface.of(np.asarray(vertices, float), faces), points)

    def distances(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        return self.skin.nearest(points).distances


@dataclass(frozen=True, eq=False)
class Cloud:
    """A point cloud; between its points the surface is the plane through the nearest ones."""

    samples: Float[np.ndarray, "n 3"]
    tree: cKDTree
    normals: Float[np.ndarray, "n 3"]
    reach: Float[np.ndarray, " n"]
    """Radius of the plane of each point: the distance of its neighbours [cm]."""

    @staticmethod
    def of(points: Float[np.ndarray, "n 3"]) -> "Cloud":
        """The surface through points [cm], at least ``NEIGHBOURS``."""
        tree = cKDTree(points)
        apart, near = tree.query(points, k=NEIGHBOURS)
        offsets = points[near] - points[near].mean(axis=1, keepdims=True)
        normals = np.linalg.svd(offsets, full_matrices=False)[2][:, -1]
        return Cloud(points, tree, normals, np.median(apart[:, 1:], axis=1))

    def distances(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        apart, near = self.tree.query(points)
        above = np.abs(np.einsum("ni,ni->n", points - self.samples[near], self.normals[near]))
        beside = np.sqrt(np.maximum(apart**2 - above**2, 0.0))
        return np.where(beside <= self.reach[near], above, apart)


def distance(one: Shape, other: Shape, *, both_ways: bool = True) -> float:
    """The mean distance of two surfaces, at most ``WORST`` [cm]; ``both_ways`` as in ``mean_and_p95``."""
    return mean_and_p95(one, other, both_ways=both_ways)[0]


def mean_and_p95(one: Shape, other: Shape, *, both_ways: bool = True) -> tuple[float, float]:
    """The mean distance of two surfaces, and the larger 95th percentile of both ways, at most ``WORST`` [cm].

    ``both_ways=False``: only from the points of ``one`` to ``other``, for a ``one`` that is a part of the whole.
    """
    ways = [other.distances(one.samples)] + ([one.distances(other.samples)] if both_ways else [])
    found = np.mean([way.mean() for way in ways]), np.max([np.percentile(way, 95) for way in ways])
    mean, p95 = np.minimum(np.nan_to_num(found, nan=WORST, posinf=WORST), WORST).tolist()
    return mean, p95


def openings_of(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> list[Float[np.ndarray, "n 3"]]:
    """Points [cm] on each opening of a sewn mesh: hem, sleeve end, neckline, waist or slit, a loop of unsewn edges."""
    edges = mesh_edges(faces)
    rim = edges.ends[edges.counts == 1]
    touching = coo_matrix((np.ones(len(rim)), rim.T), shape=(len(vertices),) * 2)
    number = connected_components(touching, directed=False)[1][rim[:, 0]]
    start, end = np.asarray(vertices, float)[rim.T][:, :, None]
    points = start + np.linspace(0, 1, ALONG_RIM, endpoint=False)[:, None] * (end - start)
    return [points[number == one].reshape(-1, 3) for one in np.unique(number)]


def openings_apart(one: Sequence[Float[np.ndarray, "n 3"]], other: Sequence[Float[np.ndarray, "m 3"]]) -> float:
    """The largest mean distance of an opening of either mesh from the openings of the other, at most ``WORST`` [cm].

    0 for two meshes without an opening, ``WORST`` if one of them has none.
    """
    if not (one and other):
        return 0.0 if not (one or other) else WORST
    ways = ((one, cKDTree(np.concatenate(other))), (other, cKDTree(np.concatenate(one))))
    return min(WORST, max(float(tree.query(rim)[0].mean()) for rims, tree in ways for rim in rims))


def input_files(folder: Path) -> dict[str, Path]:
    """Name of a garment to the file of its mesh or points. Raises ``SpecError`` for a folder without one."""
    if not folder.is_dir():
        raise SpecError(f"{folder}: no such folder: give the folder of the input meshes or points")
    paths = [path for ending in ENDINGS for path in sorted(folder.glob(f"*{ending}"))]
    if not paths:
        raise SpecError(f"{folder}: no inputs: it should hold NAME{' or NAME'.join(ENDINGS)}")
    return {path.stem: path for path in reversed(paths)}


def read_shape(path: Path) -> Shape | None:
    """A mesh, or points: a PLY or OBJ without faces, or an array (n, 3) or (n, 6) in a ``.npy`` file [cm].

    ``None`` for fewer than ``NEIGHBOURS`` finite points, as of a drape that diverged. Raises ``SpecError`` with the
    file and a remedy.
    """
    points, faces = _read(path)
    if not len(points):
        return None
    return MeshShape.of(points[:, :3], faces) if len(faces) else Cloud.of(points[:, :3])


def read_points(path: Path, count: int) -> Float[np.ndarray, "n 6"]:
    """Points [cm] and unit normals of a file that ``read_shape`` reads: ``count`` of a mesh, at most as many of points.

    Points without normals, or with some of length 0, get those of the planes through their neighbours, away from the
    vertical through their mean. Raises ``SpecError``.
    """
    points, faces = _read(path)
    if not len(points):
        raise SpecError(f"{path}: fewer than {NEIGHBOURS} finite points: export the scan again")
    if len(faces):
        return sample_surface(points[:, :3], faces, count, np.random.default_rng(0))
    points = points[np.random.default_rng(0).permutation(len(points))[:count]]
    points, given = points[:, :3], points[:, 3:]
    lengths = np.linalg.norm(given, axis=1, keepdims=True)
    if given.size and (lengths > 0).all():
        return np.concatenate([points, given / lengths], axis=1)
    normals, outward = Cloud.of(points).normals, (points - points.mean(axis=0)) * [1.0, 0.0, 1.0]
    sides = np.where(np.einsum("ni,ni->n", normals, outward) < 0, -1.0, 1.0)
    return np.concatenate([points, sides[:, None] * normals], axis=1)


def _read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Points, perhaps with normals, none if too few are finite; faces, none for a cloud. Raises ``SpecError``."""
    try:
        open_regular(path).close()
        points, faces = _array(path) if path.suffix.lower() == ".npy" else _mesh(path)
    except Exception as error:  # trimesh and numpy raise any exception for malformed files
        line = " ".join(str(error).split())[:120]
        raise SpecError(f"{path}: cannot be read ({line}): give a mesh, or points (n, 3), in centimetres") from error
    if not len(faces):
        points = points[np.isfinite(points[:, :3]).all(axis=1)]  # points that a scan did not measure are NaN
    if len(points) < NEIGHBOURS or not np.isfinite(points[:, :3]).all():
        return points[:0], faces[:0]
    if (extent := float(np.ptp(points[:, :3], axis=0).max())) < SMALLEST:
        raise SpecError(f"{path}: its largest extent is {extent:.3g}: inputs are in centimetres, so scale it by 100")
    return points, faces


def _array(path: Path) -> tuple[np.ndarray, np.ndarray]:
    array = np.load(path, allow_pickle=False)
    if array.ndim != 2 or array.shape[1] not in (3, 6):
        raise ValueError(f"an array of shape {array.shape}, not (n, 3) or (n, 6)")
    return array.astype(float), np.zeros((0, 3), int)


def _mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    scene = trimesh.load(path, process=False, force="scene")
    parts = [part for part in scene.dump() if len(getattr(part, "vertices", ()))]
    if not parts:
        raise ValueError("no points")
    points = np.concatenate([np.asarray(part.vertices, float) for part in parts])
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    of_parts = [
        np.asarray(part.faces, int) + start for part, start in zip(parts, first, strict=False) if hasattr(part, "faces")
    ]
    return points, np.concatenate([np.zeros((0, 3), int), *of_parts])
