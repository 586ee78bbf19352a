"""The garments of a draping benchmark: designs of our sampler, or drawn like GarmentCode's, with their wearers."""

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import count
from multiprocessing import get_context

import numpy as np

from benchmarks.cases.figures import Figure
from benchmarks.reference_sampler import reference_design, reject_reason
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob
from gcd_dataset.generator.dressing import dress, has_legs
from gcd_dataset.generator.dressing.sewing_start import sewing_start
from gcd_dataset.generator.garments import draw_garment
from gcd_dataset.generator.garments.design import GarmentDesign
from gcd_dataset.generator.mesh import build_box_mesh, coarse_start
from gcd_dataset.generator.pipeline import prepare
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.records import Body, Drape, Measurements, Outcome
from gcd_dataset.seeding import Stage, rng

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

    @property
    def neutral(self) -> bool:
        """Whether the wearer is the neutral body."""
        return self.body_name == "neutral"


def sampled(seed: int, designs: int, *, resolution: float, workers: int = 1) -> list[Worn]:
    """Sample ``designs`` designs, each meshed at ``resolution`` [cm] for two wearers, in ``workers`` processes."""
    config = MakeConfig(bodies="both", resolution=resolution, device="cpu")
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        made = pool.map(partial(_dressed, seed, config), range(designs))
        return [worn for design in made for worn in design]


def reference_sampled(
    seed: int, designs: int, wearer: Wearer, wearer_apart: Wearer, *, resolution: float, workers: int = 1
) -> list[Worn]:
    """Designs drawn like GarmentCode's for one body, its faults left in, treated as patterns of foreign origin.

    ``wearer_apart``: the same body with its legs apart, for trousers.
    """
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        wear = partial(_reference_worn, seed, wearer, wearer_apart, resolution)
        return list(pool.map(wear, range(designs)))


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
