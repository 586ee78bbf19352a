"""Bodies by name: ``neutral``, ``random:7``, or the path of a mesh file; and the people of a body set."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gcd_dataset.bodies import BodyMesh, Person
from gcd_dataset.bodyfiles import read_measurements, require_same_body
from gcd_dataset.errors import BodyError, ConfigError, shown
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.measuring import measure
from gcd_dataset.generator.body.mesh_bodies import read_body
from gcd_dataset.generator.body.shape import GROUPS, build_body, draw_from, draw_shape, named_shape
from gcd_dataset.generator.body.smpl import Betas
from gcd_dataset.records import Body, BodyShape, Measurements
from gcd_dataset.seeding import Stage, rng

MAX_SEED_DIGITS = 100


def named_body(
    name_or_path: str | Path,
    *,
    measurements: Path | str | None = None,
    segmentation: Path | str | None = None,
    legs_apart: bool = False,
    height: float | None = None,
    betas: Betas | None = None,
) -> tuple[Body, Measurements, BodyShape | None]:
    """A body, its measures, and its shape, or ``None`` for a mesh file.

    ``name_or_path`` is a name (see ``shape_by_name``), or a mesh or model file (see ``read_body``), to which
    ``legs_apart`` does not apply; ``height`` [cm] gives its scale, ``betas`` the shape of a model file. Measures are
    taken with the legs straight, as in GarmentCode. Raises ``BodyError``, and ``ConfigError`` for a ``height`` that no
    adult has.
    """
    shape = shape_by_name(str(name_or_path), legs_apart=legs_apart)
    if shape is None:
        return *read_body(name_or_path, measurements, segmentation, height=height, betas=betas), None
    if segmentation is not None or height is not None or betas is not None:
        told = "a named body has known parts and height: leave segmentation, height and betas out"
        raise BodyError(f"{name_or_path}: {told}")
    body, size = build_body(shape, name=str(name_or_path)), measure(build_body(replace(shape, legs_apart=False)))
    if measurements is None:
        return body, size, shape
    other = read_measurements(measurements)
    require_same_body(other, size, measurements, name_or_path)
    return body, other, shape


def shape_by_name(name: str, *, legs_apart: bool) -> BodyShape | None:
    """The shape of this name, or ``None`` for the path of a file.

    Mean bodies: ``neutral``, ``female``, ``male``. Drawn bodies: ``random:SEED``, ``female:SEED``,
    ``male:SEED`` and ``pooled:SEED``; see ``draw_shape``. Raises ``BodyError`` for an
    unknown name or a malformed seed.
    """
    prefix, colon, seed = name.partition(":")
    if colon and prefix in GROUPS:
        return draw_shape(rng(_seed(name, seed), 0, Stage.BODY), group=prefix, legs_apart=legs_apart)
    if name in body_model().named or not Path(name).suffix:
        return named_shape(name, legs_apart=legs_apart)
    return None


def _seed(name: str, text: str) -> int:
    if not (text.isdecimal() and len(text) <= MAX_SEED_DIGITS):
        kind = name.partition(":")[0]
        raise BodyError(
            f"{shown(name[:60])}: the seed is {text[:60]!r}: give a whole number of 0 or more, such as {kind}:7"
        )
    return int(text)


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
