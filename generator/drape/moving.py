"""A body that moves under its garment: its skin as a mesh of its own, refitted each frame.

The mesh stands for the distance field, which no frame rebuilds: planes that stand for the skin, friction and approach
move with the skin's velocity (see ``kernels.step`` and ``kernels.body_contact``). Between two bodies the vertices move
straight, and start and stop gently.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Self

import numpy as np
import warp as wp
from jaxtyping import Bool, Float, Float32
from scipy.spatial.transform import Rotation

from gcd_dataset.generator.body.pose import pose_body
from gcd_dataset.generator.device import native_builds
from gcd_dataset.generator.drape.body_field import BodyField, closed_skin
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
    keys: tuple[Float32[np.ndarray, "w 3"], ...]
    """Positions of the skin's vertices at equal intervals of time, from the start to the end of the motion [cm]."""
    home: Float32[np.ndarray, "w 3"]
    """Positions in the A-pose, in which measures are taken [cm]."""
    trunk: Bool[np.ndarray, " w"]
    """Whether a vertex belongs to the trunk."""

    @classmethod
    def of(cls, bodies: Sequence[Body], home: Body | None = None) -> Self:
        """The motion through some bodies of one mesh; ``home``: the body in the A-pose, if it is not the first."""
        keys = tuple(closed_skin(body)[0].astype(np.float32) for body in bodies)
        trunk = bodies[0].parts == BodyPart.TRUNK.value
        at_home = keys[0] if home is None else closed_skin(home)[0].astype(np.float32)
        return cls(bodies[-1], keys, at_home, np.pad(trunk, (0, len(keys[0]) - len(trunk))))

    @classmethod
    def to_pose(cls, body: Body, pose: Pose) -> Self:
        """The motion of a body to a pose, all of its bones at once. Raises ``BodyError``: see ``pose_body``."""
        largest = max((float(np.linalg.norm(turn)) for turn in pose.turns.values()), default=0.0)
        count = max(int(np.ceil(largest / STEP)), 1)
        parts = [
            {bone: tuple(np.array(turn) * k / count) for bone, turn in pose.turns.items()} for k in range(1, count)
        ]
        return cls.of([body, *(pose_body(body, Pose(turns)) for turns in parts), pose_body(body, pose)])

    @property
    def seconds(self) -> float:
        """Its time [s], so that the fastest point has the mean speed ``SPEED``."""
        way = sum(float(np.linalg.norm(b - a, axis=1).max()) for a, b in pairwise(self.keys))
        return max(way / SPEED, LEAST_TIME)

    @property
    def drop(self) -> float:
        """By how much the trunk ends lower than it was [cm]."""
        return float((self.keys[0] - self.keys[-1])[self.trunk, 1].mean())

    def undone(self, points: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "v 3"]:
        """Points at the end of the motion [cm], moved with the trunk back to the A-pose."""
        before, after = self.home[self.trunk], self.keys[-1][self.trunk]
        turn, _ = Rotation.align_vectors(before - before.mean(axis=0), after - after.mean(axis=0))
        return np.asarray(turn.apply(points - after.mean(axis=0)) + before.mean(axis=0))


@dataclass
class MovingSkin:
    """The skin of a world, on its way."""

    world: int
    mesh: wp.Mesh
    motion: Motion
    frames: int
    """Frames that the motion takes."""
    seconds: float
    """Length of a frame [s]."""
    gently: bool = True
    """Start and stop gently; otherwise the motion goes on before and after."""
    frame: int = 0

    def advance(self, state: "ClothState", cloth: ClothArrays) -> None:
        """Move the mesh to the start of the next frame, with the velocity to its end; nothing once it stands still."""
        if self.frame > self.frames:
            return
        here, there = self._at(self.frame), self._at(self.frame + 1)
        self.mesh.points.assign(here)
        self.mesh.velocities.assign((there - here) / np.float32(self.seconds))
        self.mesh.refit()
        wp.launch(begin_frame, 1, [self.world], [cloth, state.search], device=self.mesh.device)
        self.frame += 1

    def _at(self, frame: int) -> Float32[np.ndarray, "w 3"]:
        share = min(frame / self.frames, 1.0)
        share = share * share * (3.0 - 2.0 * share) if self.gently else share
        along = share * (len(self.motion.keys) - 1)
        number = min(int(along), len(self.motion.keys) - 2)
        start, end = self.motion.keys[number : number + 2]
        return np.asarray(start + np.float32(along - number) * (end - start), np.float32)


def own_skin(body: BodyField) -> BodyField:
    """The field of a body with a skin of its own, which may move: equal bodies share a cached mesh."""
    shared, device = body.mesh, str(body.mesh.device)
    points = wp.clone(shared.points)
    with native_builds(device):
        mesh = wp.Mesh(points, shared.indices, velocities=wp.zeros_like(points))
    return replace(body, mesh=mesh)
