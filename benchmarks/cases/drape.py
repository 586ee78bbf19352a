"""Drape patterns from specification files, or sampled designs: seconds, outcomes, crossings.

    python -m benchmarks.run drape PATTERNS/*/default_body/*_specification.json \\
        --body mean_all.obj --body-apart mean_all_apart.obj --measurements mean_all.yaml --segmentation parts.json
    python -m benchmarks.run drape --count 500 --batch 128 --sheet drapes.jpg --failures failed/
    python -m benchmarks.run drape dress_pencil_specification.json --body mean_all.obj --peer newton --batches 1 16 64
    python -m benchmarks.run drape --count 220 --reference-designs --batch 128 --body mean_all.obj \\
        --body-apart mean_all_apart.obj --measurements mean_all.yaml --segmentation parts.json

Kernels are loaded before the clock starts. The time is from box mesh to drape; the coarse meshes of sampled garments
are made with their box meshes and timed separately. With ``--batch 1`` a garment's seconds are its own, otherwise its
share of the batch. ``--count`` samples that many designs of a seed, each for the neutral body and a random one; the
table lists the garments that did not settle. ``clean``: the share that settled without a crossing edge of any kind;
``grade_clean``: the share that also has no panel stretched too far, see ``generator.quality``. ``--reference-designs``:
designs drawn and selected like GarmentCode's, each on the given body, see ``benchmarks.draping.workload``. ``--beside
cpu``: the distance between the drapes of two devices, a noise floor for models that predict drapes. ``--peer newton``
also drapes the same meshes with Newton's ``SolverStyle3D``, configured as described in ``benchmarks.peers.newton``.
"""

import argparse
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import CaseResult, Figure, jpeg_file
from benchmarks.draping.modes import compare_devices, gpu_peak_mb, write_failures
from benchmarks.draping.workload import Worn, quality, reference_sampled, sampled
from benchmarks.peers.compare import compare_solvers
from benchmarks.peers.newton import require_newton
from gcd_dataset.errors import ConfigError, MeshError
from gcd_dataset.files import write_whole
from gcd_dataset.generator.body import named_body
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob, drape_batch, resolve_device
from gcd_dataset.generator.drawing import contact_sheet, jpeg_bytes
from gcd_dataset.generator.dressing import has_legs
from gcd_dataset.generator.fitting import Fitting, Refusal, drape_patterns, read_patterns
from gcd_dataset.generator.mesh import build_box_mesh, coarse_start
from gcd_dataset.generator.quality import grade_of, strain_of
from gcd_dataset.generator.render import render_garment
from gcd_dataset.records import Body, Drape, Grade, Measurements, Outcome, Pattern

TILE = 256  # side of a garment's picture on a sheet [pixels]
TIMED_MESHES = 16  # number of garments that are coarsened to time the making of a coarse mesh


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("spec", nargs="*", type=Path, help="specification JSON")
    parser.add_argument("--count", type=int, default=0, help="designs to sample instead, for two bodies each")
    parser.add_argument("--seed", type=int, default=0, help="seed of the sampled designs")
    parser.add_argument("--workers", type=int, default=1, help="processes that make their patterns and meshes")
    parser.add_argument("--sheet", type=jpeg_file, help="picture of the first 64 sampled garments")
    parser.add_argument("--failures", type=Path, help="folder for pictures of the sampled garments that failed")
    parser.add_argument(
        "--reference-designs", action="store_true", help="draw the sampled designs like GarmentCode's, for --body alone"
    )
    mode = parser.add_mutually_exclusive_group()
    mode.add_argument("--beside", metavar="DEVICE", help="drape the sampled garments on this device too")
    mode.add_argument("--peer", choices=["newton"], help="drape the same meshes with this solver too")
    parser.add_argument("--batches", nargs="+", type=int, default=[1, 16, 64], help="batch sizes for --peer")
    parser.add_argument("--body", default="neutral", help="as for gcd drape")
    parser.add_argument("--body-apart", help="the same body with its legs apart, for trousers (default: --body)")
    parser.add_argument("--measurements", type=Path)
    parser.add_argument("--segmentation", type=Path)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--resolution", type=float, default=1.0, help="[cm]")
    parser.add_argument("--batch", type=int, default=1, help="garments per batch; threads on a CPU")
    parser.add_argument("--repeat", type=int, default=1, help="copies of each pattern, to fill a batch")


def run(options: argparse.Namespace) -> CaseResult:
    """Drape, and return seconds, outcomes and crossings."""
    if bool(options.spec) == bool(options.count):
        raise ConfigError("give either specification files or --count N")
    if options.peer:
        require_newton()
    if options.count:
        return _run_sampled(options)
    if options.beside:
        raise ConfigError("--beside needs sampled garments: give --count N alone")
    bodies = {apart: _body(options, apart) for apart in (False, True)}
    read = list(read_patterns(options.spec))
    if options.peer:
        return _compared(read, bodies, options)
    _warm_up(read, bodies, options.device)
    patterns = [pattern for pattern in read for _ in range(options.repeat if isinstance(pattern, Pattern) else 1)]
    draped = drape_patterns(patterns, bodies.__getitem__, resolution=options.resolution, device=options.device)
    results = list(draped)
    fittings = [result for result in results if isinstance(result, Fitting)]
    columns = dict.fromkeys((fittings or results)[0].row, "")
    return CaseResult(
        _figures(fittings) if fittings else [],
        [columns | result.row for result in results],
        [(result.name, result.reason) for result in results if isinstance(result, Refusal)],
    )


