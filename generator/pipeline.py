"""The steps of a sample: body, measures, design, pattern, box mesh, then the drape's jobs, points, pictures.

A sample is named by ``(seed, index)`` and comes out the same alone, in a batch, in any order and in any process.
``gcd_dataset.generator.maker.produce`` runs the steps.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from gcd_dataset.errors import MeshError, PatternError
from gcd_dataset.generator.body import build_body, draw_shape, measure, neutral_shape
from gcd_dataset.generator.body.population import SEXES
from gcd_dataset.generator.drawing import jpeg_bytes
from gcd_dataset.generator.dressing.sewing_start import sewing_start
from gcd_dataset.generator.garments import OutfitDesign, Reject, design_to_dict, sample_design, sample_kind, try_on
from gcd_dataset.generator.mesh import CoarseMesh, build_box_mesh, coarse_start
from gcd_dataset.generator.points import sample_surface
from gcd_dataset.generator.recipe import MakeConfig, recipe_of, versions
from gcd_dataset.records import (
    Body,
    BodyShape,
    BoxMesh,
    Drape,
    Measurements,
    NamedFabric,
    Outcome,
    Pattern,
    Provenance,
    Rejected,
    Sample,
)
from gcd_dataset.seeding import Stage, rng

if TYPE_CHECKING:
    from gcd_dataset.generator.drape import DrapeJob
    from gcd_dataset.generator.drapers import DrapeReply

__all__ = [
    "Dressed",
    "DressedDesign",
    "build_pattern",
    "drape_jobs",
    "finish",
    "fit",
    "prepare",
    "sample_key",
    "turned_down",
]


def build_pattern(size: Measurements, design: OutfitDesign, *, name: str = "outfit") -> Pattern:
    """The pattern of a design for a wearer. Raises ``PatternError`` where it cannot be drawn or worn."""
    pattern = try_on(size, design, name=name)
    if isinstance(pattern, Reject):
        raise PatternError(str(pattern))
    return pattern


def fit(design: OutfitDesign, sizes: Iterable[Measurements]) -> tuple[Pattern, ...]:
    """The patterns of one design for many wearers.

    Raises ``PatternError`` with the number of the first wearer for whom it cannot be drawn, or who cannot wear it.
    """
    patterns = []
    for number, size in enumerate(sizes):
        try:
            patterns.append(build_pattern(size, design, name=f"wearer_{number}"))
        except PatternError as error:
            raise PatternError(f"wearer {number}: {error}: change the design, or leave this wearer out") from error
    return tuple(patterns)


def sample_key(index: int) -> str:
    """The name of a sample in a shard.

    >>> sample_key(12)
    'gcd_000000012'
    """
    return f"gcd_{index:09d}"


# --------------------------------------------------------------------------------------------------------------- steps


@dataclass(frozen=True)
class Dressed:
    """One wearer of a design, ready to be draped."""

    index: int
    body_name: str
    shape: BodyShape
    body: Body
    size: Measurements
    pattern: Pattern
    box_mesh: BoxMesh | None
    coarse: CoarseMesh | None
    start: Float[np.ndarray, "v 3"] | None
    """Start positions of the drape, as ``DrapeJob.start`` [cm]."""


@dataclass(frozen=True)
class DressedDesign:
    """A design that can be worn, how it was come by, and those who wear it."""

    seed: int
    number: int
    rejects: tuple[Rejected, ...]
    design: OutfitDesign
    dressed: tuple[Dressed, ...]


def prepare(seed: int, number: int, config: MakeConfig, rejects: tuple[Rejected, ...] = ()) -> DressedDesign:
    """Design ``number`` with its bodies, patterns and meshes: the first that can be worn after those turned down."""
    wearers = _wearers(seed, number, config)
    # One stream for the kind, whatever the attempt: a kind that is often turned down would become rare otherwise.
    kind = sample_kind(rng(seed, number, Stage.KIND), config.design)
    while len(rejects) < config.max_attempts:
        chance = rng(seed, number, Stage.DESIGN, len(rejects))
        sizes = [wearer.size for wearer in wearers]
        design = sample_design(chance, sizes, kind=kind, overlay=config.design)
        dressed = _dress_all(seed, wearers, design, config)
        if not isinstance(dressed, Rejected):
            return DressedDesign(seed, number, rejects, design, dressed)
        rejects += (dressed,)
    raise PatternError(
        f"sample {number * config.wearers} of seed {seed}: {len(rejects)} designs were turned down, the last for: "
        f"{rejects[-1]}: raise max_attempts"
    )


@dataclass(frozen=True)
class _Wearer:
    index: int
    name: str
    shape: BodyShape
    body: Body
    size: Measurements


def _wearers(seed: int, number: int, config: MakeConfig) -> tuple[_Wearer, ...]:
    """The bodies of a design, in the order of their indices."""
    shapes = {}
    sex = config.bodies if config.bodies in SEXES else None
    if config.bodies in ("neutral", "both"):
        shapes["neutral"] = neutral_shape()
    for place in range(config.bodies_each if config.bodies != "neutral" else 0):
        name = f"{sex or 'random'}:{seed}:{number}" + (f":{place}" if place else "")
        shapes[name] = draw_shape(rng(seed, number, Stage.BODY, place), sex=sex)
    wearers = []
    for place, (name, shape) in enumerate(shapes.items()):
        body = build_body(shape)
        wearers.append(_Wearer(number * config.wearers + place, name, shape, body, measure(body)))
    return tuple(wearers)


def _dress_all(
    seed: int, wearers: Iterable[_Wearer], design: OutfitDesign, config: MakeConfig
) -> tuple[Dressed, ...] | Rejected:
    """All wearers in the design, or why one of them cannot wear it."""
    dressed = []
    for wearer in wearers:
        worn = _dress(seed, wearer, design, config)
        if isinstance(worn, Reject):
            return Rejected(wearer.index, worn.rule, worn.figures, worn.numbers)
        dressed.append(worn)
    return tuple(dressed)


def _dress(seed: int, wearer: _Wearer, design: OutfitDesign, config: MakeConfig) -> Dressed | Reject:
    pattern = try_on(wearer.size, design, name=sample_key(wearer.index))
    if isinstance(pattern, Reject):
        return pattern
    shape = _held(seed, wearer, config)
    if design.meta.bottom and design.meta.bottom.garment.legs:  # measured with legs together, dressed with legs apart
        shape = replace(shape, legs_apart=True)
    body = wearer.body if shape is wearer.shape else build_body(shape)
    try:
        mesh = build_box_mesh(pattern, spacing=config.resolution) if config.stage != "pattern" else None
    except MeshError as error:
        return Reject("cannot_be_meshed", str(error))
    coarse, start = None, None
    if mesh is not None and config.stage == "drape":
        coarse = coarse_start(mesh)
        start = sewing_start(coarse.mesh if coarse else mesh, body)
    return Dressed(wearer.index, wearer.name, shape, body, wearer.size, pattern, mesh, coarse, start)


def _held(seed: int, wearer: _Wearer, config: MakeConfig) -> BodyShape:
    """The wearer with the arms as chance holds them."""
    if not config.arms:
        return wearer.shape
    turn = rng(seed, wearer.index, Stage.ARMS).uniform(-config.arms, config.arms)
    return replace(wearer.shape, arm_angle=math.radians(turn))


def drape_jobs(design: DressedDesign, config: MakeConfig) -> tuple["DrapeJob", ...]:
    """What is to be draped for each wearer; nothing at an earlier stage."""
    if config.stage != "drape":
        return ()
    from gcd_dataset.generator.drape import DrapeJob, fabric_named

    fabric = fabric_named(config.fabric)
    return tuple(
        DrapeJob(worn.box_mesh, worn.body, worn.size, fabric, worn.coarse, worn.start)
        for worn in design.dressed
        if worn.box_mesh is not None
    )


def turned_down(design: DressedDesign, drapes: Sequence[Drape], config: MakeConfig) -> DressedDesign | None:
    """The design with the reason for another attempt, if one of its drapes failed and may be tried again."""
    failed = next((place for place, drape in enumerate(drapes) if drape.outcome is not Outcome.SETTLED), None)
    last = len(design.rejects) + 1 >= config.max_attempts
    if failed is None or config.on_fail == "keep" or last:
        return None
    drape = drapes[failed]
    reject = Rejected(design.dressed[failed].index, "drape", drape.outcome.name.lower(), _drape_figures(drape))
    return replace(design, rejects=(*design.rejects, reject))


def _drape_figures(drape: Drape) -> dict[str, float]:
    """The numbers of a drape; without the stretch of one that diverged, which is none."""
    names = ("frames", "self_crossings", "body_crossings", "body_through", "stretch_median", "stretch_p99")
    return {name: value for name in names if math.isfinite(value := getattr(drape, name))}


def finish(design: DressedDesign, index: int, config: MakeConfig, draped: "DrapeReply | None") -> Sample:
    """The sample of one wearer: points are taken, pictures encoded. ``draped``: ``None`` at an earlier stage."""
    dressed = design.dressed[index % config.wearers]
    mesh, points = dressed.box_mesh, None
    if mesh is not None:
        surface = mesh.vertices if draped is None else draped.drape.vertices
        points = sample_surface(surface, mesh.faces, config.points, rng(design.seed, index, Stage.POINTS))
    front, back = (None, None) if draped is None or draped.pictures is None else map(jpeg_bytes, draped.pictures)
    return Sample(
        key=sample_key(index),
        provenance=Provenance(
            seed=design.seed,
            index=index,
            attempts=len(design.rejects) + 1,
            rejects=tuple(map(str, design.rejects)),
            turned_down=design.rejects,
            versions=versions(),
            recipe=recipe_of(config),
            body_name=dressed.body_name,
        ),
        pattern=dressed.pattern,
        measurements=dressed.size,
        design=design_to_dict(design.design),
        shape=dressed.shape,
        box_mesh=mesh,
        drape=None if draped is None else draped.drape,
        points=points,
        front=front,
        back=back,
        fabric=None if draped is None else _fabric(config.fabric),
    )


def _fabric(name: str) -> NamedFabric:
    """A fabric as samples hold it."""
    from gcd_dataset.generator.drape import fabric_named

    parameters = asdict(fabric_named(name)).items()
    return NamedFabric(name, {key: list(value) if isinstance(value, tuple) else value for key, value in parameters})
