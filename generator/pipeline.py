"""The whole way of a sample on one page: body, measures, design, pattern, box mesh, drape, points, pictures.

A sample is named by ``(seed, index)`` and comes out the same alone, in a batch, in any order and in any process.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from gcd_dataset import __version__
from gcd_dataset.errors import ConfigError, MeshError, PatternError
from gcd_dataset.generator.body import build_body, draw_shape, measure, neutral_shape
from gcd_dataset.generator.garments import OutfitDesign, check_outfit, design_to_dict, outfit, sample_design
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.generator.points import sample_surface
from gcd_dataset.records import Body, BodyShape, BoxMesh, Drape, Measurements, Outcome, Pattern, Provenance, Sample
from gcd_dataset.seeding import Stage, rng

__all__ = ["MakeConfig", "build_pattern", "device_kind", "make", "make_many", "recipe_of", "sample_key"]

Bodies = Literal["neutral", "random", "both"]
LastStage = Literal["pattern", "mesh", "drape"]
BATCH = {"cpu": 1, "cuda": 32}  # garments draped at a time


def _one_of(name: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise ConfigError(f"{name} is {value!r}: known are {', '.join(known)}")


@dataclass(frozen=True, slots=True)
class MakeConfig:
    """What samples are made of, beside their seed and index."""

    bodies: Bodies = "random"
    """``both``: samples 2i and 2i+1 are one design on the neutral body and on a random one."""
    stage: LastStage = "drape"
    """The last step taken."""
    resolution: float = 1.0
    """Length of the mesh's edges [cm]."""
    device: str = "auto"
    """Where cloth is draped and pictures are taken: ``auto``, ``cpu`` or ``cuda:0``."""
    on_fail: Literal["retry", "keep"] = "retry"
    """A drape that does not settle: the next design instead, or the sample as it is, with its outcome. With ``both`` it
    is kept, since the other body wears the same design."""
    points: int = 8192
    """Surface points of a sample."""
    picture: int = 512
    """Side of the pictures [pixels]; 0 for none."""
    max_attempts: int = 30
    """Designs tried for one index before it is given up."""

    def __post_init__(self) -> None:
        _one_of("bodies", self.bodies, ("neutral", "random", "both"))
        _one_of("stage", self.stage, ("pattern", "mesh", "drape"))
        _one_of("on_fail", self.on_fail, ("retry", "keep"))
        if not 0.2 <= self.resolution <= 10.0:
            raise ConfigError(f"resolution is {self.resolution} cm: give a length from 0.2 to 10")
        for name in ("points", "picture"):
            if getattr(self, name) < 0:
                raise ConfigError(f"{name} is {getattr(self, name)}: give 0 or more")


DEFAULT = MakeConfig()


def make(seed: int, index: int, config: MakeConfig = DEFAULT) -> Sample:
    """Sample ``index`` of ``seed``. Raises ``PatternError`` where ``config.max_attempts`` designs were turned down."""
    return next(make_many(seed, [index], config))


def make_many(
    seed: int, indices: Iterable[int], config: MakeConfig = DEFAULT, *, batch: int | None = None
) -> Iterator[Sample]:
    """The samples of ``indices``, in order; up to ``batch`` garments are draped at a time (1 on a CPU, 32 on a GPU)."""
    if config.stage != "drape":
        yield from (_finish(prepare(seed, index, config), config) for index in indices)
        return
    size = batch or BATCH[device_kind(config)]
    waiting = deque(indices)
    order = deque(waiting)
    again: deque[_Dressed] = deque()
    done: dict[int, Sample] = {}
    while order:
        load = [prepare(seed, failed.index, config, failed) for failed in again]
        again.clear()
        while waiting and len(load) < size:
            load.append(prepare(seed, waiting.popleft(), config))
        for dressed, drape in zip(load, _drape(load, config), strict=True):
            if drape.outcome is not Outcome.SETTLED and config.on_fail == "retry" and config.bodies != "both":
                again.append(dressed.turned_down(f"drape: {drape.outcome.name.lower()}"))
            else:
                done[dressed.index] = _finish(dressed, config, drape)
        while order and order[0] in done:
            yield done.pop(order.popleft())


def build_pattern(size: Measurements, design: OutfitDesign) -> Pattern:
    """The pattern of a design for a wearer. Raises ``PatternError`` where it cannot be drawn or worn."""
    pattern = outfit(size, design)
    rejects = check_outfit(size, design, pattern)
    if rejects:
        raise PatternError(str(rejects[0]))
    return pattern


