"""Bodies from a few numbers: ``X = mean + components · w``, then the pose (Korosteleva et al., ECCV 2024)."""

import functools
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.asset import COARSE_PARTS, body_model
from gcd_dataset.generator.body.clearance import arm_clearance
from gcd_dataset.generator.body.population import adults_of, draw_weights
from gcd_dataset.generator.body.pose import LEGS_APART, set_pose, stand
from gcd_dataset.generator.body.untangle import SkinMesh
from gcd_dataset.records import Body, BodyShape

__all__ = ["build_body", "draw_shape", "female_shape", "male_shape", "named_shape", "neutral_shape"]

SPREAD = 0.7  # standard deviations of the drawn weights, GarmentCodeData's
CLEFT = 0.1  # cm left open between what would touch its mirror image
ARM_SWING = np.radians(15.0)  # largest raising or lowering of the drawn arms, GarmentCodeData's
ARM_ROOM = 1.2  # cm left open between arm and trunk below the armpits, for the cloth of both
ARM_STEP = np.radians(2.0)  # by which arms are raised until they have it


def neutral_shape(*, legs_apart: bool = False) -> BodyShape:
    """The body between the mean woman and the mean man."""
    return named_shape("neutral", legs_apart=legs_apart)


def female_shape(*, legs_apart: bool = False) -> BodyShape:
    """The mean woman."""
    return named_shape("female", legs_apart=legs_apart)


def male_shape(*, legs_apart: bool = False) -> BodyShape:
    """The mean man."""
    return named_shape("male", legs_apart=legs_apart)


def named_shape(name: str, *, legs_apart: bool = False) -> BodyShape:
    """The body of that name. Raises ``BodyError`` with the names there are."""
    named = body_model().named
    if name not in named:
        raise BodyError(
            f"no body named {name}: there are {', '.join(named)}, random:SEED, female:SEED, male:SEED, or a mesh file"
        )
    return BodyShape(named[name], legs_apart=legs_apart)


def draw_shape(rng: np.random.Generator, *, sex: str | None = None, legs_apart: bool = False) -> BodyShape:
    """A body drawn at random, with its arms somewhere about the A-pose, but clear of the trunk.

    With ``sex`` given, ``female`` or ``male``, an adult as a survey finds them (see ``population``); else a body about
    the neutral one, mostly between the sexes, as GarmentCodeData draws them. Raises ``BodyError`` for another sex.
    """
    if sex is None:
        weights = rng.normal(0.0, SPREAD, size=len(body_model().components))
    else:
        weights = draw_weights(rng, adults_of(sex))
    return _hanging_clear(BodyShape(weights, float(rng.uniform(-ARM_SWING, ARM_SWING)), legs_apart))


def _hanging_clear(shape: BodyShape) -> BodyShape:
    """The shape with its arms raised until there is room below the armpits, at most to where drawn arms end."""
    # Skin is parted afterwards: an armpit that passes through itself calls for an arm held higher.
    while shape.arm_angle < ARM_SWING and arm_clearance(_built(shape, "body", parted=False)) < ARM_ROOM:
        shape = replace(shape, arm_angle=min(shape.arm_angle + ARM_STEP, ARM_SWING))
    return shape


def build_body(shape: BodyShape, *, name: str = "body") -> Body:
    """The body of a shape, standing at y = 0. Raises ``BodyError`` where the number of weights is not the model's."""
    return _built(shape, name, parted=True)


def _built(shape: BodyShape, name: str, *, parted: bool) -> Body:
    model = body_model()
    if shape.weights.shape != (len(model.components),):
        raise BodyError(f"{name}: {shape.weights.size} shape weights, the body model takes {len(model.components)}")
    # einsum and not a matrix product: the sums of BLAS depend on its threads, and a sample is to be the same anywhere.
    vertices = model.mean + np.einsum("k,kvi->vi", shape.weights, model.components)
    vertices[:, 0] = _on_own_side(vertices[:, 0], model.mean[:, 0])
    joints = model.joints + np.einsum("k,kni->ni", shape.weights, model.joint_components)
    posed = set_pose(vertices, joints, model.skin, arm=shape.arm_angle, leg=LEGS_APART if shape.legs_apart else 0.0)
    return Body(stand(_skin().flattened(posed, parted=parted)), model.faces, model.parts, name)


@functools.cache
def _skin() -> SkinMesh:
    """What cloth meets; head, hands and feet are folded by nature."""
    model = body_model()
    folded = np.isin(model.parts, [part.value for part in COARSE_PARTS])
    return SkinMesh.of(model.mean, model.faces[~folded[model.faces].any(axis=1)])


def _on_own_side(x: Float[np.ndarray, " v"], usual: Float[np.ndarray, " v"]) -> Float[np.ndarray, " v"]:
    """``x`` kept from crossing the plane x = 0, where left and right thigh or breast would pass through each other."""
    side = np.sign(usual)
    return side * np.maximum(side * x, np.minimum(np.abs(usual), CLEFT / 2))
