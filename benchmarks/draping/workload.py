"""The garments of a draping benchmark: sampled designs on the neutral body and on random ones."""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context

from gcd_dataset.generator.drape import DrapeJob
from gcd_dataset.generator.garments.design import OutfitDesign
from gcd_dataset.generator.pipeline import prepare
from gcd_dataset.generator.recipe import MakeConfig

__all__ = ["Worn", "kind_of", "sampled"]


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


def kind_of(design: OutfitDesign) -> dict[str, str]:
    """The fields ``upper``, ``wb`` and ``bottom`` of ``Worn``: names of a design's parts, empty for none."""
    parts = {"upper": design.meta.upper, "wb": design.meta.wb, "bottom": design.meta.bottom}
    return {name: part.value if part else "" for name, part in parts.items()}
