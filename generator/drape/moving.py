"""A body that moves under its garment: its skin as a mesh of its own, refitted each frame.

The mesh stands for the distance field, which no frame rebuilds: planes that stand for the skin, friction and approach
move with the skin's velocity (see ``kernels.step`` and ``kernels.body_contact``). Between two bodies the vertices move
straight, and start and stop gently.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Self, cast

import numpy as np
import warp as wp
from jaxtyping import Bool, Float, Float32

from gcd_dataset.generator.body.pose import pose_body
from gcd_dataset.generator.device import native_builds
from gcd_dataset.generator.drape.body_field import BodyField, axes_at, axis_ends, closed_skin
from gcd_dataset.generator.drape.kernels.moving import begin_frame
from gcd_dataset.generator.drape.kernels.world import ClothArrays
from gcd_dataset.records import Body, BodyPart, Pose

if TYPE_CHECKING:
    from gcd_dataset.generator.drape.model import ClothState

STEP = np.radians(8.0)  # largest turn of a bone between two bodies: their chords are 0.1 cm inside the arc of a hand
SPEED = 60.0  # cm/s, mean speed of the fastest point of a body on its way to a pose: of a hand that is raised
LEAST_TIME = 0.3  # s, of a motion


@dataclass(frozen=True)
class Motion:
    """A body on its way to a pose. Needs no device, so any thread may compute it."""

    body: Body
    """The body in its last position."""
    points: Float32[np.ndarray, "k w+a 3"]
    """Positions of the skin's vertices, then of the ends of ``BodyField.axes`` [cm]: a row for each of k times at equal
    intervals, from the start to the end of the motion."""
    home: Float32[np.ndarray, "w 3"]
    """Positions in the A-pose, in which measures are taken [cm]."""
    trunk: Bool[np.ndarray, " w"]
    """Whether a vertex belongs to the trunk."""
    ways_back: Float32[np.ndarray, "k 4 3"]
    """The rigid motions of the trunk from ``keys`` back to the A-pose: a turn, and in the last row a shift [cm]."""

    @classmethod
    def of(cls, bodies: Sequence[Body], home: Body | None = None) -> Self:
        """The motion through some bodies of one mesh; ``home``: the body in the A-pose, if it is not the first."""
        skin = closed_skin(bodies[0]).skin
        *keys, at_home = (skin.points(body.vertices).astype(np.float32) for body in (*bodies, home or bodies[0]))
        ends = axis_ends(home or bodies[0])
        points = np.stack([np.concatenate([key, axes_at(key, ends).reshape(-1, 3)], dtype=np.float32) for key in keys])
        trunk = bodies[0].parts == BodyPart.TRUNK.value
        trunk = np.pad(trunk, (0, len(keys[0]) - len(trunk)))
        ways_back = [_rigid_motion(key[trunk].astype(float), at_home[trunk].astype(float)) for key in keys]
        return cls(bodies[-1], points, at_home, trunk, np.stack(ways_back))

    @classmethod
    def to_pose(cls, body: Body, pose: Pose) -> Self:
        """The motion of a body to a pose, all of its bones at once. Raises ``BodyError``: see ``pose_body``."""
        largest = max((float(np.linalg.norm(turn)) for turn in pose.turns.values()), default=0.0)
        count = max(int(np.ceil(largest / STEP)), 1)
        parts = [
            {bone: tuple(np.array(turn) * k / count) for bone, turn in pose.turns.items()} for k in range(1, count)
        ]
        return cls.of([body, *(pose_body(body, Pose(turns)) for turns in parts), pose_body(body, pose)])

    @classmethod
    def through(cls, body: Body, poses: Sequence[Pose]) -> Self:
        """The motion of a body in the A-pose through poses, a key for each. Raises ``BodyError``: see ``pose_body``."""
        return cls.of([pose_body(body, pose) for pose in poses], body)

    def part(self, first: int, last: int) -> Self:
        """The motion from one of its keys to another."""
        own = slice(first, last + 1)
        return replace(self, points=self.points[own], ways_back=self.ways_back[own])

    def from_home(self) -> Self:
        """The motion from the A-pose to the first key."""
        points = self.points[[0, 0]]
        points[0, : len(self.home)] = self.home
        return replace(self, points=points, ways_back=self.ways_back[[0, 0]])

    @property
    def keys(self) -> Float32[np.ndarray, "k w 3"]:
        """Positions of the skin's vertices [cm]."""
        return self.points[:, : len(self.home)]

    @property
    def last_axes(self) -> Float32[np.ndarray, "2 axes 3"]:
        """The axes of the body's parts at the last key [cm]."""
        return self.points[-1, len(self.home) :].reshape(2, -1, 3)

    @property
    def seconds(self) -> float:
        """Its time [s], so that the fastest point has the mean speed ``SPEED``."""
        way = sum(float(np.linalg.norm(b - a, axis=1).max()) for a, b in pairwise(self.keys))
        return max(way / SPEED, LEAST_TIME)

    @property
    def drop(self) -> float:
        """By how much the trunk ends lower than it was [cm]."""
        return float((self.keys[0] - self.keys[-1])[self.trunk, 1].mean())

    def undone(self, points: Float[np.ndarray, "v 3"], key: int = -1) -> Float[np.ndarray, "v 3"]:
        """Points at a key, by default the last [cm], moved with the trunk back to the A-pose."""
        return points @ self.ways_back[key][:3] + self.ways_back[key][3]


