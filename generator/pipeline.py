"""The steps of a sample: body, measures, design, pattern, box mesh, drape jobs, then points and pictures.

A sample depends on ``(seed, index)`` and the recipe alone: not on batch, order or process.
``gcd_dataset.generator.maker.produce`` runs the steps.
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from gcd_dataset.captions import caption_text, outfit_captions
from gcd_dataset.errors import BodyError, ConfigError, DrapeError, MeshError, PatternError, shown
from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.generator.body.motion import GAITS
from gcd_dataset.generator.body.shape import draw_from
from gcd_dataset.generator.body.sizes import SizeChart
from gcd_dataset.generator.captions import captions
from gcd_dataset.generator.drawing import jpeg_bytes
from gcd_dataset.generator.ease import ease_of
from gcd_dataset.generator.garments import (
    TAGS,
    GarmentDesign,
    Reject,
    attempted_design,
    design_to_dict,
    garment_tags,
    try_on,
)
from gcd_dataset.generator.garments.overlay import NO_OVERLAY
from gcd_dataset.generator.mesh import CoarseMesh, build_box_mesh, coarse_start
from gcd_dataset.generator.outfits import WornDesign, order_fault, worn_open, worn_outfit
from gcd_dataset.generator.quality import grade_of, grade_of_outfit, sample_surface, strain_of
from gcd_dataset.generator.recipe import MakeConfig, recipe_of, versions
from gcd_dataset.generator.sized import Cut, draw_cut, lifted, size_or_none, undraped
from gcd_dataset.generator.views import MISSING_VIEW, ViewRequest, picture_seed, stored_body
from gcd_dataset.records import (
    MISFITS,
    Body,
    BodyShape,
    BoxMesh,
    Drape,
    Ease,
    Fit,
    FitLabel,
    Maps,
    Measurements,
    NamedFabric,
    Outcome,
    Pattern,
    Pose,
    Provenance,
    Rejected,
    Sample,
    StoredView,
    WornGarment,
)
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.shards.layout import key_of
from gcd_dataset.shards.motion import NO_FRAMES

if TYPE_CHECKING:
    from gcd_dataset.generator.drape import DrapeJob, Fabric
    from gcd_dataset.generator.drapers import DrapeReply
    from gcd_dataset.generator.dressing.worn import WornCloth

NO_REDRAWS: Mapping[str, int] = MappingProxyType({})
MOST_BODIES = 1000  # bodies drawn for one with a size in the chart; 97 in 100 have one in those of this package
BODIES = 32  # bodies kept, 0.8 MB each: a design is dressed again after a rejected drape, for the same wearers


def build_pattern(size: Measurements, design: GarmentDesign, *, name: str = "garment") -> Pattern:
    """The pattern of a design for a wearer. Raises ``PatternError`` if it cannot be drawn or a rule rejects it."""
    pattern = try_on(size, design, name=name)
    if isinstance(pattern, Reject):
        raise PatternError(str(pattern))
    return pattern


def fit(design: GarmentDesign, sizes: Iterable[Measurements]) -> tuple[Pattern, ...]:
    """The patterns of one design for many wearers, one for each entry of ``sizes``.

    Raises ``PatternError`` with the number of the first wearer for whom it cannot be drawn or a rule rejects it.
    """
    patterns = []
    for number, size in enumerate(sizes):
        try:
            patterns.append(build_pattern(size, design, name=f"wearer_{number}"))
        except PatternError as error:
            raise PatternError(f"wearer {number}: {error}: change the design, or leave this wearer out") from error
    return tuple(patterns)


def grade(design: GarmentDesign, chart: SizeChart, *, name: str = "garment") -> dict[str, Pattern | Reject]:
    """Each size of a chart, to the pattern of a design for its body, or to the reason why a rule rejects it.

    Raises ``BodyError`` with chart and size for measures that no body has.
    """
    graded = dict[str, Pattern | Reject]()
    for size, body in chart.bodies.items():
        try:
            graded[size] = try_on(body, design, name=name)
        except BodyError as error:
            raise BodyError(f"{chart.source}: size {shown(size)}: {error}") from error
    return graded


@dataclass(frozen=True)
class DressedWearer:
    """One wearer of a design, with pattern and meshes: ready to drape."""

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
    cut_for: Measurements
    """The measures for which the pattern is drawn: its own, or those of a size."""
    fit: Fit | None
    under: tuple["WornCloth", ...] = ()
    """The draped garments under this one."""
    unsettled: str = ""
    """Why the garment under this one has no drape to put it on."""
    pose: Pose | None = None
    """The pose to which ``body`` moves under the garment; ``None``: it stays."""
    motion: tuple[Pose, ...] = ()
    """The poses through which it moves then, from ``pose``; none: it stays."""

    @property
    def obstacle(self) -> FitLabel | None:
        """Why the garment cannot be put on, and is not draped; ``None`` if it can."""
        return self.fit.obstacle if self.fit else None

    @property
    def worn_shape(self) -> BodyShape:
        """The body in the pose of the drape."""
        return replace(self.shape, pose=self.pose)

    @property
    def is_draped(self) -> bool:
        """Whether the garment can be put on."""
        return self.box_mesh is not None and not self.obstacle and not self.unsettled


@dataclass(frozen=True)
class DressedDesign:
    """A design accepted for all its wearers, with the rejected attempts before it in ``rejects``."""

    seed: int
    number: int
    rejects: tuple[Rejected, ...]
    redraws: Mapping[str, int]
    """Rule to the number of parameter redraws, summed over all attempts."""
    design: GarmentDesign
    dressed: tuple[DressedWearer, ...]
    outfit: tuple[WornDesign, ...] = (WornDesign(NO_OVERLAY),)
    """The garments of its outfit; this is the one after ``under``."""
    under: tuple["DrapedDesign", ...] = ()

    @property
    def worn(self) -> WornDesign:
        """How this garment is worn."""
        return self.outfit[len(self.under)]

    @property
    def is_outermost(self) -> bool:
        """Whether no garment of its outfit is worn over it."""
        return len(self.under) + 1 == len(self.outfit)

    def all_redraws(self) -> Counter[str]:
        """Rule to the number of redraws: of parameters within all attempts, plus of whole designs."""
        return Counter(self.redraws) + Counter(reject.rule for reject in self.rejects)


@dataclass(frozen=True)
class DrapedDesign:
    """A garment of an outfit on all its wearers."""

    design: DressedDesign
    replies: tuple["DrapeReply", ...]
    """One for each wearer; none before stage ``drape``."""


def own_number(number: int, garment: int) -> int:
    """The number by which a garment of outfit ``number``, or of sample ``number``, draws: each has its own streams.

    The innermost garment draws as a single garment does.
    """
    return number + (garment << 40)


def prepare(
    seed: int,
    number: int,
    config: MakeConfig,
    rejects: tuple[Rejected, ...] = (),
    redraws: Mapping[str, int] = NO_REDRAWS,
    under: tuple[DrapedDesign, ...] = (),
) -> DressedDesign:
    """Design ``number`` with its bodies, patterns and meshes: the first accepted attempt after ``rejects``.

    ``redraws``: rule to the number of redraws within the rejected attempts. ``under``: the garments of its outfit
    under this one, from the skin outwards. Raises ``PatternError`` once
    ``config.max_attempts`` designs were rejected.
    """
    wearers = _wearers(seed, number, config)
    sizes, counts = [wearer.cut_for for wearer in wearers], Counter(redraws)
    outfit, own = config.worn(seed, number, sizes), own_number(number, len(under))
    while len(rejects) < config.max_attempts:
        drawn, dressed = attempted_design(seed, own, len(rejects), sizes, outfit[len(under)].design), []
        counts += drawn.by_rule()
        for wearer in wearers:
            result = _dress(seed, wearer, drawn.design, config, outfit, under)
            if isinstance(result, Reject):
                rejects += (Rejected(wearer.index, result.rule, result.figures, result.numbers),)
                break
            dressed.append(result)
        else:
            return DressedDesign(seed, number, rejects, counts, drawn.design, tuple(dressed), outfit, under)
    raise PatternError(
        f"sample {number * config.wearers} of seed {seed}: {len(rejects)} designs were rejected, the last for: "
        f"{rejects[-1]}: raise max_attempts"
    )


@dataclass(frozen=True)
class _Wearer:
    index: int
    name: str
    shape: BodyShape
    body: Body
    size: Measurements
    cut: Cut | None = None
    """The size for which the garment is cut; ``None``: for the wearer."""

    @property
    def cut_for(self) -> Measurements:
        """The measures for which the garment is drawn."""
        return self.cut.measures if self.cut else self.size


def _wearers(seed: int, number: int, config: MakeConfig) -> tuple[_Wearer, ...]:
    """The bodies of a design, in the order of their indices.

    Raises ``ConfigError`` if the neutral body, or each of ``MOST_BODIES``, has no size in ``config.sizes``.
    """
    shapes = {}
    if config.bodies in ("neutral", "both"):
        shapes["neutral"] = neutral_shape()
    for drawn in range(config.bodies_each if config.bodies != "neutral" else 0):
        name, shape = _drawn_body(seed, number, drawn, config)
        shapes[name] = shape
    wearers = []
    for offset, (name, shape) in enumerate(shapes.items()):
        body, size = _measured_neutral() if name == "neutral" else _measured(*_numbers(shape))
        index = number * config.wearers + offset
        cut = None
        if config.chart is not None:
            own = size_or_none(config.chart, size)
            if not own:
                raise ConfigError(f"the neutral body has no size in {config.sizes}: choose other bodies, or add a size")
            cut = draw_cut(config.chart, own, config.steps, rng(seed, index, Stage.MISFIT))
        wearers.append(_Wearer(index, name, shape, body, size, cut))
    return tuple(wearers)


def _drawn_body(seed: int, number: int, drawn: int, config: MakeConfig) -> tuple[str, BodyShape]:
    """Name and shape of body ``drawn`` of a design: the first with a size in the chart, if there is one."""
    group = "random" if config.bodies == "both" else config.bodies
    for place in range(drawn, drawn + MOST_BODIES * config.bodies_each, config.bodies_each):
        kind, shape = draw_from(group, rng(seed, number, Stage.BODY, place))
        if config.chart is None or size_or_none(config.chart, _measured(*_numbers(shape))[1]):
            return f"{kind}:{seed}:{number}" + (f":{place}" if place else ""), shape
    raise ConfigError(f"no size in {config.sizes} for {MOST_BODIES} bodies = {config.bodies}: choose another chart")


def _numbers(shape: BodyShape) -> tuple[bytes, float, bool]:
    """A shape as a hashable value."""
    return shape.weights.astype(float).tobytes(), shape.arm_angle, shape.legs_apart


@lru_cache(maxsize=BODIES)
def _built(weights: bytes, arm_angle: float, legs_apart: bool) -> Body:
    return build_body(BodyShape(np.frombuffer(weights), arm_angle, legs_apart))


@lru_cache(maxsize=BODIES)
def _measured(weights: bytes, arm_angle: float, legs_apart: bool) -> tuple[Body, Measurements]:
    body = _built(weights, arm_angle, legs_apart)
    return body, measure(body)


@cache  # every design of bodies="both" is fitted to it
def _measured_neutral() -> tuple[Body, Measurements]:
    return _measured(*_numbers(neutral_shape()))


@cache  # likewise, every design with trousers
def _neutral_with_legs_apart() -> Body:
    return build_body(neutral_shape(legs_apart=True))


def _dress(
    seed: int,
    wearer: _Wearer,
    design: GarmentDesign,
    config: MakeConfig,
    outfit: tuple[WornDesign, ...],
    under: tuple[DrapedDesign, ...],
) -> DressedWearer | Reject:
    name = key_of(wearer.index) + (f"_g{len(under)}" if under else "")
    pattern = try_on(wearer.cut_for, design, name=name)
    if isinstance(pattern, Reject):
        return pattern
    row = wearer.index % config.wearers
    if reason := order_fault([inner.design.dressed[row].pattern for inner in under], pattern, wearer.size):
        return Reject("cannot_be_worn_over", reason)
    pattern = pattern if outfit[len(under)].closed else worn_open(pattern)
    shape = wearer.shape
    if config.arms:
        turn = rng(seed, wearer.index, Stage.ARMS).uniform(-config.arms, config.arms)
        shape = replace(shape, arm_angle=math.radians(turn))
    has_legs = bool(design.meta.bottom and design.meta.bottom.garment.legs)
    if any(worn.may_have_legs for worn in outfit) if len(outfit) > 1 else has_legs:
        # measures: legs together; drape: legs apart, for all garments of an outfit
        shape = replace(shape, legs_apart=True)
    if shape is wearer.shape:
        body = wearer.body
    else:
        body = _neutral_with_legs_apart() if wearer.name == "neutral" and not config.arms else _built(*_numbers(shape))
    fit = wearer.cut.fit(pattern, design, wearer.size) if wearer.cut else None
    try:
        if fit:
            from gcd_dataset.generator.dressing import dress

            at_height = lifted(pattern, design, cut_for=wearer.cut_for, wearer=wearer.size)
            pattern = dress(at_height, body, wearer.size).pattern
        mesh = build_box_mesh(pattern, spacing=config.resolution) if config.stage != "pattern" else None
    except PatternError as error:
        return Reject("cannot_be_placed", str(error))
    except MeshError as error:
        return Reject("cannot_be_meshed", str(error))
    dressed = DressedWearer(
        wearer.index, wearer.name, shape, body, wearer.size, pattern, mesh, None, None, wearer.cut_for, fit
    )
    if mesh is None or config.stage != "drape":
        return dressed
    from gcd_dataset.generator.dressing.sewing_start import sewing_start
    from gcd_dataset.generator.dressing.worn import WornCloth

    if config.motion:
        from gcd_dataset.generator.standing import counted, with_room

        motion = with_room(config.motion, body) if config.poses in GAITS else config.motion
        dressed = replace(dressed, pose=counted(motion[0], body), motion=motion)
    elif config.poses:
        dressed = replace(dressed, pose=_drawn_pose(rng(seed, wearer.index, Stage.POSE), body, config))
    drapes = [(inner.design.dressed[row].box_mesh, inner.replies[row].drape) for inner in under]
    if failed := [drape for _, drape in drapes if drape.outcome is not Outcome.SETTLED]:
        return replace(dressed, unsettled=f"a garment under it is {failed[0].outcome.name}")
    if not dressed.is_draped:
        return dressed
    cloths = tuple(WornCloth.of(inner, drape.vertices) for inner, drape in drapes if inner is not None)
    coarse = coarse_start(mesh)
    start = sewing_start(coarse.mesh if coarse else mesh, body, cloths)
    return replace(dressed, coarse=coarse, start=start, under=cloths)


def _drawn_pose(stream: np.random.Generator, body: Body, config: MakeConfig) -> Pose:
    """The pose of a sample, the same in all attempts."""
    from gcd_dataset.generator.standing import counted, draw_pose

    given = config.given_poses
    return counted(given[stream.integers(len(given))], body) if given else draw_pose(stream, body)


def drape_jobs(design: DressedDesign, config: MakeConfig) -> tuple["DrapeJob", ...]:
    """The drape job of each wearer that can put its garment on; none before stage ``drape``."""
    if config.stage != "drape":
        return ()
    from gcd_dataset.generator.drape import DrapeJob

    return tuple(
        DrapeJob(
            wearer.box_mesh,
            wearer.body,
            wearer.size,
            sample_fabric(design.seed, own_number(wearer.index, len(design.under)), config.fabric),
            wearer.coarse,
            wearer.start,
            # The next garment is not drawn yet; every bottom that is drawn ends at the waist.
            wearer.size.waist_level if design.worn.tucked else -math.inf,
            wearer.under,
            wearer.pose,
            under_sleeves=any(over.may_have_sleeves for over in design.outfit[len(design.under) + 1 :]),
        )
        for wearer in design.dressed
        if wearer.box_mesh is not None and wearer.is_draped
    )


def all_replies(design: DressedDesign, replies: Sequence["DrapeReply"], config: MakeConfig) -> tuple["DrapeReply", ...]:
    """The replies to ``drape_jobs``, and one with ``CANNOT_BE_PUT_ON`` for each other wearer, in their order.

    A garment over one that did not settle is ``REFUSED``. Raises ``DrapeError`` for a reply without the maps, or the
    motion, asked for.
    """
    if config.stage != "drape":
        return ()
    from gcd_dataset.generator.drapers import DrapeReply

    if config.maps and not design.under and any(reply.maps is None for reply in replies):
        raise DrapeError("the draper made no maps: reply with maps_of where DrapeRequest.maps is set, or make none")
    if config.motion and any(reply.motion is None for reply in replies):
        raise DrapeError("the draper made no motion: reply with one where DrapeRequest.motion is set, or ask for none")
    draped = iter(replies)
    return tuple(
        next(draped)
        if wearer.is_draped or wearer.box_mesh is None
        else DrapeReply(-1, undraped(wearer.box_mesh, wearer.obstacle, wearer.unsettled), None)
        for wearer in design.dressed
    )


def view_requests(design: DressedDesign, config: MakeConfig) -> tuple[ViewRequest, ...]:
    """The drawn views of each of ``drape_jobs``; none if ``config.views`` is 0, or under another garment."""
    if not config.views or not design.is_outermost:
        return ()
    seed = picture_seed(design.seed, data_seed=design.seed, recipe=recipe_of(config))
    return tuple(
        ViewRequest(seed, wearer.index, config.views, config.view_size, config.fabric, stored_body(wearer.worn_shape))
        for wearer in design.dressed
        if not wearer.obstacle and not wearer.unsettled
    )


def shown_under(design: DressedDesign) -> tuple[tuple[WornGarment, ...], ...]:
    """The garments under each of ``drape_jobs``, for its pictures."""
    return tuple(
        tuple(
            WornGarment(one.pattern, box_mesh=one.box_mesh, drape=inner.replies[row].drape)
            for inner in design.under
            for one in [inner.design.dressed[row]]
        )
        for row, wearer in enumerate(design.dressed)
        if wearer.is_draped
    )


def rejection(design: DressedDesign, drapes: Sequence[Drape], config: MakeConfig) -> Rejected | None:
    """The first failed drape, as the reason for another attempt; ``None`` if the design is kept.

    A failed drape is kept with ``on_fail="keep"`` and in the last attempt. With sizes ``MISFITS`` are no failures.
    """
    good = {Outcome.SETTLED} | (MISFITS if config.sizes else frozenset())
    kept = [design.dressed[row].unsettled for row in range(len(drapes))]  # with the garment under it
    failed = next((row for row, drape in enumerate(drapes) if drape.outcome not in good and not kept[row]), None)
    last = len(design.rejects) + 1 >= config.max_attempts
    if failed is None or config.on_fail == "keep" or last:
        return None
    drape = drapes[failed]
    names = ("frames", "self_crossings", "body_crossings", "body_through", "stretch_median", "stretch_p99")
    # The stretch of a diverged drape is NaN, which JSON lacks.
    figures = {name: value for name in names if math.isfinite(value := getattr(drape, name))}
    return Rejected(design.dressed[failed].index, "drape", drape.outcome.name.lower(), figures)


def finish(design: DressedDesign, index: int, config: MakeConfig, reply: "DrapeReply | None") -> Sample:
    """The sample of one wearer: samples points and encodes pictures. ``reply``: ``None`` before stage ``drape``.

    ``design``: the outermost garment of an outfit, whose garment 0 has the points, maps and ease.
    """
    row = index % config.wearers
    all_worn = (*design.under, DrapedDesign(design, () if reply is None else (reply,) * config.wearers))
    garments = tuple(_worn(one, row, config) for one in all_worn)
    first, outermost, dressed = garments[0], design.dressed[row], all_worn[0].design.dressed[row]
    mesh, drape, points = first.box_mesh, first.drape, None
    if mesh is not None:
        vertices = mesh.vertices if drape is None else drape.vertices
        points = sample_surface(vertices, mesh.faces, config.points, rng(design.seed, index, Stage.POINTS))
    views: tuple[StoredView, ...] = ()
    if reply is not None:
        views = tuple(StoredView(jpeg_bytes(view.rgb), view.facts) for view in reply.views)
        if not views and not (outermost.is_draped and np.isfinite(reply.drape.vertices).all()):
            views = config.views * (MISSING_VIEW,)  # every sample has the same members
    motion, maps, ease = None, None, dict[str, Ease]()
    if config.motion and drape is not None:
        assert reply is not None
        motion = reply.motion or replace(NO_FRAMES, asked=len(config.motion), ended=drape.outcome)
    if config.maps and drape is not None:
        maps = all_worn[0].replies[row].maps or Maps.unknown(len(drape.vertices))
    if config.ease and mesh is not None:
        worn = None if drape is None or dressed.obstacle or dressed.pose else drape.vertices
        ease = ease_of(dressed.pattern, mesh, dressed.body, dressed.size, worn)
    front, back = (None, None) if reply is None or reply.pictures is None else map(jpeg_bytes, reply.pictures)
    rejects = tuple(reject for one in all_worn for reject in one.design.rejects)
    redraws = sum((one.design.all_redraws() for one in all_worn), Counter[str]())
    tags = {tag for one in all_worn for tag in _tags(one.design, row)}
    outfit = worn_outfit(garments, dressed.body) if len(garments) > 1 else None
    grade = None if drape is None else grade_of_outfit(outfit) if outfit else grade_of(drape, drape.strain)
    return Sample(
        key=key_of(index),
        provenance=Provenance(
            seed=design.seed,
            index=index,
            attempts=len(rejects) + 1,
            rejects=tuple(map(str, rejects)),
            redraws=dict(sorted(redraws.items())),
            turned_down=rejects,
            versions=versions(),
            recipe=recipe_of(config),
            body_name=dressed.body_name,
        ),
        pattern=dressed.pattern,
        measurements=dressed.size,
        design=first.design,
        shape=dressed.worn_shape,
        box_mesh=mesh,
        drape=drape,
        maps=maps,
        motion=motion,
        points=points,
        front=front,
        back=back,
        views=views,
        gathers=dressed.pattern.gather_ratios(),
        ease=ease,
        tags=tuple(tag for tag in TAGS if tag in tags),
        fabric=first.fabric,
        grade=grade,
        caption=_caption(all_worn, row) if config.captions else None,
        fit=dressed.fit,
        outfit=outfit,
    )


def _worn(draped: DrapedDesign, row: int, config: MakeConfig) -> WornGarment:
    """The garment on wearer ``row``."""
    design, drape, fabric = draped.design, None, None
    dressed, how = design.dressed[row], design.worn
    if draped.replies and dressed.box_mesh is not None:
        drape = draped.replies[row].drape
        strain = strain_of(dressed.box_mesh, drape.vertices) if dressed.is_draped else None
        drape = replace(drape, strain=strain)
        fabric = _fabric_record(design.seed, own_number(dressed.index, len(design.under)), config.fabric)
    values = design_to_dict(design.design)
    return WornGarment(dressed.pattern, values, dressed.box_mesh, drape, fabric, how.tucked, how.closed)


def _tags(design: DressedDesign, row: int) -> tuple[str, ...]:
    dressed = design.dressed[row]
    return garment_tags(dressed.cut_for, design.design, dressed.pattern)


def _caption(worn: Sequence[DrapedDesign], row: int) -> str:
    """The captions of all levels as the member ``caption.txt``."""
    designs, said = [one.design for one in worn], []
    for number, design in enumerate(designs):
        dressed = design.dressed[row]
        own = own_number(dressed.index, number)
        said.append(captions(dressed.cut_for, design.design, dressed.pattern, seed=design.seed, index=own))
    if len(said) == 1:
        return caption_text(said[0])
    how = [design.worn for design in designs]
    return caption_text(outfit_captions(said, tucked=[w.tucked for w in how], closed=[w.closed for w in how]))


def sample_fabric(seed: int, index: int, name: str) -> "Fabric":
    """The fabric of a sample: the fabric called ``name``; for ``random`` a fabric drawn by seed and index.

    All attempts at an index have the same fabric: otherwise fabrics that drape badly would become rare.
    """
    from gcd_dataset.generator.drape import RANDOM_FABRIC, draw_fabric, fabric_named

    return draw_fabric(rng(seed, index, Stage.FABRIC)) if name == RANDOM_FABRIC else fabric_named(name)


def _fabric_record(seed: int, index: int, name: str) -> NamedFabric:
    """The fabric with its parameters, for the sample's record."""
    parameters = asdict(sample_fabric(seed, index, name)).items()
    return NamedFabric(name, {key: list(value) if isinstance(value, tuple) else value for key, value in parameters})
