"""Registers the body model to any mesh, and finds the mesh's orientation and unit with it.

Shape weights, rotations of shoulders and hips, and rigid motion are fitted by Gauss-Newton steps on the distance from
the model to the nearest points of the surface, mostly along its normal (Chen and Medioni, 1991), with robust weights
(Geman and McClure). The mesh is first scaled to the model's height, so that the fit does not depend on the
body's size.
"""

import functools
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from gcd_dataset.bodyfiles import OTHER_UNITS
from gcd_dataset.errors import BodyError, ConfigError
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.repair import BodyScan
from gcd_dataset.generator.body.surface import SkinSurface
from gcd_dataset.measurements import ADULT, is_adult_height
from gcd_dataset.records import BodyPart, Record

ROUGH, FINE = 500, 1600  # numbers of model vertices matched to the surface
TANGENTIAL = 0.2  # weight of distances along the surface; 1 along its normal
BLOCK = 64  # rows in one matrix product
CONVERGED = 0.002  # cm; mean movement of the points in the last step
ARM_STARTS = (0.0, 0.8)  # rad; initial arm angles: about A-pose and T-pose
PIVOT = np.array([0.0, 100.0, 0.0])  # cm; centre of the rotation of the whole model
LEFT_ARM, LEFT_LEG, RIGHT_ARM, RIGHT_LEG = 0, 1, 3, 4  # joints of the model
ARMS = (LEFT_ARM, RIGHT_ARM)
LIMBS = (LEFT_ARM, RIGHT_ARM, LEFT_LEG, RIGHT_LEG)
POSE_SIZE = 6 + 3 * len(LIMBS)
"""Length of a pose: shift [cm], rotation, and the rotation of each limb as rotation vectors [rad]."""
STIFFNESS = np.sqrt(np.repeat([1e-6, 1e-3, 1e-3], [3, 3, 3 * len(LIMBS)]))
"""Square root of the damping of each pose entry in a step, relative to a mean error of 1 cm."""
SPARSE = {BodyPart.HANDS: 0.3, BodyPart.INTERNAL: 0.0}
"""Sampling density of parts relative to the skin: few points on hands, since fingers differ in pose."""


@dataclass(frozen=True, eq=False)
class Alignment(Record):
    """Shape weights and pose of the model on a surface, and the error of the fit."""

    weights: Float[np.ndarray, " k"]
    pose: Float[np.ndarray, " p"]
    """See ``POSE_SIZE``."""
    misfit: float
    """Mean distance of the model's points from the surface, scaled to the model's height [cm]."""

    @property
    def turn(self) -> Float[np.ndarray, "3 3"]:
        """Rotation of the whole model about ``PIVOT``."""
        return Rotation.from_rotvec(self.pose[3:6].copy()).as_matrix()

    @property
    def arm_turns(self) -> Float[np.ndarray, "2 3"]:
        """Rotation of each arm from the A-pose, in the order of ``ARMS``: rotation vectors [rad]."""
        return self.pose[6:12].reshape(2, 3)

    def in_a_pose(self) -> "Alignment":
        """The same body with its arms in the A-pose."""
        pose = self.pose.copy()
        pose[6:12] = 0.0
        return replace(self, pose=pose)


@dataclass(frozen=True, eq=False)
class Registration(Record):
    """The model registered to a surface."""

    vertices: Float[np.ndarray, "v 3"]
    """[cm]"""
    distances: Float[np.ndarray, " v"]
    """Distance of each vertex from the surface [cm]."""
    alignment: Alignment


@dataclass(frozen=True)
class _Stage:
    """The settings of one round of Gauss-Newton steps."""

    points: int
    steps: int
    prior: float  # weight of the squared shape weights
    outlier: float  # cm; scale of the robust weights


QUICK = (_Stage(200, 5, 0.3, 10.0),)
COARSE = (_Stage(ROUGH, 8, 0.3, 10.0),)
CLOSE = (_Stage(FINE, 8, 0.06, 5.0), _Stage(FINE, 12, 0.01, 3.0), _Stage(FINE, 40, 0.0003, 3.0))


def model_height() -> float:
    """Height of the model's mean body [cm]."""
    return float(np.ptp(body_model().mean[:, 1]))


def coarse_alignment(surface: SkinSurface) -> Alignment:
    """A rough fit to a surface of the model's height: the better of two, from lowered and from raised arms."""
    fits = (_fitted(surface, _start(arm_angle), COARSE) for arm_angle in ARM_STARTS)
    return min(fits, key=lambda alignment: alignment.misfit)


