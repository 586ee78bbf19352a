"""Ablation: the same garments draped with each feature switched in turn."""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from benchmarks.cases.figures import Figure, Measured
from benchmarks.draping.quality import quality
from benchmarks.draping.workload import Worn
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob, drape_batch
from gcd_dataset.records import Drape

PULLS = ("pull_to_parts", "pull_from_body")


@dataclass(frozen=True)
class Variant:
    """A configuration of the drape."""

    name: str
    switched: Mapping[str, bool | int]
    """Options of ``DrapeConfig`` that differ from the default."""
    layers_rub: bool = True
    by_body: bool = False
    """Whether the table also has separate rows for neutral and random bodies."""

    def config(self) -> DrapeConfig:
        return DrapeConfig(**self.switched)  # type: ignore[arg-type]  # names and types of its fields

    def job(self, job: DrapeJob) -> DrapeJob:
        return job if self.layers_rub else replace(job, fabric=replace(job.fabric, layer_friction=0.0))


def variants() -> list[Variant]:
    """The full system; without ``PULLS``, as in Korosteleva et al. (ECCV 2024); then with each feature switched."""
    switches = {entry.name: entry.default for entry in fields(DrapeConfig) if isinstance(entry.default, bool)}
    return [
        Variant("full", {}, by_body=True),
        Variant("without both pulls", dict.fromkeys(PULLS, False), by_body=True),
        *(Variant(f"{'without' if on else 'with'} {name}", {name: not on}) for name, on in switches.items()),
        Variant("without untangling_steps", {"untangling_steps": 0}),
        Variant("with one drape each", {"most_drapes": 1}),
        Variant("without layer_friction", {}, layers_rub=False),
    ]


def measure_ablation(worn: Sequence[Worn], *, device: str, batch: int) -> Measured:
    """Drape the garments in every variant. Rows: one per variant; figures: those of the full system."""
    rows: list[dict[str, Any]] = []
    figures: list[Figure] = []
    for variant in variants():
        start = time.perf_counter()
        drapes = drape_batch([variant.job(one.job) for one in worn], variant.config(), device=device, at_once=batch)
        each = (time.perf_counter() - start) / len(worn)
        figures = figures or [Figure("garments", len(worn), ""), Figure("s_per_garment", each, "s"), *quality(drapes)]
        rows += _rows(variant, worn, drapes, each)
    return Measured(figures, rows)


def _rows(variant: Variant, worn: Sequence[Worn], drapes: Sequence[Drape], each: float) -> Iterator[dict[str, Any]]:
    """A variant's rows: over all bodies, and possibly by kind of body."""
    neutral = np.array([one.neutral for one in worn])
    groups = {"all": np.ones(len(worn), bool)}
    if variant.by_body:
        groups |= {"neutral": neutral, "random": ~neutral}
    for bodies, chosen in groups.items():
        some = [drape for drape, is_chosen in zip(drapes, chosen, strict=True) if is_chosen]
        yield {
            "variant": variant.name,
            "bodies": bodies,
            **{figure.metric: round(figure.value, 3) for figure in quality(some)},
            "frames_p50": float(np.median([drape.frames for drape in some])),
            "s_per_garment": each if bodies == "all" else "",
        }