def _compared(
    read: Sequence[Pattern | Refusal], bodies: Mapping[bool, tuple[Body, Measurements]], options: argparse.Namespace
) -> CaseResult:
    """The patterns draped by both solvers, as their files place them."""
    jobs, refused = [], []
    for pattern in read:
        if isinstance(pattern, Refusal):
            refused.append((pattern.name, pattern.reason))
            continue
        try:
            mesh = build_box_mesh(pattern, spacing=options.resolution)
        except MeshError as error:
            refused.append((pattern.name, str(error)))
            continue
        jobs.append(DrapeJob(mesh, *bodies[has_legs(pattern)]))
    if not jobs:
        return CaseResult([], refused=refused)
    compared = compare_solvers(jobs, options.batches, device=resolve_device(options.device))
    return replace(compared, refused=refused)


def _body(options: argparse.Namespace, apart: bool) -> tuple[Body, Measurements]:
    name = options.body_apart if apart and options.body_apart else options.body
    body, measurements, *_ = named_body(
        name, measurements=options.measurements, segmentation=options.segmentation, legs_apart=apart
    )
    return body, measurements


def _warm_up(read: Sequence[Pattern | Refusal], bodies: Mapping[bool, tuple[Body, Measurements]], device: str) -> None:
    """Compile and load the kernels of a drape, with the first pattern that can be meshed."""
    for pattern in read:
        with suppress(MeshError):
            if isinstance(pattern, Pattern):
                mesh = build_box_mesh(pattern, spacing=3.0)
                drape_batch([DrapeJob(mesh, *bodies[has_legs(pattern)])], DrapeConfig(max_frames=1), device=device)
                return


def _figures(fittings: list[Fitting]) -> list[Figure]:
    return [
        Figure("s_per_garment", float(np.mean([f.drape_seconds for f in fittings])), "s"),
        Figure("mesh_s_per_garment", float(np.mean([f.mesh_seconds for f in fittings])), "s"),
        *quality([fitting.drape for fitting in fittings]),
    ]


def _run_sampled(options: argparse.Namespace) -> CaseResult:
    worn = _sampled(options)
    device = resolve_device(options.device)
    drape_batch([worn[0].job], DrapeConfig(max_frames=1), device=device)
    if options.beside:
        return compare_devices(worn, device, resolve_device(options.beside), batch=options.batch)
    if options.peer:
        return compare_solvers([one.job for one in worn], options.batches, device=device)
    start = time.perf_counter()
    drapes = drape_batch([one.job for one in worn], device=device, at_once=options.batch)
    seconds = time.perf_counter() - start
    rows = list(zip(worn, drapes, strict=True))
    figures = [
        Figure("garments", len(worn), ""),
        Figure("vertices_mean", float(np.mean([len(one.job.box_mesh.vertices) for one in worn])), ""),
        Figure("s_per_garment", seconds / len(worn), "s"),
        Figure("coarse_mesh_s_per_garment", _coarse_seconds(worn[:TIMED_MESHES]), "s"),
        Figure("grade_clean", float(np.mean([_grade(one, drape) is Grade.CLEAN for one, drape in rows])), "share"),
        *_outcomes(drapes),
    ]
    if device != "cpu":
        figures.append(Figure("gpu_mb_per_garment", gpu_peak_mb(device) / min(options.batch, len(worn)), "MB"))
    if options.sheet:
        _write_sheet(options.sheet, [(one.job, drape) for one, drape in rows[:64]])
    if options.failures:
        write_failures(options.failures, worn, drapes, device=device)
    return CaseResult(figures, _failed(worn, drapes))


def _sampled(options: argparse.Namespace) -> list[Worn]:
    made = {"resolution": options.resolution, "workers": options.workers}
    if options.reference_designs:
        wearers = _body(options, apart=False), _body(options, apart=True)
        return reference_sampled(options.seed, options.count, *wearers, **made)
    return sampled(options.seed, options.count, **made)


def _grade(worn: Worn, drape: Drape) -> Grade:
    return grade_of(drape, strain_of(worn.job.box_mesh, drape.vertices))


def _coarse_seconds(worn: Sequence[Worn]) -> float:
    """Mean time to make a coarse mesh [s]."""
    start = time.perf_counter()
    for one in worn:
        coarse_start(one.job.box_mesh)
    return (time.perf_counter() - start) / len(worn)


def _outcomes(drapes: Sequence[Drape]) -> list[Figure]:
    frames, outcomes = [drape.frames for drape in drapes], Counter(drape.outcome for drape in drapes)
    return [
        *quality(drapes),
        Figure("stretch_p50", float(np.median([drape.stretch_median for drape in drapes])), ""),
        Figure("stretch_p99", float(np.median([drape.stretch_p99 for drape in drapes])), ""),
        *(Figure(f"frames_p{share}", float(np.percentile(frames, share)), "frames") for share in (50, 80, 95)),
        *(Figure(outcome.name.lower(), outcomes[outcome], "garments") for outcome in Outcome),
    ]


def _failed(worn: Sequence[Worn], drapes: Sequence[Drape]) -> list[dict[str, Any]]:
    """A row per garment that did not settle."""
    return [
        {
            "index": one.index,
            "outcome": drape.outcome.name,
            "upper": one.upper,
            "wb": one.wb,
            "bottom": one.bottom,
            "frames": drape.frames,
            "self_crossings": drape.self_crossings,
            "body_crossings": drape.body_crossings,
            "body_through": drape.body_through,
            "stretch_p99": round(drape.stretch_p99, 2),
        }
        for one, drape in zip(worn, drapes, strict=True)
        if drape.outcome is not Outcome.SETTLED
    ]


def _write_sheet(path: Path, shown: Sequence[tuple[DrapeJob, Drape]]) -> None:
    """Front views of the garments, eight per row."""
    pictures = [render_garment(drape.vertices, job.box_mesh, job.body, size=TILE)[0] for job, drape in shown]
    write_whole(path, jpeg_bytes(contact_sheet(pictures, columns=8)))
