"""People of a body set: drawn from the population, in both poses (legs straight and apart), measured."""

from dataclasses import replace
from typing import Any

import numpy as np

from gcd_dataset.bodies import BodyMesh, Person
from gcd_dataset.generator.body import build_body, draw_shape, measure
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.seeding import Stage, rng

__all__ = ["PEOPLE_RECIPE", "make_person", "model_mesh"]

PEOPLE_RECIPE: dict[str, Any] = {"stage": "body", "bodies": "random"}
"""The options of a person besides seed, index and mesh, as stored in a body set's manifest."""


def make_person(seed: int, index: int) -> Person:
    """Person ``index`` of ``seed``: the random body that wears design ``index`` of a data set with this seed."""
    name = f"random:{seed}:{index}"
    shape = draw_shape(rng(seed, index, Stage.BODY))
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
