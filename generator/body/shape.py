"""Bodies from shape weights: ``X = mean + components · w``, then the pose (Korosteleva et al., ECCV 2024).

Adults of each sex are a Gaussian over the weights, calibrated to a survey: ``adults.npz``, made by
``tools/body_model/calibrate.py``, holds its mean and principal axes. Half of the adults are women.
"""

import functools
import io
from dataclasses import dataclass, replace

import numpy as np
import shapely
from jaxtyping import Float, Int

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.asset import COARSE_PARTS, body_model, checked_data, landmark_table
from gcd_dataset.generator.body.repair import ROUNDS, SkinMesh, Smoothed
from gcd_dataset.generator.body.section import section_points
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import Body, BodyPart, BodyShape, Record

LEGS_APART = np.radians(3.0)
"""Rotation of each thigh with legs apart [rad]: moves the feet from 15 to 19 cm off the midplane."""

T_POSE = np.radians(45.0)
"""``arm_angle`` from the A-pose to horizontal upper arms [rad]."""

LEFT_ARM, LEFT_LEG, LEFT_FOOT, RIGHT_ARM, RIGHT_LEG, RIGHT_FOOT = range(6)


def set_pose(
    vertices: Float[np.ndarray, "v 3"],
    joints: Float[np.ndarray, "6 3"],
    skin: Float[np.ndarray, "v 6"],
    *,
    arm: float = 0.0,
    leg: float = 0.0,
) -> Float[np.ndarray, "v 3"]:
    """The vertices with both arms raised by ``arm`` and both legs spread by ``leg`` [rad]; the soles stay level.

    ``joints`` [cm] and the columns of ``skin``, the skinning weights, are ordered as ``LEFT_ARM`` to ``RIGHT_FOOT``.
    """
    posed = vertices.copy()
    for side, shoulder, hip, ankle in ((1, LEFT_ARM, LEFT_LEG, LEFT_FOOT), (-1, RIGHT_ARM, RIGHT_LEG, RIGHT_FOOT)):
        if arm:
            _blend_rotation(posed, joints[shoulder], side * arm, skin[:, shoulder])
        if leg:
            foot = _rotated(joints[ankle, :2], joints[hip], side * leg)
            _blend_rotation(posed, joints[hip], side * leg, skin[:, hip])
            _blend_rotation(posed, foot, -side * leg, skin[:, ankle])
    return posed


def stand(vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "v 3"]:
    """The vertices with the lowest of them on y = 0."""
    standing = vertices.copy()
    standing[:, 1] -= vertices[:, 1].min()
    return standing


def _blend_rotation(
    points: Float[np.ndarray, "v 3"], centre: np.ndarray, angle: float, weights: Float[np.ndarray, " v"]
) -> None:
    """Move points in place towards their rotated positions, linearly by weight (linear blend skinning)."""
    rows = np.flatnonzero(weights)
    share, (x, y) = weights[rows], points[rows, :2].T
    turned = _rotated(np.stack([x, y], axis=-1), centre, angle)
    points[rows, 0] = x + share * (turned[:, 0] - x)
    points[rows, 1] = y + share * (turned[:, 1] - y)


def _rotated(points: Float[np.ndarray, "*n 2"], centre: np.ndarray, angle: float) -> Float[np.ndarray, "*n 2"]:
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = points[..., 0] - centre[0], points[..., 1] - centre[1]
    return np.stack([cos * x - sin * y + centre[0], sin * x + cos * y + centre[1]], axis=-1)


X, Y, Z = range(3)
ARMPIT = 3.0  # cm below the underarm point, where arm and trunk separate; GarmentCode's armholes reach 2.5 cm down


def arm_clearance(body: Body) -> float:
    """Least distance between the convex hulls of arm and trunk in the level section below the armpits [cm]."""
    level = body.vertices[landmark_table().points["underarm_right"], Y] - ARMPIT
    sections = (
        section_points(body.vertices, _edges_of(part), Y, np.array([level]))[0]
        for part in (BodyPart.TRUNK, BodyPart.LEFT_ARM, BodyPart.RIGHT_ARM)
    )
    trunk, *arms = (shapely.convex_hull(shapely.multipoints(points[:, [X, Z]])) for points in sections)
    return float(min(shapely.distance(trunk, arm) for arm in arms))


