"""The whole way of a sample on one page: body, measures, design, pattern, box mesh, drape, points, pictures.

A sample is named by ``(seed, index)`` and comes out the same alone, in a batch, in any order and in any process.
"""

import math
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import chain, islice

from gcd_dataset.errors import MeshError, PatternError
from gcd_dataset.generator.body import build_body, draw_shape, measure, neutral_shape
from gcd_dataset.generator.body.population import SEXES
from gcd_dataset.generator.garments import OutfitDesign, Reject, design_to_dict, sample_design, sample_kind, try_on
from gcd_dataset.generator.garments.design import Bottom
from gcd_dataset.generator.last_design import LastDesign, MadeDesign
from gcd_dataset.generator.mesh import Coarse, build_box_mesh, coarse_start
from gcd_dataset.generator.points import sample_surface
from gcd_dataset.generator.recipe import MakeConfig, device_kind, recipe_of, versions
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
    Sample,
)
from gcd_dataset.seeding import Stage, rng

__all__ = [
    "Dressed",
    "DressedDesign",
    "build_pattern",
    "finish",
    "fit",
    "make",
    "make_many",
    "prepare",
    "sample_key",
    "turned_down",
]

BATCH = {"cpu": 1, "cuda": 64}  # garments draped at a time
DEFAULT = MakeConfig()


def make(seed: int, index: int, config: MakeConfig = DEFAULT) -> Sample:
    """Sample ``index`` of ``seed``. Raises ``PatternError`` where ``config.max_attempts`` designs were turned down."""
    return next(make_many(seed, [index], config))


