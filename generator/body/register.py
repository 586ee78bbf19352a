"""Our body model laid over any body: what finds the landmarks and the parts of a mesh that has no known vertices.

The model's weights, the turns of its shoulders and hips and its place are fitted to the mesh by Gauss-Newton steps on
the distance from the model to the nearest point of the surface, mostly along the surface's normal (Chen and Medioni,
1991), far points counting less (Geman and McClure). The mesh is scaled to the model's height first, so that what is
found grows with the body.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.surface import SkinSurface
from gcd_dataset.records import BodyPart, Record

__all__ = [
    "ARMS",
    "PIVOT",
    "Alignment",
    "Registration",
    "coarse_alignment",
    "joints_of",
    "model_height",
    "quick_alignment",
    "register",
    "registration_at",
]

ROUGH, FINE = 500, 1600  # points of the model that are laid on the surface
ALONG = 0.2  # how much a slide along the surface counts beside a step off it
PIECE = 64  # rows that are multiplied at once
STILL = 0.002  # cm; a step that moves the points less than this on average ends the fit
ARM_STARTS = (0.0, 0.8)  # rad; arms raised from the A-pose that a fit starts from: A-pose and T-pose
PIVOT = np.array([0.0, 100.0, 0.0])  # cm; about which the whole model turns
LEFT_ARM, LEFT_LEG, RIGHT_ARM, RIGHT_LEG = 0, 1, 3, 4  # joints of the model
ARMS = (LEFT_ARM, RIGHT_ARM)
LIMBS = (LEFT_ARM, RIGHT_ARM, LEFT_LEG, RIGHT_LEG)
PLACE = 6 + 3 * len(LIMBS)
"""Shift, turn, and a turn of each limb: rotation vectors [cm, rad]."""
STIFFNESS = np.sqrt(np.repeat([1e-6, 1e-3, 1e-3], [3, 3, 3 * len(LIMBS)]))
"""Weight that keeps one step of place small, beside one point that is a centimetre off."""
SPARSE = {BodyPart.HANDS: 0.3, BodyPart.INTERNAL: 0.0}
"""Parts that have fewer points than their area asks for: open fingers of a model tell little about others."""


@dataclass(frozen=True, eq=False)
class Alignment(Record):
    """Weights and place of a model that lies on a surface."""

    weights: Float[np.ndarray, " k"]
    place: Float[np.ndarray, " p"]
    misfit: float
    """Mean distance of the model's points from the surface [cm of a body as tall as the model]."""

    @property
    def turn(self) -> Float[np.ndarray, "3 3"]:
        """How the whole model is turned."""
        return Rotation.from_rotvec(self.place[3:6].copy()).as_matrix()

    @property
    def arm_turns(self) -> Float[np.ndarray, "2 3"]:
        """How each arm is turned from the A-pose, in the order of ``ARMS``: rotation vectors [rad]."""
        return self.place[6:12].reshape(2, 3)

    def in_a_pose(self) -> "Alignment":
        """The same body in the A-pose."""
        place = self.place.copy()
        place[6:12] = 0.0
        return replace(self, place=place)


@dataclass(frozen=True, eq=False)
class Registration(Record):
    """The model as it lies on a surface."""

    vertices: Float[np.ndarray, "v 3"]
    """[cm]"""
    distances: Float[np.ndarray, " v"]
    """Of each vertex from the surface [cm]."""
    guess: Alignment


@dataclass(frozen=True)
class _Stage:
    """How firmly one round of steps holds on to the mean body, and from where a point counts as an outlier."""

    points: int
    steps: int
    prior: float
    outlier: float  # cm


QUICK = (_Stage(200, 5, 0.3, 10.0),)
COARSE = (_Stage(ROUGH, 8, 0.3, 10.0),)
CLOSER = (_Stage(FINE, 8, 0.06, 5.0), _Stage(FINE, 12, 0.01, 3.0), _Stage(FINE, 40, 0.0003, 3.0))


def model_height() -> float:
    """Height of the mean body of the model [cm]."""
    return float(np.ptp(body_model().mean[:, 1]))


def coarse_alignment(surface: SkinSurface) -> Alignment:
    """The better of the guesses from raised and from lowered arms, for a surface as tall as the model."""
    return min((_fitted(surface, _start(raised), COARSE) for raised in ARM_STARTS), key=lambda guess: guess.misfit)


def quick_alignment(surface: SkinSurface) -> Alignment:
    """A guess that is good enough to tell one way of standing from another."""
    return _fitted(surface, _start(ARM_STARTS[-1] / 2), QUICK)


def register(surface: SkinSurface, guess: Alignment) -> Registration:
    """The model laid closely on a surface as tall as itself, from a coarse guess."""
    return registration_at(surface, _fitted(surface, guess, CLOSER))


def registration_at(surface: SkinSurface, guess: Alignment) -> Registration:
    """The model where a guess puts it, with its distances from the surface."""
    vertices = _posed(guess, np.arange(len(body_model().mean)))[0]
    return Registration(vertices, surface.nearest(vertices).distances, guess)


def _start(raised: float) -> Alignment:
    place = np.zeros(PLACE)
    place[[8, 11]] = raised, -raised
    return Alignment(np.zeros(len(body_model().components)), place, np.inf)


def _fitted(surface: SkinSurface, guess: Alignment, stages: Sequence[_Stage]) -> Alignment:
    for stage in stages:
        ids = _spread_points(stage.points)
        for _ in range(stage.steps):
            guess, moved = _step(surface, guess, ids, stage)
            if moved < STILL:
                break
    return guess


