"""Patterns from specification files, or sampled designs, draped: seconds, outcomes, crossings.

    python -m benchmarks.run drape PATTERNS/*/default_body/*_specification.json \\
        --body mean_all.obj --body-apart mean_all_apart.obj --measurements mean_all.yaml --segmentation parts.json
    python -m benchmarks.run drape --count 500 --batch 256 --sheet drapes.jpg

Kernels are loaded before the clock starts; everything from box mesh to drape is counted. With ``--batch 1`` a garment's
seconds are its own, with more its share. ``--count`` takes so many designs of a seed, each on the neutral body and on
a random one; the table then holds the garments that did not settle.
"""

import argparse
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases.figures import Figure, Measured
from gcd_dataset.errors import ConfigError
from gcd_dataset.files import write_whole
from gcd_dataset.generator.body import named_body
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob, drape_batch
from gcd_dataset.generator.drawing import contact_sheet, jpeg_bytes
from gcd_dataset.generator.fitting import Fitting, fit, needs_legs_apart, read_patterns, write_fitting
from gcd_dataset.generator.garments.design import OutfitDesign
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.generator.pipeline import prepare
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.generator.render import render_garment
from gcd_dataset.records import Body, Drape, Measurements, Outcome, Pattern

__all__ = ["add_arguments", "run"]