@functools.cache
def _edges_of(part: BodyPart) -> Int[np.ndarray, "e 2"]:
    """Edges of the faces that lie in a part with all corners."""
    model = body_model()
    return mesh_edges(model.faces[(model.parts == part.value)[model.faces].all(axis=1)]).ends


SEXES = ("female", "male")
POOLED = "pooled"
"""The pool of GarmentCodeData: bodies about the neutral one, mostly between the sexes."""
GROUPS = ("random", *SEXES, POOLED)
"""Groups that bodies are drawn from; ``random``: women and men, as a population is made up."""
FEMALE_SHARE = 0.5  # share of women among adults; within one or two per cent in most countries
MAX_DEVIATION = 3.0  # standard deviations along each axis, to which draws are clipped


@dataclass(frozen=True, eq=False)
class Adults(Record):
    """The normal distribution of shape weights among the adults of one sex."""

    mean: Float[np.ndarray, " k"]
    axes: Float[np.ndarray, "k k"]
    """Principal axes as columns, one standard deviation long."""


@functools.cache
def adults_of(sex: str) -> Adults:
    """The adults of a sex, one of ``SEXES``. Raises ``BodyError`` for a damaged file."""
    with np.load(io.BytesIO(checked_data("adults.npz"))) as file:
        return Adults(file[f"{sex}_mean"].astype(float), file[f"{sex}_axes"].astype(float))


