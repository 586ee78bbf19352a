"""Garments in motion (task T8): cloth moved with the skin, and batches of single frames on a device."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from jaxtyping import Float, Float32, Int
from scipy.spatial import cKDTree
from torch import Tensor
from torch.nn import functional

from benchmarks.reconstruction.derived import CENTRE
from benchmarks.reconstruction.draped_surfaces import labels_of, mesh_of, prepared
from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.surfaces import METRE, SurfaceBatch, SurfaceStore
from benchmarks.reconstruction.wearers import shape_of, skin_points, skin_rows, unhidden
from gcd_dataset.generator.body.pose import bone_moves, pose_body, rig
from gcd_dataset.generator.views import stored_body
from gcd_dataset.records import Body, BodyShape, Pose
from gcd_dataset.scoring.inputs import poses_of
from gcd_dataset.workers import parallel_map

LAGS = (1, 2, 4)  # frames back to which the skinned cloth is compared
HISTORY = 3 * len(LAGS) + 1  # numbers of a vertex: its ways, and the time
SEEN = 5.0  # scales ways to about 1


@dataclass(frozen=True, eq=False)
class SkinnedMotion:
    """A garment moved with the skin."""

    cloth: Float32[np.ndarray, "v t 3"]
    """[cm]"""
    axes: Float32[np.ndarray, "v t 3 3"]
    """Matrices that turn directions at a vertex in the first frame to those in a frame."""
    skin: Float32[np.ndarray, "t n 6"]
    """Points of the skin relative to ``CENTRE`` [m] and normals."""
    ms: float
    """Time of the garment [ms], with that of posing the body."""


def skinned_motions(garments: GarmentSet, *, points: int = 1, workers: int = 0) -> Iterator[SkinnedMotion]:
    """The garments moved with the skin, and ``points`` of the skin of each."""
    rows = skin_rows(points, len(garments.shapes[0]))
    given = (
        (shape_of(garments, k), poses_of(garments.ragged["turns"][k].astype(float)), garments.ragged["motion"][k][:, 0])
        for k in range(len(garments))
    )
    return parallel_map(partial(_skinned, rows), given, workers)


def _skinned(
    rows: Int[np.ndarray, " n"], given: tuple[BodyShape, list[Pose], Float[np.ndarray, "v 3"]]
) -> SkinnedMotion:
    begun, (shape, poses, first) = time.perf_counter(), given
    home = stored_body(shape)
    bodies = [pose_body(home, pose) for pose in poses]
    bones = np.stack([_bones(home, pose, body) for pose, body in zip(poses, bodies, strict=True)])
    shown = unhidden(home)
    nearest = shown[cKDTree(bodies[0].vertices[shown]).query(first)[1]]
    blends = np.einsum("vb,tbij->vtij", rig().skin[nearest].toarray(), bones)
    turns, shifts = blends[..., :3], blends[..., 3]
    at_home = np.linalg.solve(turns[:, 0], (first - shifts[:, 0])[..., None])
    return SkinnedMotion(
        cloth=((turns @ at_home[:, None])[..., 0] + shifts).astype(np.float32),
        axes=(turns @ np.linalg.inv(turns[:, :1])).astype(np.float32),
        skin=np.stack([skin_points(body, rows) for body in bodies]),
        ms=1e3 * (time.perf_counter() - begun),
    )


def _bones(home: Body, pose: Pose, posed: Body) -> Float[np.ndarray, "b 3 4"]:
    """The moves of the bones from a body to its pose on the floor."""
    turns, shifts = bone_moves(home, pose)
    heights = (rig().skin.toarray() * (home.vertices @ turns[:, 1].T + shifts[:, 1])).sum(axis=1)
    shifts[:, 1] -= np.median(heights - posed.vertices[:, 1])
    return np.concatenate([turns, shifts[..., None]], axis=2)


@dataclass(frozen=True)
class MotionBatch:
    """A frame of each of several garments, moved with the skin."""

    surface: SurfaceBatch
    given: Float[Tensor, "v g"]
    """As of ``DrapeBatch``."""
    history: Float[Tensor, "v h"]
    """Ways of the skinned cloth over the frames before, in the axes of the vertex, and the time."""
    axes: Float[Tensor, "v 3 3"]
    """See ``SkinnedMotion``."""
    body: Float[Tensor, "b n 6"]
    """See ``DrapeBatch``."""
    true: Float[Tensor, "v 3"]
    """[m]"""


class MotionFrames:
    """Garments in motion on a device; of a garment a batch has one frame, with ``chance`` a random one."""

    def __init__(self, garments: GarmentSet, *, tokens: int, body: int, device: torch.device, workers: int = 0) -> None:
        count, ragged = len(garments), garments.ragged
        meshes = (mesh_of(garments, k, ragged["motion"][k][:, 0]) for k in range(count))
        surfaces = list(parallel_map(partial(prepared, tokens), meshes, workers))
        moved = list(skinned_motions(garments, points=body, workers=workers))
        self.store = SurfaceStore(surfaces, tokens=tokens, device=device)

        def put(array: np.ndarray) -> Tensor:
            return torch.from_numpy(array).to(device)

        self._given = put(np.concatenate([labels_of(garments, k) for k in range(count)]))
        self._axes = put(np.concatenate([each.axes for each in moved]))
        self._skin = put(np.stack([each.skin for each in moved]))
        self._cloth, self._true = (
            put(((positions - CENTRE) / METRE).astype(np.float32))
            for positions in (np.concatenate([each.cloth for each in moved]), ragged["motion"].rows)
        )

    def __len__(self) -> int:
        return len(self.store)

    @property
    def frames(self) -> int:
        """Frames of a motion, of which the first is given."""
        return int(self._true.shape[1])

    def batch(self, rows: Int[Tensor, " b"], chance: torch.Generator | None = None) -> MotionBatch:
        """A frame of each garment of ``rows``."""
        numbers = torch.arange(len(self)) if chance is None else torch.randint(2**31, (len(self),), generator=chance)
        return self.at(rows, 1 + numbers[rows] % (self.frames - 1))

    def first(self, k: int) -> Float[np.ndarray, "v 3"]:
        """Garment ``k`` in the first frame [cm]."""
        place = self._true[self.store.starts[k] : self.store.starts[k + 1], 0]
        return np.asarray(place.double().cpu().numpy() * METRE + CENTRE)

    def at(self, rows: Int[Tensor, " b"], frames: Int[Tensor, " b"]) -> MotionBatch:
        """These frames of the garments ``rows``."""
        surface, chosen = self.store.batch(rows)
        when = frames.to(chosen.device)
        now = when[surface.garments]
        place, axes = self._cloth[chosen, now], self._axes[chosen, now]
        normals = functional.normalize((axes @ surface.normals[..., None])[..., 0], dim=-1)
        moved = replace(surface, positions=place, normals=normals)
        ways = [place - self._cloth[chosen, (now - lag).clamp(min=0)] for lag in LAGS]
        own = [(axes.mT @ way[..., None])[..., 0] * SEEN for way in ways]
        history = torch.cat([*own, (now / self.frames)[:, None]], dim=-1)
        skin = self._skin[rows.to(chosen.device), when]
        return MotionBatch(moved, self._given[chosen].float(), history, axes, skin, self._true[chosen, now])
