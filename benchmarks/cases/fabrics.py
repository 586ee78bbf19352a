"""Fabrics: the bending length of strips against theory, and one skirt in several fabrics.

    python -m benchmarks.run fabrics --sheet fabrics.jpg
    python -m benchmarks.run fabrics --fabrics gcd_soft denim --resolution 1 --device cuda:0 --sheet fabrics.jpg

The bending length is measured on a strip 6 cm wide, meshed like a panel, that overhangs an edge as in Peirce's test;
theory gives (rigidity / weight)^(1/3). A fabric whose bending length is below two mesh edges is left out. Seconds are
those of the skirt's drape, set-up included, kernels loaded.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases.figures import Figure, Measured
from benchmarks.strips import Grain, bending_length, cantilever
from gcd_dataset.errors import ConfigError
from gcd_dataset.files import write_whole
from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.generator.drape import FABRICS, DrapeConfig, DrapeJob, drape_batch, fabric_named, resolve_device
from gcd_dataset.generator.drawing import contact_sheet, jpeg_bytes
from gcd_dataset.generator.garments import sample_design
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.generator.pipeline import build_pattern
from gcd_dataset.generator.render import render_garment
from gcd_dataset.records import Drape, Outcome
from gcd_dataset.seeding import Stage, rng

__all__ = ["add_arguments", "run"]

FABRICS_SHOWN = ("gcd_soft", "wool_light", "denim", "gcd_stiff")
SKIRT = Overlay.from_dict(
    {
        "meta": {"upper": "none", "wb": "StraightWB", "bottom": "SkirtCircle"},
        "waistband": {"waist": 1.0, "width": 0.3},
        "flare-skirt": {"length": 0.5, "suns": 1.2, "cut": {"add": False}},
    }
)
TILE = 1024  # pixels of a picture
CROP = np.s_[340:840, 262:762]  # waist to knees
GRAINS: tuple[Grain, ...] = ("warp", "weft")
MIN_EDGES = 2.0  # least bending length that the mesh resolves [edges]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--fabrics",
        nargs="+",
        default=FABRICS_SHOWN,
        metavar="NAME",
        help=f"fabrics of the skirt: {', '.join(FABRICS)}",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the skirt's design")
    parser.add_argument("--resolution", type=float, default=2.0, help="edge length of the skirt's mesh [cm]")
    parser.add_argument("--spacing", type=float, default=0.5, help="edge length of the strips' meshes [cm]")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--sheet", type=Path, help="picture of the skirt in each fabric, side by side")


def run(options: argparse.Namespace) -> Measured:
    """Measure strips of every fabric along warp and weft, and drape the skirt."""
    device = resolve_device(options.device)
    names = [name for name in FABRICS if min(_expected(name)) >= MIN_EDGES * options.spacing]
    rows = [_strips(name, options.spacing, device) for name in names]
    job = _skirt(options.seed, options.resolution)
    drapes = _drape(job, options.fabrics, device)
    if options.sheet:
        pictures = [render_garment(drape.vertices, job.box_mesh, job.body, size=TILE)[0] for drape, _ in drapes]
        sheet = contact_sheet([picture[CROP] for picture in pictures], columns=len(pictures))
        write_whole(options.sheet, jpeg_bytes(sheet))
    ratios = [row[f"{grain}_over_expected"] for row in rows for grain in ("warp", "weft")]
    return Measured(
        [
            Figure("strips_over_expected_mean", float(np.mean(ratios)), ""),
            Figure("strips_over_expected_least", float(np.min(ratios)), ""),
            Figure("strips_over_expected_most", float(np.max(ratios)), ""),
            *(Figure(f"{name}_s", seconds, "s") for name, (_, seconds) in zip(options.fabrics, drapes, strict=True)),
            *(Figure(f"{name}_frames", d.frames, "") for name, (d, _) in zip(options.fabrics, drapes, strict=True)),
            Figure("settled", float(np.mean([d.outcome is Outcome.SETTLED for d, _ in drapes])), "share"),
        ],
        rows,
    )


def _strips(name: str, spacing: float, device: str) -> dict[str, Any]:
    """Measured and expected bending lengths of a fabric [cm], and their ratio."""
    row: dict[str, Any] = {"fabric": name}
    for grain, expected in zip(GRAINS, _expected(name), strict=True):
        found = cantilever(fabric_named(name), grain, spacing=spacing, device=device)
        row |= {f"{grain}_cm": found, f"{grain}_expected_cm": expected, f"{grain}_over_expected": found / expected}
    return row


def _expected(name: str) -> list[float]:
    return [bending_length(fabric_named(name), grain) for grain in GRAINS]


def _skirt(seed: int, resolution: float) -> DrapeJob:
    body = build_body(neutral_shape())
    size = measure(body)
    pattern = build_pattern(size, sample_design(rng(seed, 0, Stage.DESIGN), [size], overlay=SKIRT))
    return DrapeJob(build_box_mesh(pattern, spacing=resolution), body, size)


def _drape(job: DrapeJob, names: list[str], device: str) -> list[tuple[Drape, float]]:
    """The skirt's drape and seconds in each fabric."""
    if not names:
        raise ConfigError("give --fabrics one name or more")
    jobs = [DrapeJob(job.box_mesh, job.body, job.measurements, fabric_named(name)) for name in names]
    drape_batch(jobs[:1], DrapeConfig(max_frames=1), device=device)
    drapes = []
    for each in jobs:
        start = time.perf_counter()
        [drape] = drape_batch([each], device=device)
        drapes.append((drape, time.perf_counter() - start))
    return drapes
