"""The garments of a draping benchmark: designs of our sampler, or drawn like GarmentCode's, with their wearers."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count

import numpy as np

from benchmarks.cases import Figure
from gcd_dataset.errors import PatternError
from gcd_dataset.faults import Rule, check_pattern
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob
from gcd_dataset.generator.dressing import dress, has_legs
from gcd_dataset.generator.dressing.sewing_start import sewing_start
from gcd_dataset.generator.garments import draw_garment
from gcd_dataset.generator.garments.design import GarmentDesign
from gcd_dataset.generator.garments.rules import LIGHT_LENGTH, LIGHT_SUNS, garment_length, is_flared, is_gathered
from gcd_dataset.generator.garments.space import DesignSpace, draw
from gcd_dataset.generator.garments.wardrobe import Bottom
from gcd_dataset.generator.mesh import build_box_mesh, coarse_start
from gcd_dataset.generator.pipeline import prepare
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.records import Body, Drape, Measurements, Outcome
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.workers import parallel_map

Wearer = tuple[Body, Measurements]


@dataclass(frozen=True)
class Worn:
    """A sampled garment with its wearer."""

    index: int
    """Index of the sample; 2i and 2i + 1 are one design on two bodies."""
    body_name: str
    upper: str
    wb: str
    bottom: str
    job: DrapeJob


def sampled(seed: int, designs: int, *, resolution: float, workers: int = 1) -> list[Worn]:
    """Sample ``designs`` designs, each meshed at ``resolution`` [cm] for two wearers, in ``workers`` processes."""
    config = MakeConfig(bodies="both", resolution=resolution, device="cpu")
    made = parallel_map(partial(_dressed, seed, config), range(designs), workers)
    return [worn for design in made for worn in design]


def reference_sampled(
    seed: int, designs: int, wearer: Wearer, wearer_apart: Wearer, *, resolution: float, workers: int = 1
) -> list[Worn]:
    """Designs drawn like GarmentCode's for one body, its faults left in, treated as patterns of foreign origin.

    ``wearer_apart``: the same body with its legs apart, for trousers.
    """
    return list(parallel_map(partial(_reference_worn, seed, wearer, wearer_apart, resolution), range(designs), workers))


def _reference_worn(seed: int, wearer: Wearer, wearer_apart: Wearer, resolution: float, number: int) -> Worn:
    size = wearer[1]
    drawn = (reference_design(rng(seed, number, Stage.DESIGN, attempt)) for attempt in count())
    design = next(design for design in drawn if not reject_reason(design, [size]))
    pattern = draw_garment(size, design, mends=frozenset())
    body, size = wearer_apart if has_legs(pattern) else wearer
    mesh = build_box_mesh(dress(pattern, body, size).pattern, spacing=resolution)
    coarse = coarse_start(mesh)
    start = sewing_start(coarse.mesh if coarse else mesh, body)
    return Worn(number, "given", **kind_of(design), job=DrapeJob(mesh, body, size, coarse=coarse, start=start))


def _dressed(seed: int, config: MakeConfig, number: int) -> list[Worn]:
    design = prepare(seed, number, config)
    return [
        Worn(
            worn.index,
            worn.body_name,
            **kind_of(design.design),
            job=DrapeJob(worn.box_mesh, worn.body, worn.size, coarse=worn.coarse, start=worn.start),
        )
        for worn in design.dressed
        if worn.box_mesh is not None
    ]


def kind_of(design: GarmentDesign) -> dict[str, str]:
    """The fields ``upper``, ``wb`` and ``bottom`` of ``Worn``: names of a design's parts, empty for none."""
    parts = {"upper": design.meta.upper, "wb": design.meta.wb, "bottom": design.meta.bottom}
    return {name: part.value if part else "" for name, part in parts.items()}


SHARES = (50, 80, 95, 99)
LIMITS = DrapeConfig()