def weights_of(adults: Adults, deviates: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Shape weights of the adult at ``deviates`` standard deviations along each axis."""
    along = np.clip(deviates, -MAX_DEVIATION, MAX_DEVIATION)
    # einsum: the rounding of a BLAS product depends on its threads, and samples must be the same on any machine.
    return adults.mean + np.einsum("ka,a->k", adults.axes, along)


SPREAD = 0.7  # standard deviation of pooled weights, as in GarmentCodeData
CLEFT = 0.1  # cm: least gap between the skin and its mirror image
MAX_ARM_ANGLE = np.radians(15.0)  # largest sampled turn of the arms, up or down from the A-pose, as in GarmentCodeData
ARM_ROOM = 1.2  # cm between arm and trunk below the armpits: room for two layers of cloth
ARM_STEP = np.radians(2.0)  # arms are raised in these steps until they have room


def neutral_shape(*, legs_apart: bool = False) -> BodyShape:
    """The neutral body, between the mean woman and the mean man."""
    return named_shape("neutral", legs_apart=legs_apart)


def named_shape(name: str, *, legs_apart: bool = False) -> BodyShape:
    """The shape of the body ``neutral``, ``female`` or ``male``. Raises ``BodyError`` for another name."""
    named = body_model().named
    if name not in named:
        raise BodyError(
            f"no body named {name}: there are {', '.join([*named, *(f'{group}:SEED' for group in GROUPS)])}, or a mesh "
            "file"
        )
    return BodyShape(named[name], legs_apart=legs_apart)


def draw_shape(rng: np.random.Generator, *, group: str = "random", legs_apart: bool = False) -> BodyShape:
    """A random body with a random arm angle near the A-pose, the arms clear of the trunk.

    ``group``: ``random`` draws a woman or a man; ``female`` or ``male`` an adult of that sex, distributed as in a
    survey (see ``population``); ``pooled`` a body about the neutral one, mostly between the sexes, as in
    GarmentCodeData. Raises ``BodyError`` for another group.
    """
    return draw_from(group, rng, legs_apart=legs_apart)[1]


def draw_from(group: str, rng: np.random.Generator, *, legs_apart: bool = False) -> tuple[str, BodyShape]:
    """The kind of a random body, ``female``, ``male`` or ``pooled``, and the body: see ``draw_shape``.

    The woman that ``random`` draws is the one that ``female`` draws from the same stream, and so is the man.
    """
    if group not in GROUPS:
        raise BodyError(f"no bodies of group {group!r}: give {', '.join(GROUPS)}")
    components = len(body_model().components)
    deviates = rng.standard_normal(components)
    arm_angle = float(rng.uniform(-MAX_ARM_ANGLE, MAX_ARM_ANGLE))
    kind = group
    if group == "random":  # after all else is drawn, so that both sexes share the stream
        kind = "female" if rng.random() < FEMALE_SHARE else "male"
    weights = SPREAD * deviates if kind == POOLED else weights_of(adults_of(kind), deviates)
    shape = BodyShape(weights, arm_angle, legs_apart)
    # Arms are raised until there is room below the armpits. Creases stay: a self-intersecting armpit is a reason to
    # raise the arm, not to smooth the skin.
    while shape.arm_angle < MAX_ARM_ANGLE and arm_clearance(_built(shape, "body", resolve_creases=False)) < ARM_ROOM:
        shape = replace(shape, arm_angle=min(shape.arm_angle + ARM_STEP, MAX_ARM_ANGLE))
    return kind, shape


def build_body(shape: BodyShape, *, name: str = "body") -> Body:
    """The body of a shape, lowest vertex at y = 0. Raises ``BodyError`` for a wrong number of weights."""
    return _built(shape, name, resolve_creases=True)


def _built(shape: BodyShape, name: str, *, resolve_creases: bool) -> Body:
    model = body_model()
    if shape.weights.shape != (len(model.components),):
        raise BodyError(f"{name}: {shape.weights.size} shape weights, the body model takes {len(model.components)}")
    body = _unfolded(shape.weights.astype(float).tobytes(), shape.arm_angle, shape.legs_apart)
    if resolve_creases:
        body = body_skin().smoothed(body.vertices, body.rounds, resolve_creases=True, normals=body.normals)
    return Body(stand(body.vertices), model.faces, model.parts, name)


@functools.lru_cache(maxsize=2)  # ``build_body`` reuses the body posed by the check of the arms' clearance
def _unfolded(weights: bytes, arm_angle: float, legs_apart: bool) -> Smoothed:
    """The posed body without folds, its creases not yet resolved."""
    vertices, joints = _unposed(weights)
    posed = set_pose(vertices, joints, body_model().skin, arm=arm_angle, leg=LEGS_APART if legs_apart else 0.0)
    unfolded = body_skin().smoothed(posed, ROUNDS, resolve_creases=False)
    unfolded.vertices.flags.writeable = unfolded.normals.flags.writeable = False
    return unfolded


@functools.lru_cache(maxsize=2)  # drawing raises the arms of one body step by step, then builds it to dress it
def _unposed(weights: bytes) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, "6 3"]]:
    """Vertices and joints of the body with these weights, as float64, before its pose."""
    model, values = body_model(), np.frombuffer(weights)
    # einsum: the rounding of a BLAS product depends on its threads, and samples must be the same on any machine.
    vertices = model.mean + np.einsum("k,kvi->vi", values, model.components)
    # ``CLEFT / 2`` off the plane x = 0, on their usual side: thighs and breasts do not cross there.
    usual, side = model.mean[:, 0], np.sign(model.mean[:, 0])
    vertices[:, 0] = side * np.maximum(side * vertices[:, 0], np.minimum(np.abs(usual), CLEFT / 2))
    joints = model.joints + np.einsum("k,kni->ni", values, model.joint_components)
    vertices.flags.writeable = joints.flags.writeable = False
    return vertices, joints


@functools.cache
def body_skin() -> SkinMesh:
    """The skin that cloth touches, to be kept free of folds; head, hands and feet have natural folds."""
    model = body_model()
    excluded = np.isin(model.parts, [part.value for part in COARSE_PARTS])
    return SkinMesh.of(model.mean, model.faces[~excluded[model.faces].any(axis=1)])
