"""Modes of ``benchmarks.run drape``: two devices; pictures of failures."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import warp as wp
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from benchmarks.cases import CaseResult, Figure
from benchmarks.draping.workload import Worn
from gcd_dataset.errors import DrapeError
from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob, drape_batch, resolve_device
from gcd_dataset.generator.drape.model import build_model
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.generator.drawing import contact_sheet, jpeg_bytes
from gcd_dataset.generator.lay_plan import INK, PAPER
from gcd_dataset.generator.render import render_garment
from gcd_dataset.records import BoxMesh, Drape, Outcome


def compare_devices(worn: Sequence[Worn], device: str, other: str, *, batch: int) -> CaseResult:
    """Distances [cm] between corresponding vertices of the two drapes of each garment that settles on both devices.

    A noise floor of draped positions: the devices round sums and functions differently, and a fold may fall to either
    side.
    """
    jobs = [one.job for one in worn]
    pairs = zip(worn, drape_batch(jobs, device=device, at_once=batch), drape_batch(jobs, device=other), strict=True)
    rows = [
        {
            "index": one.index,
            "upper": one.upper,
            "bottom": one.bottom,
            "mean_cm": float(apart.mean()),
            "p95_cm": float(np.percentile(apart, 95)),
            "largest_cm": float(apart.max()),
        }
        for one, here, there in pairs
        if here.outcome is there.outcome is Outcome.SETTLED
        for apart in [np.linalg.norm(here.vertices - there.vertices, axis=1)]
    ]
    figures = [Figure("garments_on_both_devices", len(rows), "")]
    if rows:
        means = np.array([row["mean_cm"] for row in rows])
        figures += [
            Figure("floor_mean", float(means.mean()), "cm"),
            Figure("floor_median", float(np.median(means)), "cm"),
            Figure("floor_largest_mean", float(means.max()), "cm"),
            Figure("floor_p95", float(np.mean([row["p95_cm"] for row in rows])), "cm"),
        ]
    return CaseResult(figures, rows)


MB = 1e6  # bytes


def gpu_peak_mb(device: str) -> float:
    """Peak memory of Warp on a GPU since the process started [MB]; 0 on a CPU."""
    pooled = wp.get_device(device).is_cuda and wp.is_mempool_enabled(device)
    return wp.get_mempool_used_mem_high(device) / MB if pooled else 0.0


# ------------------------------------------------------------------------------------------------------------- failures


TILE = 320  # side of a view [pixels]
TITLE = 28  # height of a line of the title [pixels]

Picture = UInt8[np.ndarray, "h w 3"]


def write_failures(folder: Path, worn: Sequence[Worn], drapes: Sequence[Drape], *, device: str) -> None:
    """Write ``INDEX_OUTCOME.jpg`` for each failed garment, and ``kinds.jpg`` with the first of each outcome."""
    make_folder(folder)
    kinds: dict[Outcome, Picture] = {}
    for one, drape in zip(worn, drapes, strict=True):
        if drape.outcome is Outcome.SETTLED:
            continue
        picture = picture_failure(one, drape, device=device)
        kinds.setdefault(drape.outcome, picture)
        write_whole(folder / f"{one.index}_{drape.outcome.name}.jpg", jpeg_bytes(picture))
    if kinds:
        sheet = contact_sheet([kinds[outcome] for outcome in Outcome if outcome in kinds], columns=2, gap=18)
        write_whole(folder / "kinds.jpg", jpeg_bytes(sheet))


def picture_failure(worn: Worn, drape: Drape, *, device: str) -> Picture:
    """Front views of start, sewn and end above their back views, with the outcome as title."""
    job, device = worn.job, resolve_device(device)
    first = replace(job, box_mesh=job.coarse.mesh) if job.coarse else job
    columns = [
        _views(first.box_mesh.vertices, first.box_mesh, job, device),
        _views(_after_sewing(first, coarse=job.coarse is not None, device=device), first.box_mesh, job, device),
        _views(drape.vertices, job.box_mesh, job, device),
    ]
    tiles = [column[side] for side in (0, 1) for column in columns]
    kind = " ".join(part for part in (worn.upper, worn.wb, worn.bottom) if part)
    return _titled(
        contact_sheet(tiles, columns=len(columns)),
        f"{drape.outcome.name}: {drape.outcome.value.split(':')[0]}",
        f"{worn.index} {kind}, {worn.body_name}: {drape.frames} frames, crossings {drape.self_crossings} with itself, "
        f"{drape.body_crossings} + {drape.body_through} with the body, stretch {drape.stretch_p99:.2f}",
    )


def _after_sewing(job: DrapeJob, *, coarse: bool, device: str) -> Float[np.ndarray, "v 3"] | None:
    """Vertices once the seams have closed [cm]; ``None`` if the drape diverges before."""
    config = DrapeConfig()
    solver = Solver(build_model([job], config, device, coarse=[0] if coarse else []), config)
    try:
        solver.run_for(config.sewing_time)
    except DrapeError:
        return None
    return solver.state.x.numpy()


def _views(vertices: Float[np.ndarray, "v 3"] | None, mesh: BoxMesh, job: DrapeJob, device: str) -> list[Picture]:
    """Front and back views; blank without finite vertices."""
    if vertices is None or not np.isfinite(vertices).all():
        return 2 * [np.full((TILE, TILE, 3), 255, np.uint8)]
    return list(render_garment(vertices, mesh, job.body, size=TILE, device=device))


def _titled(picture: Picture, *lines: str) -> Picture:
    """The picture with lines of text above it."""
    height, width, _ = picture.shape
    image = Image.new("RGB", (width, height + TITLE * len(lines)), PAPER)
    image.paste(Image.fromarray(picture), (0, TITLE * len(lines)))
    for number, line in enumerate(lines):
        font_size = 0.7 * TITLE * min(1.0, 0.96 * width / ImageFont.load_default(0.7 * TITLE).getlength(line))
        position = (0.02 * width, (number + 0.5) * TITLE)
        ImageDraw.Draw(image).text(position, line, fill=INK, font=ImageFont.load_default(font_size), anchor="lm")
    return np.asarray(image)