def _step(surface: SkinSurface, guess: Alignment, ids: np.ndarray, stage: _Stage) -> tuple[Alignment, float]:
    """One Gauss-Newton step, and how far it moved a point on average [cm]."""
    points, frames = _posed(guess, ids)
    near = surface.nearest(points)
    trust = near.real / (1 + (near.distances / stage.outlier) ** 2)  # the root of Geman and McClure's weight
    slopes = np.concatenate(
        [_place_slopes(guess, ids, points), np.einsum("vij,kvj->vik", frames, body_model().components[:, ids])], axis=2
    )
    # A step off the surface counts 1, one along it ALONG: normal·normalᵀ + ALONG²·1 is the square of this.
    normal = np.einsum("vi,vj->vij", near.normals, near.normals)
    weigh = trust[:, None, None] * (ALONG * np.eye(3) + (np.sqrt(1 + ALONG**2) - ALONG) * normal)
    off = np.einsum("vij,vj->vi", weigh, near.points - points)
    rows = np.einsum("vij,vjp->vip", weigh, slopes)
    count = len(ids)
    firm = np.concatenate([STIFFNESS, np.full(len(guess.weights), np.sqrt(stage.prior))])
    pull = np.concatenate([np.zeros(PLACE), -guess.weights])
    matrix = _gram(rows.reshape(3 * count, -1)) / count + np.diag(firm**2)
    right = np.einsum("vip,vi->p", rows, off) / count + firm**2 * pull
    step = np.linalg.solve(matrix, right)
    moved = float(np.linalg.norm(slopes @ step, axis=1).mean())
    place, weights = guess.place + step[:PLACE], guess.weights + step[PLACE:]
    return Alignment(weights, place, float(near.distances.mean())), moved


def _gram(rows: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "p p"]:
    """All products of two columns.

    In pieces so small that BLAS takes one thread for each: the sums are the same on any machine, and threads that wait
    for each other would take ten times as long.
    """
    pieces = np.concatenate([rows, np.zeros((-len(rows) % PIECE, rows.shape[1]))]).reshape(-1, PIECE, rows.shape[1])
    return np.einsum("bpq->pq", pieces.transpose(0, 2, 1) @ pieces)


def _place_slopes(guess: Alignment, ids: np.ndarray, points: np.ndarray) -> Float[np.ndarray, "v 3 p"]:
    """Derivatives of the points by their place: a shift, and small turns about the pivot and each limb's joint."""
    model, turn = body_model(), guess.turn
    joints = joints_of(guess)
    arms = [points - PIVOT - guess.place[:3]]
    skins = [np.ones(len(ids))]
    for joint in LIMBS:
        arms.append(points - ((joints[joint] - PIVOT) @ turn.T + PIVOT + guess.place[:3]))
        skins.append(model.skin[ids, joint])
    slopes = [np.broadcast_to(np.eye(3), (len(ids), 3, 3))]
    for number, (arm, skin) in enumerate(zip(arms, skins, strict=True)):
        vector = guess.place[3 + 3 * number : 6 + 3 * number]
        axes = _turn_axes(vector) if number == 0 else turn @ _turn_axes(vector)
        slopes.append(skin[:, None, None] * np.cross(axes.T[None], arm[:, None]).transpose(0, 2, 1))
    return np.concatenate(slopes, axis=2)


def _turn_axes(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """The left Jacobian of the rotation group: columns are the axes about which each entry of the vector turns."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-6:
        return np.eye(3) + cross / 2
    return np.eye(3) + (1 - np.cos(angle)) / angle**2 * cross + (angle - np.sin(angle)) / angle**3 * cross @ cross


def joints_of(guess: Alignment) -> Float[np.ndarray, "n 3"]:
    """The joints of the guessed body, in the A-pose [cm]."""
    model = body_model()
    return model.joints + np.einsum("k,kni->ni", guess.weights, model.joint_components)


def _posed(guess: Alignment, ids: np.ndarray) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, "v 3 3"]]:
    """Vertices of the model where the guess puts them, and the linear map that took each there."""
    model, joints = body_model(), joints_of(guess)
    still = model.mean[ids] + np.einsum("k,kvi->vi", guess.weights, model.components[:, ids])
    points, frames = still.copy(), np.tile(np.eye(3), (len(ids), 1, 1))
    for number, joint in enumerate(LIMBS):
        limb = Rotation.from_rotvec(guess.place[6 + 3 * number : 9 + 3 * number].copy()).as_matrix()
        skin = model.skin[ids, joint]
        points += skin[:, None] * ((still - joints[joint]) @ (limb - np.eye(3)).T)
        frames += skin[:, None, None] * (limb - np.eye(3))
    turn = guess.turn
    return (points - PIVOT) @ turn.T + PIVOT + guess.place[:3], turn @ frames


@functools.cache
def _spread_points(count: int) -> Int[np.ndarray, " n"]:
    """Vertices of the model spread evenly over its area, from the soles to the head."""
    model = body_model()
    corners = model.mean[model.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    share = np.bincount(model.faces.ravel(), weights=np.repeat(area, 3), minlength=len(model.mean))
    for part, less in SPARSE.items():
        share[model.parts == part.value] *= less
    upwards = np.argsort(model.mean[:, 1], kind="stable")
    passed = np.cumsum(share[upwards])
    return np.unique(upwards[np.searchsorted(passed, (np.arange(count) + 0.5) / count * passed[-1])])
