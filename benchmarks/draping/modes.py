"""Modes of ``benchmarks.run drape``: two devices, memory, end of sewing, switched features; pictures of failures."""

import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from benchmarks.cases import CaseResult, Figure
from benchmarks.draping.workload import Worn, quality
from gcd_dataset.errors import ConfigError, DrapeError
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


EVERY = 50  # drapes between records; the first interval is the warm-up
MB = 1e6  # bytes


def measure_memory(worn: Sequence[Worn], drapes: int, *, device: str, batch: int) -> CaseResult:
    """Memory over ``drapes`` drapes in this process, cycling through the garments.

    Raises ``ConfigError`` for fewer drapes than two intervals.
    """
    if drapes < 2 * EVERY:
        raise ConfigError(f"memory over {drapes} drapes: give {2 * EVERY} or more, {EVERY} are the warm-up")
    device = resolve_device(device)
    jobs = cycle([one.job for one in worn])
    rows: list[dict[str, float]] = []
    for first in range(0, drapes // EVERY * EVERY, EVERY):
        for start in range(0, EVERY, batch):
            drape_batch(list(islice(jobs, min(batch, EVERY - start))), device=device, at_once=batch)
        rows.append({"drapes": first + EVERY, "rss_mb": rss_mb(), "gpu_mb": gpu_used_mb(device)})
    warm, last = rows[0], rows[-1]
    return CaseResult(
        [
            Figure("drapes", last["drapes"], ""),
            Figure("rss_mb", last["rss_mb"], "MB"),
            Figure("rss_growth_mb", last["rss_mb"] - warm["rss_mb"], "MB"),
            Figure("gpu_growth_mb", last["gpu_mb"] - warm["gpu_mb"], "MB"),
        ],
        rows,
    )


def rss_mb() -> float:
    """Resident memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / MB


def gpu_used_mb(device: str) -> float:
    """Memory that Warp currently holds on a GPU [MB]; 0 on a CPU."""
    return wp.get_mempool_used_mem_current(device) / MB if _pooled(device) else 0.0


def gpu_peak_mb(device: str) -> float:
    """Peak memory of Warp on a GPU since the process started [MB]; 0 on a CPU."""
    return wp.get_mempool_used_mem_high(device) / MB if _pooled(device) else 0.0


def _pooled(device: str) -> bool:
    return bool(wp.get_device(device).is_cuda and wp.is_mempool_enabled(device))


SHARES = (50, 80, 95, 99)


def measure_sewn(worn: Sequence[Worn], *, device: str, batch: int) -> CaseResult:
    """Percentiles of the crossing edges after ``DrapeConfig.sewing_time``, and the share of garments without any."""
    found: dict[str, list[int]] = {"self": [], "body": [], "through": []}
    for first in range(0, len(worn), batch):
        solver = _sewn([one.job for one in worn[first : first + batch]], device)
        for kind, counts in (
            ("self", solver.self_crossings()),
            ("body", solver.body_crossings()),
            ("through", solver.body_through()),
        ):
            found[kind] += counts.tolist()
    total = np.sum([found[kind] for kind in found], axis=0)
    return CaseResult(
        [
            Figure("garments", len(worn), ""),
            Figure("sewn_clean", float(np.mean(total == 0)), "share"),
            *(
                Figure(f"sewn_{kind}_p{share}", float(np.percentile(counts, share)), "edges")
                for kind, counts in found.items()
                for share in SHARES
            ),
        ],
        [
            {
                "index": one.index,
                "upper": one.upper,
                "bottom": one.bottom,
                **{k: counts[row] for k, counts in found.items()},
            }
            for row, one in enumerate(worn)
            if total[row]
        ],
    )


def _sewn(jobs: Sequence[DrapeJob], device: str) -> Solver:
    """A solver after ``DrapeConfig.sewing_time``: its garments are sewn."""
    config = DrapeConfig(coarse_start=False)
    coarse = {k for k, job in enumerate(jobs) if job.coarse is not None}
    starts = [job if job.coarse is None else replace(job, box_mesh=job.coarse.mesh, coarse=None) for job in jobs]
    solver = Solver(build_model(starts, config, device, coarse=coarse), config)
    solver.run_for(config.sewing_time)
    return solver


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


def measure_ablation(worn: Sequence[Worn], *, device: str, batch: int) -> CaseResult:
    """Drape the garments in every variant. A row per variant; figures of the full system."""
    rows: list[dict[str, Any]] = []
    figures: list[Figure] = []
    for variant in variants():
        start = time.perf_counter()
        drapes = drape_batch([variant.job(one.job) for one in worn], variant.config(), device=device, at_once=batch)
        each = (time.perf_counter() - start) / len(worn)
        figures = figures or [Figure("garments", len(worn), ""), Figure("s_per_garment", each, "s"), *quality(drapes)]
        rows += _rows(variant, worn, drapes, each)
    return CaseResult(figures, rows)


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
