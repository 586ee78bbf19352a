"""Drape sampled garments on other bodies and poses: pass and clean shares, crossings, seconds.

    python -m benchmarks.run bodies_draped --count 100 --workers 12 --batch 128 --device cuda:0

Poses of our own body (arms up and down by 40 degrees, T-pose, arms forward, legs wide), and scans of a woman (3,000
vertices; with holes): see ``benchmarks.draping.other_bodies``. Each garment is sampled for the measures of its wearer:
those taken in the A-pose, with the arm angle of the actual pose. Sleeves that point away from the arms are turned to
them, as ``gcd drape`` does. With its arms 40 degrees down the body passes through itself in the armpits ("body through
itself" counts the edges); with 25 degrees it does not.
``neutral``, ``female`` and ``male`` are the usual wearers, to compare with.
"""

import argparse
import sys
import time
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import CaseResult, Figure
from benchmarks.draping.modes import write_failures
from benchmarks.draping.other_bodies import OTHER_BODIES, dressed
from benchmarks.draping.workload import Worn, is_clean
from gcd_dataset.errors import ConfigError
from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.drape import DrapeConfig, drape_batch, resolve_device
from gcd_dataset.generator.drape.self_contact import skin_crossings
from gcd_dataset.generator.drawing import contact_sheet, jpeg_bytes
from gcd_dataset.generator.render import render_garment
from gcd_dataset.records import Body, Drape, Outcome
from gcd_dataset.workers import parallel_map

TILE = 320  # side of a garment's picture on a sheet [pixels]
SHOWN = 16  # most garments on the sheet of a body


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=100, help="garments for each body")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--bodies", nargs="+", choices=[*OTHER_BODIES], default=[*OTHER_BODIES], help="default: all")
    parser.add_argument("--workers", type=int, default=1, help="processes that make patterns and meshes")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--resolution", type=float, default=1.0, help="[cm]")
    parser.add_argument("--batch", type=int, default=128, help="garments per batch; threads on a CPU")
    parser.add_argument("--sheets", type=Path, help=f"folder for a picture of the first {SHOWN} garments on each body")
    parser.add_argument("--failures", type=Path, help="folder for pictures of the garments that failed, by body")


def run(options: argparse.Namespace) -> CaseResult:
    """Drape ``count`` garments on each body. Raises ``ConfigError`` for a count below 1, or without a design."""
    if options.count < 1:
        raise ConfigError(f"count is {options.count}: give 1 or more")
    device = resolve_device(options.device)
    figures: list[Figure] = []
    rows: list[dict[str, Any]] = []
    for name in dict.fromkeys(options.bodies):
        make = partial(dressed, OTHER_BODIES[name](), name, options.seed, options.resolution)
        worn = [one for one in parallel_map(make, range(options.count), options.workers) if one is not None]
        if not worn:
            raise ConfigError(f"{name}: none of {options.count} designs was accepted: raise --count")
        drapes, seconds = _draped(worn, device, options.batch, warm=bool(rows))
        _write_pictures(options, name, worn, drapes, device)
        rows.append(_row(name, options.count, worn, drapes, seconds))
        print(f"benchmarks.run bodies_draped: {rows[-1]}", file=sys.stderr, flush=True)
        figures += _figures(name, drapes, seconds)
    return CaseResult(figures, rows)


def _draped(worn: Sequence[Worn], device: str, batch: int, *, warm: bool) -> tuple[list[Drape], float]:
    """The drapes and their wall time [s], without the time to load kernels."""
    jobs = [one.job for one in worn]
    if not warm:
        drape_batch(jobs[:1], DrapeConfig(max_frames=1), device=device)
    start = time.perf_counter()
    drapes = drape_batch(jobs, device=device, at_once=batch)
    return drapes, time.perf_counter() - start


def _figures(name: str, drapes: Sequence[Drape], seconds: float) -> list[Figure]:
    return [
        Figure(f"{name}_passed", float(np.mean([d.outcome is Outcome.SETTLED for d in drapes])), "share"),
        Figure(f"{name}_clean", float(np.mean([is_clean(d) for d in drapes])), "share"),
        Figure(f"{name}_s_per_garment", seconds / len(drapes), "s"),
    ]


def _row(name: str, count: int, worn: Sequence[Worn], drapes: Sequence[Drape], seconds: float) -> dict[str, Any]:
    failed = Counter(drape.outcome.name.lower() for drape in drapes if drape.outcome is not Outcome.SETTLED)
    crossings = {
        "self": [d.self_crossings for d in drapes],
        "body": [d.body_crossings for d in drapes],
        "through": [d.body_through for d in drapes],
    }
    return {
        "body": name,
        "vertices": len(worn[0].job.body.vertices),
        "garments": len(worn),
        "not accepted": count - len(worn),
        "body through itself": _self_crossings(worn[0].job.body),
        "passed": f"{np.mean([d.outcome is Outcome.SETTLED for d in drapes]):.1%}",
        "clean": f"{np.mean([is_clean(d) for d in drapes]):.1%}",
        **{f"{kind} crossings p95": f"{np.percentile(counts, 95):.0f}" for kind, counts in crossings.items()},
        "s per garment": f"{seconds / len(drapes):.3f}",
        "failed for": ", ".join(f"{outcome} {number}" for outcome, number in failed.most_common()),
    }


def _self_crossings(body: Body) -> int | str:
    """Skin edges that cross the skin: no cloth fits between there. An empty string for faces unlike the model's."""
    return skin_crossings(body) if np.array_equal(body.faces, body_model().faces) else ""


def _write_pictures(
    options: argparse.Namespace, name: str, worn: Sequence[Worn], drapes: Sequence[Drape], device: str
) -> None:
    if options.sheets:
        make_folder(options.sheets)
        shown = list(zip(worn, drapes, strict=True))[:SHOWN]
        views = [_front(one, drape, device) for one, drape in shown]
        write_whole(options.sheets / f"{name}.jpg", jpeg_bytes(contact_sheet(views, columns=min(4, len(views)))))
    if options.failures:
        write_failures(options.failures / name, worn, drapes, device=device)


def _front(one: Worn, drape: Drape, device: str) -> np.ndarray:
    return render_garment(drape.vertices, one.job.box_mesh, one.job.body, size=TILE, device=device)[0]