def quick_alignment(surface: SkinSurface) -> Alignment:
    """A rougher fit, good enough to compare orientations of a mesh."""
    return _fitted(surface, _start(ARM_STARTS[-1] / 2), QUICK)


def register(surface: SkinSurface, coarse: Alignment) -> Registration:
    """The model fitted closely to a surface of its height, from a coarse alignment."""
    return registration_at(surface, _fitted(surface, coarse, CLOSE))


def registration_at(surface: SkinSurface, alignment: Alignment) -> Registration:
    """The model in a given alignment, with its distances from the surface; nothing is fitted."""
    vertices = _posed(alignment, np.arange(len(body_model().mean)))[0]
    return Registration(vertices, surface.nearest(vertices).distances, alignment)


def _start(arm_angle: float) -> Alignment:
    """The mean body with both arms raised from the A-pose."""
    pose = np.zeros(POSE_SIZE)
    pose[[8, 11]] = arm_angle, -arm_angle
    return Alignment(np.zeros(len(body_model().components)), pose, np.inf)


def _fitted(surface: SkinSurface, alignment: Alignment, stages: Sequence[_Stage]) -> Alignment:
    for stage in stages:
        ids = _spread_points(stage.points)
        for _ in range(stage.steps):
            alignment, moved = _step(surface, alignment, ids, stage)
            if moved < CONVERGED:
                break
    return alignment


def _step(surface: SkinSurface, alignment: Alignment, ids: np.ndarray, stage: _Stage) -> tuple[Alignment, float]:
    """One Gauss-Newton step, and the mean movement of the points by it [cm]."""
    points, frames = _posed(alignment, ids)
    near = surface.nearest(points)
    robust = near.on_skin / (1 + (near.distances / stage.outlier) ** 2)  # square root of Geman and McClure's weight
    by_shape = np.einsum("vij,kvj->vik", frames, body_model().components[:, ids])
    jacobian = np.concatenate([_pose_jacobian(alignment, ids, points), by_shape], axis=2)
    # The square root of normal·normalᵀ + TANGENTIAL²·1: weight 1 along the normal, TANGENTIAL along the surface.
    normal = np.einsum("vi,vj->vij", near.normals, near.normals)
    weight = robust[:, None, None] * (TANGENTIAL * np.eye(3) + (np.sqrt(1 + TANGENTIAL**2) - TANGENTIAL) * normal)
    error = np.einsum("vij,vj->vi", weight, near.points - points)
    rows = np.einsum("vij,vjp->vip", weight, jacobian)
    count = len(ids)
    damping = np.concatenate([STIFFNESS, np.full(len(alignment.weights), np.sqrt(stage.prior))])
    prior = np.concatenate([np.zeros(POSE_SIZE), -alignment.weights])
    # The Gram matrix rowsᵀ·rows, in blocks too small for BLAS threads: one thread rounds the same on any machine,
    # and is ten times as fast as threads that wait for each other.
    rows = rows.reshape(3 * count, -1)
    blocks = np.concatenate([rows, np.zeros((-len(rows) % BLOCK, rows.shape[1]))]).reshape(-1, BLOCK, rows.shape[1])
    gram = np.einsum("bpq->pq", blocks.transpose(0, 2, 1) @ blocks)
    matrix = gram / count + np.diag(damping**2)
    right = np.einsum("vip,vi->p", rows.reshape(count, 3, -1), error) / count + damping**2 * prior
    step = np.linalg.solve(matrix, right)
    moved = float(np.linalg.norm(jacobian @ step, axis=1).mean())
    pose, weights = alignment.pose + step[:POSE_SIZE], alignment.weights + step[POSE_SIZE:]
    return Alignment(weights, pose, float(near.distances.mean())), moved


def _pose_jacobian(alignment: Alignment, ids: np.ndarray, points: np.ndarray) -> Float[np.ndarray, "v 3 p"]:
    """Derivatives of the points by the pose: the shift, then rotations about the pivot and each limb's joint."""
    model, turn = body_model(), alignment.turn
    joints = joints_of(alignment)
    levers = [points - PIVOT - alignment.pose[:3]]
    skins = [np.ones(len(ids))]
    for joint in LIMBS:
        levers.append(points - ((joints[joint] - PIVOT) @ turn.T + PIVOT + alignment.pose[:3]))
        skins.append(model.skin[ids, joint])
    columns = [np.broadcast_to(np.eye(3), (len(ids), 3, 3))]
    for number, (lever, skin) in enumerate(zip(levers, skins, strict=True)):
        vector = alignment.pose[3 + 3 * number : 6 + 3 * number]
        axes = _left_jacobian(vector) if number == 0 else turn @ _left_jacobian(vector)
        columns.append(skin[:, None, None] * np.cross(axes.T[None], lever[:, None]).transpose(0, 2, 1))
    return np.concatenate(columns, axis=2)