def make_many(
    seed: int,
    indices: Iterable[int],
    config: MakeConfig = DEFAULT,
    *,
    batch: int | None = None,
    last: LastDesign | None = None,
    pictured: bool = True,
) -> Iterator[Sample]:
    """The samples of ``indices``, in order; up to ``batch`` garments are draped at a time (1 on a CPU, 64 on a GPU).

    With ``bodies="both"`` a design is taken or turned down for both of its bodies, so both are draped even if one index
    is asked for: a ``last`` that is given to the next call too holds the other meanwhile. Without ``pictured`` nothing
    else is different but that pictures are missing. Raises ``PatternError`` as ``make`` does.
    """
    order = deque(indices)
    asked = Counter(order)
    last = last or LastDesign()
    waiting = deque(dict.fromkeys(index // config.wearers for index in order))
    at_once = max((batch or BATCH[device_kind(config)]) // config.wearers, 1) if config.stage == "drape" else 1
    again = deque[DressedDesign]()
    done: dict[int, Sample] = {}
    made = last.made
    if made is not None and made.number in waiting:
        waiting.remove(made.number)
        first = made.number * config.wearers
        done |= {index: made.sample_of(index) for index in range(first, first + config.wearers) if index in asked}
    while True:
        while order and order[0] in done:
            index = order.popleft()
            asked[index] -= 1
            yield done[index] if asked[index] else done.pop(index)
        if not order:
            return
        load = [prepare(seed, failed.number, config, failed.rejects) for failed in again]
        again.clear()
        load += [prepare(seed, waiting.popleft(), config) for _ in range(min(at_once - len(load), len(waiting)))]
        for design, drapes in zip(load, _drape(load, config), strict=True):
            if failed := turned_down(design, drapes, config):
                again.append(failed)
                continue
            made = MadeDesign(design.number, partial(_finished, design, drapes, config, pictured))
            done |= {worn.index: made.sample_of(worn.index) for worn in design.dressed if worn.index in asked}
            if any(worn.index not in asked for worn in design.dressed):
                last.made = made


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
    coarse: Coarse | None


@dataclass(frozen=True)
class DressedDesign:
    """A design that can be worn, how it was come by, and those who wear it."""

    seed: int
    number: int
    rejects: tuple[str, ...]
    design: OutfitDesign
    dressed: tuple[Dressed, ...]


def prepare(seed: int, number: int, config: MakeConfig, rejects: tuple[str, ...] = ()) -> DressedDesign:
    """Design ``number`` with its bodies, patterns and meshes: the first that can be worn after those turned down."""
    wearers = _wearers(seed, number, config)
    # One stream for the kind, whatever the attempt: a kind that is often turned down would become rare otherwise.
    kind = sample_kind(rng(seed, number, Stage.KIND), config.design)
    while len(rejects) < config.max_attempts:
        chance = rng(seed, number, Stage.DESIGN, len(rejects))
        sizes = [wearer.size for wearer in wearers]
        design = sample_design(chance, sizes, kind=kind, overlay=config.design)
        dressed = _dress_all(seed, wearers, design, config)
        if not isinstance(dressed, Reject):
            return DressedDesign(seed, number, rejects, design, dressed)
        rejects += (str(dressed),)
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
) -> tuple[Dressed, ...] | Reject:
    """All wearers in the design, or why one of them cannot wear it."""
    dressed = []
    for wearer in wearers:
        worn = _dress(seed, wearer, design, config)
        if isinstance(worn, Reject):
            return worn
        dressed.append(worn)
    return tuple(dressed)


def _dress(seed: int, wearer: _Wearer, design: OutfitDesign, config: MakeConfig) -> Dressed | Reject:
    pattern = try_on(wearer.size, design, name=sample_key(wearer.index))
    if isinstance(pattern, Reject):
        return pattern
    shape = _held(seed, wearer, config)
    if design.meta.bottom is Bottom.PANTS:  # measured with legs together, dressed with legs apart
        shape = replace(shape, legs_apart=True)
    body = wearer.body if shape is wearer.shape else build_body(shape)
    try:
        mesh = build_box_mesh(pattern, spacing=config.resolution) if config.stage != "pattern" else None
    except MeshError as error:
        return Reject("cannot_be_meshed", str(error))
    coarse = coarse_start(mesh) if mesh is not None and config.stage == "drape" else None
    return Dressed(wearer.index, wearer.name, shape, body, wearer.size, pattern, mesh, coarse)


def _held(seed: int, wearer: _Wearer, config: MakeConfig) -> BodyShape:
    """The wearer with the arms as chance holds them."""
    if not config.arms:
        return wearer.shape
    turn = rng(seed, wearer.index, Stage.ARMS).uniform(-config.arms, config.arms)
    return replace(wearer.shape, arm_angle=math.radians(turn))


def _drape(load: Sequence[DressedDesign], config: MakeConfig) -> Iterator[tuple[Drape | None, ...]]:
    """The drapes of each design's wearers, all draped together; none at an earlier stage."""
    if config.stage != "drape":
        return iter([(None,) * len(design.dressed) for design in load])
    from gcd_dataset.generator.drape import DrapeJob, drape_batch, fabric_named

    everyone = chain.from_iterable(design.dressed for design in load)
    fabric = fabric_named(config.fabric)
    jobs = [
        DrapeJob(worn.box_mesh, worn.body, worn.size, fabric, worn.coarse)
        for worn in everyone
        if worn.box_mesh is not None
    ]
    drapes = iter(drape_batch(jobs, device=config.device))
    return (tuple(islice(drapes, len(design.dressed))) for design in load)


def _fabric(name: str) -> NamedFabric:
    """A fabric as samples hold it."""
    from gcd_dataset.generator.drape import fabric_named

    parameters = asdict(fabric_named(name)).items()
    return NamedFabric(name, {key: list(value) if isinstance(value, tuple) else value for key, value in parameters})


def turned_down(design: DressedDesign, drapes: Sequence[Drape | None], config: MakeConfig) -> DressedDesign | None:
    """The design with the reason why the next is tried instead, if one of its drapes asks for that."""
    failed = next((drape.outcome for drape in drapes if drape and drape.outcome is not Outcome.SETTLED), None)
    last = len(design.rejects) + 1 >= config.max_attempts
    if failed is None or config.on_fail == "keep" or last:
        return None
    return replace(design, rejects=design.rejects + (f"drape: {failed.name.lower()}",))


def _finished(
    design: DressedDesign, drapes: Sequence[Drape | None], config: MakeConfig, pictured: bool, index: int
) -> Sample:
    place = index % config.wearers
    return finish(design, design.dressed[place], config, drapes[place], pictured=pictured)


def finish(
    design: DressedDesign,
    dressed: Dressed,
    config: MakeConfig,
    drape: Drape | None,
    pictures: tuple[bytes, bytes] | None = None,
    pictured: bool = True,
) -> Sample:
    """The sample of a dressed body: points are taken, and ``pictures`` too where none are given and they are wanted."""
    mesh, points = dressed.box_mesh, None
    if mesh is not None:
        surface = drape.vertices if drape is not None else mesh.vertices
        points = sample_surface(surface, mesh.faces, config.points, rng(design.seed, dressed.index, Stage.POINTS))
    sample = Sample(
        key=sample_key(dressed.index),
        provenance=Provenance(
            seed=design.seed,
            index=dressed.index,
            attempts=len(design.rejects) + 1,
            rejects=design.rejects,
            versions=versions(),
            recipe=recipe_of(config),
            body_name=dressed.body_name,
        ),
        pattern=dressed.pattern,
        measurements=dressed.size,
        design=design_to_dict(design.design),
        shape=dressed.shape,
        box_mesh=mesh,
        drape=drape,
        points=points,
        fabric=None if drape is None else _fabric(config.fabric),
    )
    if drape is None or not (config.picture and pictured):
        return sample
    if pictures is None:
        from gcd_dataset.generator.render import render_sample

        pictures = render_sample(sample, dressed.body, size=config.picture, device=config.device)
    return replace(sample, front=pictures[0], back=pictures[1])