TILE = 256  # pixels of one garment on a sheet


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the case."""
    parser.add_argument("spec", nargs="*", type=Path, help="specification JSON")
    parser.add_argument("--count", type=int, default=0, help="designs to be drawn instead, for two bodies each")
    parser.add_argument("--seed", type=int, default=0, help="of the sampled designs")
    parser.add_argument("--workers", type=int, default=1, help="processes that make patterns and meshes of those")
    parser.add_argument("--sheet", type=Path, help="picture of the first 64 sampled garments")
    parser.add_argument("--body", default="neutral", help="as of gcd drape")
    parser.add_argument("--body-apart", help="the same body with its legs apart, for trousers (default: --body)")
    parser.add_argument("--measurements", type=Path)
    parser.add_argument("--segmentation", type=Path)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--resolution", type=float, default=1.0, help="[cm]")
    parser.add_argument("--batch", type=int, default=1, help="garments draped at a time")
    parser.add_argument("--repeat", type=int, default=1, help="times each pattern is in the list, to fill a batch")
    parser.add_argument("--pictures", type=Path, help="folder for meshes and pictures")


def run(options: argparse.Namespace) -> Measured:
    """Drape, and gather the figures of DESIGN section 8."""
    if bool(options.spec) == bool(options.count):
        raise ConfigError("give either specification files or --count N")
    if options.count:
        return _run_sampled(options)
    bodies = {apart: _body(options, apart) for apart in (False, True)}

    def body_for(pattern: Pattern) -> tuple[Body, Measurements]:
        return bodies[needs_legs_apart(pattern)]

    once = read_patterns(options.spec)
    _warm_up(once[0], body_for(once[0]), options.device)
    patterns = [pattern for pattern in once for _ in range(options.repeat)]
    fitted = fit(patterns, body_for, resolution=options.resolution, device=options.device, batch=options.batch)
    fittings = []
    for fitting in fitted:
        fittings.append(fitting)
        if options.pictures:
            write_fitting(fitting, body_for(fitting.pattern)[0], options.pictures, device=options.device)
    return Measured(_figures(fittings), [fitting.row for fitting in fittings])


def _body(options: argparse.Namespace, apart: bool) -> tuple[Body, Measurements]:
    name = options.body_apart if apart and options.body_apart else options.body
    found = named_body(name, measurements=options.measurements, segmentation=options.segmentation, legs_apart=apart)
    return found[0], found[1]


def _warm_up(pattern: Pattern, wearer: tuple[Body, Measurements], device: str) -> None:
    """Compile and load what the first drape would wait for."""
    mesh = build_box_mesh(pattern, spacing=3.0)
    drape_batch([DrapeJob(mesh, *wearer)], DrapeConfig(max_frames=1), device=device)


def _figures(fittings: list[Fitting]) -> list[Figure]:
    return [
        Figure("s_per_garment", float(np.mean([f.drape_seconds for f in fittings])), "s"),
        Figure("mesh_s_per_garment", float(np.mean([f.mesh_seconds for f in fittings])), "s"),
        *_quality([fitting.drape for fitting in fittings]),
    ]


def _run_sampled(options: argparse.Namespace) -> Measured:
    config = MakeConfig(bodies="both", resolution=options.resolution, device=options.device)
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        designs = list(pool.map(partial(prepare, options.seed, config=config), range(options.count)))
    worn = [(design, dressed) for design in designs for dressed in design.dressed]
    jobs = [DrapeJob(dressed.box_mesh, dressed.body, dressed.size) for _, dressed in worn if dressed.box_mesh]
    drape_batch(jobs[:1], DrapeConfig(max_frames=1), device=options.device)
    start = time.perf_counter()
    drapes: list[Drape] = []
    for first in range(0, len(jobs), options.batch):
        drapes += drape_batch(jobs[first : first + options.batch], device=options.device)
    seconds = time.perf_counter() - start
    frames, outcomes = [drape.frames for drape in drapes], Counter(drape.outcome for drape in drapes)
    figures = [
        Figure("garments", len(jobs), ""),
        Figure("vertices_mean", float(np.mean([len(job.box_mesh.vertices) for job in jobs])), ""),
        Figure("s_per_garment", seconds / len(jobs), "s"),
        *_quality(drapes),
        Figure("stretch_p50", float(np.median([drape.stretch_median for drape in drapes])), ""),
        Figure("stretch_p99", float(np.median([drape.stretch_p99 for drape in drapes])), ""),
        *(Figure(f"frames_p{share}", float(np.percentile(frames, share)), "frames") for share in (50, 80, 95)),
        *(Figure(outcome.name.lower(), outcomes[outcome], "garments") for outcome in Outcome),
    ]
    if options.sheet:
        _write_sheet(options.sheet, list(zip(jobs, drapes, strict=True))[:64])
    failed = [
        {"index": dressed.index, "outcome": drape.outcome.name, **_kind(design.design), **_crossings(drape)}
        for (design, dressed), drape in zip(worn, drapes, strict=True)
        if drape.outcome is not Outcome.SETTLED
    ]
    return Measured(figures, failed)


def _kind(design: OutfitDesign) -> dict[str, str]:
    parts = {"upper": design.meta.upper, "wb": design.meta.wb, "bottom": design.meta.bottom}
    return {name: part.value if part else "" for name, part in parts.items()}


def _crossings(drape: Drape) -> dict[str, Any]:
    return {
        "frames": drape.frames,
        "self_crossings": drape.self_crossings,
        "body_crossings": drape.body_crossings,
        "stretch_p99": round(drape.stretch_p99, 2),
    }


def _write_sheet(path: Path, shown: Sequence[tuple[DrapeJob, Drape]]) -> None:
    """Each garment from the front, eight in a row."""
    pictures = [render_garment(drape.vertices, job.box_mesh, job.body, size=TILE)[0] for job, drape in shown]
    write_whole(path, jpeg_bytes(contact_sheet(pictures, columns=8)))


def _quality(drapes: Sequence[Drape]) -> list[Figure]:
    crossings = {"self": [d.self_crossings for d in drapes], "body": [d.body_crossings for d in drapes]}
    return [
        Figure("passed", float(np.mean([d.outcome is Outcome.SETTLED for d in drapes])), "share"),
        *(
            Figure(f"{kind}_p{share}", float(np.percentile(counts, share)), "edges")
            for kind, counts in crossings.items()
            for share in (50, 80, 95)
        ),
    ]