def _left_jacobian(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """The left Jacobian of SO(3) at a rotation vector: column i is the rotation axis for a change of entry i."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-6:
        return np.eye(3) + cross / 2
    return np.eye(3) + (1 - np.cos(angle)) / angle**2 * cross + (angle - np.sin(angle)) / angle**3 * cross @ cross


def joints_of(alignment: Alignment) -> Float[np.ndarray, "n 3"]:
    """The joints of the aligned body in the model's frame and A-pose [cm]."""
    model = body_model()
    return model.joints + np.einsum("k,kni->ni", alignment.weights, model.joint_components)


def _posed(alignment: Alignment, ids: np.ndarray) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, "v 3 3"]]:
    """Vertices of the model in an alignment, and the linear part of the map from the unposed shape to each."""
    model, joints = body_model(), joints_of(alignment)
    unposed = model.mean[ids] + np.einsum("k,kvi->vi", alignment.weights, model.components[:, ids])
    points, frames = unposed.copy(), np.tile(np.eye(3), (len(ids), 1, 1))
    for number, joint in enumerate(LIMBS):
        limb = Rotation.from_rotvec(alignment.pose[6 + 3 * number : 9 + 3 * number].copy()).as_matrix()
        skin = model.skin[ids, joint]
        points += skin[:, None] * ((unposed - joints[joint]) @ (limb - np.eye(3)).T)
        frames += skin[:, None, None] * (limb - np.eye(3))
    turn = alignment.turn
    return (points - PIVOT) @ turn.T + PIVOT + alignment.pose[:3], turn @ frames