def quality(drapes: Sequence[Drape]) -> list[Figure]:
    """Pass rates, and percentiles of crossing edges: cloth through cloth, cloth through body, and body through cloth.

    ``clean``: the share with ``Outcome.SETTLED`` and no crossing edge of any kind; ``passed``: the share with
    ``Outcome.SETTLED``; ``passed_paper``: the share that passes the checks of Korosteleva et al. (ECCV 2024) alone.
    """
    crossings = {
        "self": [d.self_crossings for d in drapes],
        "body": [d.body_crossings for d in drapes],
        "through": [d.body_through for d in drapes],
    }
    return [
        Figure("clean", float(np.mean([is_clean(d) for d in drapes])), "share"),
        Figure("passed", float(np.mean([d.outcome is Outcome.SETTLED for d in drapes])), "share"),
        Figure("passed_paper", float(np.mean([pass_paper(d) for d in drapes])), "share"),
        *(
            Figure(f"{kind}_p{share}", float(np.percentile(counts, share)), "edges")
            for kind, counts in crossings.items()
            for share in SHARES
        ),
    ]


def is_clean(drape: Drape) -> bool:
    """Whether the drape settled and no edge crosses: cloth through cloth, cloth through body, or body through cloth."""
    return drape.outcome is Outcome.SETTLED and drape.self_crossings + drape.body_crossings + drape.body_through == 0


def pass_paper(drape: Drape) -> bool:
    """Whether the drape rests with few enough crossings, regardless of stretch.

    Stretch is the last check of an ``Outcome``: an overstretched drape has passed the others. A garment that slid off
    does not count as at rest, since its drape is stopped early. The paper's check counts edges of the cloth only.
    """
    if drape.outcome is Outcome.THROUGH_BODY and drape.body_through > 0:
        return drape.body_crossings <= LIMITS.max_body_crossings and drape.self_crossings <= LIMITS.max_self_crossings
    return drape.outcome in (Outcome.SETTLED, Outcome.OVERSTRETCHED)


# ---------------------------------------------------------------------------------------------------- reference sampler


SPACE = DesignSpace.declared(GarmentDesign)
FLOOR_SLACK = 1.0  # cm by which a garment may be longer than from the neck to the floor
THIN_BAND = 0.25


def reference_design(rng: np.random.Generator) -> GarmentDesign:
    """A design drawn like GarmentCode's, before any test."""
    return draw(SPACE, rng)


def reject_reason(design: GarmentDesign, sizes: Sequence[Measurements]) -> str:
    """The first test of GarmentCode's sampler that a design fails; empty if it is accepted."""
    if design.meta.upper is None and design.meta.bottom is None:
        return "empty"
    if _slides(design):
        return "ruffles on a loose belt"
    if _is_heavy(design):
        return "heavy flare"
    return next((reason for size in sizes if (reason := _unfit(design, size))), "")


def _slides(design: GarmentDesign) -> bool:
    loose = design.meta.wb is None or design.waistband.waist > 1
    return design.meta.upper is None and is_gathered(design) and design.skirt.ruffle > 1 and loose


def _is_heavy(design: GarmentDesign) -> bool:
    band = design.waistband
    thin = design.meta.wb is None or band.waist > 1 or band.width <= THIN_BAND
    levels = design.meta.bottom is Bottom.LEVELS
    length = design.levels_skirt.length if levels else design.flare_skirt.length
    heavy = length > LIGHT_LENGTH or design.flare_skirt.suns > LIGHT_SUNS
    return design.meta.upper is None and is_flared(design) and thin and heavy


def _unfit(design: GarmentDesign, size: Measurements) -> str:
    if garment_length(size, design, frozenset()) > size.height - size.head_l + FLOOR_SLACK:
        return "too long"
    try:
        faults = check_pattern(draw_garment(size, design, mends=frozenset()))
    except PatternError:
        return "cannot be drawn"
    return "crosses itself" if any(fault.rule is Rule.SELF_CROSSING for fault in faults) else ""
