"""People of a body set: drawn from a group, in both poses (legs straight and apart), measured."""

from dataclasses import replace
from typing import Any

import numpy as np

from gcd_dataset.bodies import BodyMesh, Person
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.body import build_body, measure
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.shape import GROUPS, draw_from
from gcd_dataset.seeding import Stage, rng


def people_recipe(bodies: str) -> dict[str, Any]:
    """The options of a person besides seed, index and mesh, as stored in a body set's manifest.

    Raises ``ConfigError`` unless ``bodies`` is one of ``GROUPS``.
    """
    if bodies not in GROUPS:
        raise ConfigError(f"bodies is {bodies!r}: a body set is drawn from {', '.join(GROUPS)}")
    return {"stage": "body", "bodies": bodies}


def make_person(seed: int, index: int, *, bodies: str = "random") -> Person:
    """Person ``index`` of ``seed``: the drawn body that wears design ``index`` of a data set with these ``bodies``."""
    kind, shape = draw_from(bodies, rng(seed, index, Stage.BODY))
    name = f"{kind}:{seed}:{index}"
    straight, apart = build_body(shape, name=name), build_body(replace(shape, legs_apart=True), name=name)
    return Person(
        name=name,
        shape=shape,
        straight=straight.vertices.astype(np.float32),
        apart=apart.vertices.astype(np.float32),
        measurements=measure(straight),
    )


def model_mesh() -> BodyMesh:
    """The body model's mesh, shared by all people."""
    model = body_model()
    return BodyMesh(model.faces, model.parts)
