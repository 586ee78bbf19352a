"""Pictures of failed garments: at the start, once sewn, and at the end."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from benchmarks.draping.workload import Worn
from gcd_dataset.errors import DrapeError
from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob, resolve_device
from gcd_dataset.generator.drape.model import build_model
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.generator.drawing import contact_sheet, jpeg_bytes
from gcd_dataset.generator.lay_plan import INK, PAPER
from gcd_dataset.generator.render import render_garment
from gcd_dataset.records import BoxMesh, Drape, Outcome

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
        _views(_sewn(first, coarse=job.coarse is not None, device=device), first.box_mesh, job, device),
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


def _sewn(job: DrapeJob, *, coarse: bool, device: str) -> Float[np.ndarray, "v 3"] | None:
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