@functools.cache
def _spread_points(count: int) -> Int[np.ndarray, " n"]:
    """Vertices of the model, about uniform by area."""
    model = body_model()
    corners = model.mean[model.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    share = np.bincount(model.faces.ravel(), weights=np.repeat(area, 3), minlength=len(model.mean))
    for part, factor in SPARSE.items():
        share[model.parts == part.value] *= factor
    upwards = np.argsort(model.mean[:, 1], kind="stable")
    cumulative = np.cumsum(share[upwards])
    return np.unique(upwards[np.searchsorted(cumulative, (np.arange(count) + 0.5) / count * cumulative[-1])])


UNITS = {"centimetres": 1.0, "metres": 100.0, "millimetres": 0.1}
MAX_MISFIT = 1.0  # cm; of an upright body in a coarse fit; drawn bodies have 0.2 to 0.6
MIN_GAIN = 1.3  # a turned orientation is chosen if the misfit as given is larger by this factor
SHORTLIST = 6  # orientations refined after the quick fits
COARSE_LEAN = np.radians(4.0)  # error of a coarse fit's rotation
SMALL_LEAN = np.radians(1.5)  # a smaller lean or turn is not corrected
POSTURE = np.radians(6.0)  # per cm of misfit, further lean forwards or backwards that stays: the posture may differ

_AXES = [np.eye(3)[list(order)] for order in itertools.permutations(range(3))]
_SIGNS = [np.diag(signs) for signs in itertools.product((1.0, -1.0), repeat=3)]
QUARTER_TURNS = tuple(turn for axes in _AXES for signs in _SIGNS if np.linalg.det(turn := signs @ axes) > 0)
"""The 24 rotations that permute the axes; the identity first."""
BACK_TO_FRONT = np.diag([-1.0, 1.0, -1.0])


@dataclass(frozen=True, eq=False)
class StandingTransform(Record):
    """From a mesh's coordinates to upright ones [cm]: ``turn · point``, down to y = 0, times ``unit``."""

    turn: Float[np.ndarray, "3 3"]
    floor: float
    """Height of the lowest vertex before the shift to y = 0 [unit of the mesh]."""
    unit: float = 1.0
    """Length of the mesh's unit [cm]."""

    @property
    def turned(self) -> bool:
        """Whether the transform rotates."""
        return not np.allclose(self.turn, np.eye(3))

    def apply(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Transform points of the mesh."""
        return (points @ self.turn.T - [0.0, self.floor, 0.0]) * self.unit


@dataclass(frozen=True, eq=False)
class UprightScan(Record):
    """A scan in upright orientation, with the body model coarsely aligned to it."""

    scan: BodyScan
    """In upright coordinates."""
    transform: StandingTransform
    """From the input to upright coordinates."""
    surface: SkinSurface
    """The surface of ``scan · scale + shift``: as tall as the model, centred over the origin."""
    scale: float
    shift: Float[np.ndarray, "3"]
    alignment: Alignment

    def in_cm(self, unit: float) -> "UprightScan":
        """The scan in centimetres; ``unit``: the length of the mesh's unit [cm]."""
        lengths = ("vertices", "holes", "mean_edge", "sagitta")
        scan = replace(self.scan, **{name: getattr(self.scan, name) * unit for name in lengths})
        return replace(self, scan=scan, transform=replace(self.transform, unit=unit), scale=self.scale / unit)


def unit_of(tall: float, name: str, height: float | None = None) -> float:
    """The length of the unit [cm] in which a body is ``tall``: it gives an adult's height, or ``height`` [cm] if given.

    Raises ``BodyError`` if ``tall`` is no adult's height in any of ``UNITS``, ``ConfigError`` if ``height`` is none.

    >>> unit_of(1.72, "scan.obj"), unit_of(0.5, "scan.obj", height=170.0)
    (100.0, 340.0)
    """
    if height is not None:
        if not is_adult_height(height):
            raise ConfigError(f"height {height:g}: no adult's: give it in centimetres, {ADULT[0]:g} to {ADULT[1]:g}")
        if tall > 0:
            return height / tall
    for unit in UNITS.values():
        if is_adult_height(tall * unit):
            return unit
    guesses = [f" ({tall * cm:.1f} cm if in {unit})" for unit, cm in OTHER_UNITS.items() if is_adult_height(tall * cm)]
    raise BodyError(
        f"{name}: {tall:.4g} tall, no adult's height in {', '.join(UNITS)}{''.join(guesses[:1])}: give the height of "
        "the body with --height CM (Python: height=)"
    )


def find_upright(scan: BodyScan, name: str) -> tuple[UprightScan, Registration]:
    """The scan upright and facing +z, turned if necessary, in its own unit; and the body model registered to it.

    Raises ``BodyError`` if it holds no body.
    """
    found = _nearest_quarter_turn(scan)
    if leans := np.linalg.norm(found.alignment.pose[3:6]) > COARSE_LEAN:
        found = _try(scan, found.alignment.turn.T @ found.transform.turn)
    if found.alignment.misfit > MAX_MISFIT:
        raise BodyError(
            f"{name}: no standing body is found: the nearest is {found.alignment.misfit:.1f} cm off on "
            "average: give one whole body with bare arms and legs, standing along y and facing +z"
        )
    registration = register(found.surface, found.alignment)
    pitch, yaw, roll = np.abs(registration.alignment.pose[3:6])
    upright = max(yaw, roll) < SMALL_LEAN and pitch < SMALL_LEAN + POSTURE * registration.alignment.misfit
    if leans or not upright:
        found = _try(scan, registration.alignment.turn.T @ found.transform.turn)
        registration = register(found.surface, found.alignment)
    return found, registration


def _nearest_quarter_turn(scan: BodyScan) -> UprightScan:
    """The scan as it is, unless the model fits it clearly better after one of ``QUARTER_TURNS``."""
    found, backward = _try(scan, np.eye(3)), _try(scan, BACK_TO_FRONT)
    if found.alignment.misfit > MAX_MISFIT or backward.alignment.misfit < found.alignment.misfit:
        quick = [_try(scan, quarter, quick_alignment).alignment.misfit for quarter in QUARTER_TURNS]
        shortlist = [QUARTER_TURNS[row] for row in np.argsort(quick, kind="stable")[:SHORTLIST]]
        candidates = [_try(scan, quarter) for quarter in shortlist]
        best = int(np.argmin([candidate.alignment.misfit for candidate in candidates]))
        if MIN_GAIN * candidates[best].alignment.misfit < found.alignment.misfit:
            return candidates[best]
    return found


def _try(
    scan: BodyScan, turn: Float[np.ndarray, "3 3"], align: Callable[[SkinSurface], Alignment] = coarse_alignment
) -> UprightScan:
    """The scan in one orientation, with the model aligned to it."""
    transform = StandingTransform(turn, float((scan.vertices @ turn[1]).min()))
    standing = transform.apply(scan.vertices)
    scale = model_height() / float(np.ptp(standing[:, 1]))
    middle = (standing.max(axis=0) + standing.min(axis=0)) / 2
    shift = np.array([-middle[0], 0.0, -middle[2]]) * scale
    surface = SkinSurface.of(standing * scale + shift, scan.faces, scan.patched)
    turned = replace(scan, vertices=standing)
    return UprightScan(turned, transform, surface, scale, shift, align(surface))