def recipe_of(config: MakeConfig) -> dict[str, Any]:
    """Everything but seed and index that decides what a sample holds, as plain values."""
    recipe = asdict(config)
    recipe["device"] = device_kind(config) if config.stage == "drape" else "cpu"
    return recipe


def sample_key(index: int) -> str:
    """The name of a sample in a shard.

    >>> sample_key(12)
    'gcd_000000012'
    """
    return f"gcd_{index:09d}"


# --------------------------------------------------------------------------------------------------------------- steps


@dataclass(frozen=True)
class _Dressed:
    """A garment ready to be draped, and how it was come by."""

    seed: int
    index: int
    attempts: int
    rejects: tuple[str, ...]
    shape: BodyShape
    body_name: str
    body: Body
    size: Measurements
    design: OutfitDesign
    pattern: Pattern
    box_mesh: BoxMesh | None

    def turned_down(self, reason: str) -> "_Dressed":
        return replace(self, rejects=self.rejects + (reason,))


def prepare(seed: int, index: int, config: MakeConfig, failed: _Dressed | None = None) -> _Dressed:
    """The first design that can be worn, after ``failed`` if there is one, with its body and pattern."""
    number = index // 2 if config.bodies == "both" else index
    random = draw_shape(rng(seed, number, Stage.BODY))
    neutral = neutral_shape()
    on_neutral = config.bodies == "neutral" or (config.bodies == "both" and index % 2 == 0)
    wearers = {"neutral": (neutral,), "random": (random,), "both": (neutral, random)}[config.bodies]
    sizes = [measure(build_body(shape)) for shape in wearers]
    worn = 0 if on_neutral or len(wearers) == 1 else 1
    rejects = failed.rejects if failed else ()
    while len(rejects) < config.max_attempts:
        design = sample_design(rng(seed, number, Stage.DESIGN, len(rejects)))
        try:
            patterns = [build_pattern(size, design) for size in sizes]
            pattern = replace(patterns[worn], name=sample_key(index))
            box_mesh = build_box_mesh(pattern, spacing=config.resolution) if config.stage != "pattern" else None
        except (PatternError, MeshError) as error:
            rejects += (str(error),)
        else:
            return _Dressed(
                seed=seed,
                index=index,
                attempts=len(rejects) + 1,
                rejects=rejects,
                shape=wearers[worn],
                body_name="neutral" if on_neutral else f"random:{seed}:{number}",
                body=build_body(wearers[worn]),
                size=sizes[worn],
                design=design,
                pattern=pattern,
                box_mesh=box_mesh,
            )
    raise PatternError(
        f"sample {index} of seed {seed}: {len(rejects)} designs were turned down, the last for: {rejects[-1]}: "
        "allow more attempts, or keep drapes that do not settle"
    )


def _drape(load: list[_Dressed], config: MakeConfig) -> list[Drape]:
    from gcd_dataset.generator.drape import DrapeJob, drape_batch

    jobs = [DrapeJob(dressed.box_mesh, dressed.body, dressed.size) for dressed in load if dressed.box_mesh]
    return drape_batch(jobs, device=config.device)


def _finish(dressed: _Dressed, config: MakeConfig, drape: Drape | None = None) -> Sample:
    """The sample of a dressed body: points and pictures are taken, and all is put together."""
    mesh, points = dressed.box_mesh, None
    if mesh is not None:
        surface = drape.vertices if drape is not None else mesh.vertices
        points = sample_surface(surface, mesh.faces, config.points, rng(dressed.seed, dressed.index, Stage.POINTS))
    sample = Sample(
        key=sample_key(dressed.index),
        provenance=_provenance(dressed, config),
        pattern=dressed.pattern,
        measurements=dressed.size,
        design=design_to_dict(dressed.design),
        shape=dressed.shape,
        box_mesh=mesh,
        drape=drape,
        points=points,
    )
    if drape is None or not config.picture:
        return sample
    from gcd_dataset.generator.render import render_sample

    front, back = render_sample(sample, dressed.body, size=config.picture, device=config.device)
    return replace(sample, front=front, back=back)


def _provenance(dressed: _Dressed, config: MakeConfig) -> Provenance:
    return Provenance(
        seed=dressed.seed,
        index=dressed.index,
        attempts=dressed.attempts,
        rejects=dressed.rejects,
        versions={"gcd_dataset": __version__, "numpy": np.__version__},
        recipe=recipe_of(config),
        body_name=dressed.body_name,
    )


def device_kind(config: MakeConfig) -> str:
    """``cpu`` or ``cuda``. Raises ``DrapeError`` for a device that is not there."""
    from gcd_dataset.generator.drape import resolve_device

    return "cuda" if resolve_device(config.device).startswith("cuda") else "cpu"