def _rigid_motion(start: Float[np.ndarray, "n 3"], end: Float[np.ndarray, "n 3"]) -> Float32[np.ndarray, "4 3"]:
    """The turn, and below it the shift, that move points nearest to their ends: ``x @ turn + shift`` (Kabsch 1976)."""
    from_middle, to_middle = start.mean(axis=0), end.mean(axis=0)
    left, _, right = np.linalg.svd((start - from_middle).T @ (end - to_middle))
    turn = (left * [1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return np.vstack([turn, to_middle - from_middle @ turn]).astype(np.float32)


@dataclass
class MovingSkin:
    """The skin of a world, on its way."""

    world: int
    mesh: wp.Mesh
    motion: Motion
    keys: wp.array
    """(k, w + a) keys of ``motion``, each with its axes."""
    frames: int
    """Frames that the motion takes."""
    seconds: float
    """Length of a frame [s]."""
    refit: Callable[[], None]
    """Refits the mesh, see ``refitting``."""
    gently: bool = True
    """Start and stop gently; otherwise the motion goes on before and after."""
    frame: int = 0

    def advance(self, state: "ClothState", cloth: ClothArrays) -> None:
        """Move the mesh to the start of the next frame, with the velocity to its end; nothing once it stands still."""
        if self.frame > self.frames:
            return
        inputs = [self.world, self.keys, self._along(self.frame), self._along(self.frame + 1), self.seconds]
        outputs = [self.mesh.points, self.mesh.velocities, cloth, state.search]
        wp.launch(begin_frame, self.keys.shape[1], inputs, outputs, device=self.mesh.device)
        self.refit()
        self.frame += 1

    @property
    def key(self) -> int:
        """The number of the nearest key."""
        return round(self._along(self.frame))

    @property
    def is_at_key(self) -> bool:
        """Whether the cloth is where the skin reaches a key."""
        return self.frame * (self.keys.shape[0] - 1) % self.frames == 0

    def arrive(self) -> None:
        """Move the mesh to the key where the cloth is: ``advance`` leaves it a frame earlier."""
        wp.copy(self.mesh.points, self.keys[self.key], count=len(self.mesh.points))
        self.refit()

    def undone(self, points: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "v 3"]:
        """Points [cm] moved with the trunk from where it is back to the A-pose."""
        return self.motion.undone(points, self.key)

    def _along(self, frame: int) -> float:
        """How many keys lie behind the skin at a frame."""
        share = min(frame / self.frames, 1.0)
        share = share * share * (3.0 - 2.0 * share) if self.gently else share
        return share * (self.keys.shape[0] - 1)


def refitting(mesh: wp.Mesh) -> Callable[[], None]:
    """A function that refits a mesh, on a GPU by a graph.

    Outside of a graph Warp's native code frees memory that the refit still uses, on the default stream, which does not
    wait for a ``WorkStream``. Hold ``launch_lock``.
    """
    if mesh.device.is_cpu:
        return cast(Callable[[], None], mesh.refit)
    with wp.ScopedCapture(device=mesh.device) as capture:
        mesh.refit()
    return partial(wp.capture_launch, capture.graph)


def own_skin(body: BodyField) -> BodyField:
    """The field of a body with a skin of its own, which may move: equal bodies share a cached mesh."""
    shared, device = body.mesh, str(body.mesh.device)
    points = wp.clone(shared.points)
    with native_builds(device):
        mesh = wp.Mesh(points, shared.indices, velocities=wp.zeros_like(points))
    return replace(body, mesh=mesh)
