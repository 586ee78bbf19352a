"""Fittings: patterns from files, draped on a body, with pictures and mesh files of what comes out."""

import json
import logging
import platform
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gcd_dataset import __version__
from gcd_dataset.errors import ConfigError, MeshError
from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.generator.drape import DEFAULT_FABRIC, FABRICS, DrapeJob, Fabric
from gcd_dataset.generator.drapers import DrapeReply
from gcd_dataset.generator.drapers.in_order import Work, in_order
from gcd_dataset.generator.drapers.local import LocalDraper
from gcd_dataset.generator.drawing import draw_pattern, png_bytes
from gcd_dataset.generator.dressing import Dressing, dress, has_legs
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.generator.render import render_garment
from gcd_dataset.meshfiles import glb_bytes, obj_bytes, ply_bytes
from gcd_dataset.names import safe_name
from gcd_dataset.records import Body, BoxMesh, Drape, Measurements, Pattern
from gcd_dataset.spec import read_pattern
from gcd_dataset.validate import require_valid

__all__ = ["Fitting", "drape_patterns", "read_patterns", "write_fitting", "write_report"]

log = logging.getLogger(__name__)

PICTURE = 800  # pixels


@dataclass(frozen=True)
class Fitting:
    """One pattern draped on one body."""

    pattern: Pattern
    """As it was draped, with all that was assumed."""
    body: Body
    assumed: tuple[str, ...]
    """What its file did not say, with the reason."""
    box_mesh: BoxMesh
    drape: Drape
    mesh_seconds: float
    drape_seconds: float
    """Of its batch, divided by the garments in it."""

    @property
    def row(self) -> dict[str, Any]:
        """The line of a report."""
        return {
            "pattern": self.pattern.name,
            "vertices": len(self.box_mesh.vertices),
            "outcome": self.drape.outcome.name,
            "frames": self.drape.frames,
            "self_crossings": self.drape.self_crossings,
            "body_crossings": self.drape.body_crossings,
            "body_through": self.drape.body_through,
            "stretch_median": round(self.drape.stretch_median, 4),
            "stretch_p99": round(self.drape.stretch_p99, 4),
            "mesh_seconds": round(self.mesh_seconds, 3),
            "drape_seconds": round(self.drape_seconds, 3),
        }


def read_patterns(paths: Iterable[Path | str]) -> tuple[Pattern, ...]:
    """The patterns in specification files, all of them fit to be sewn.

    Raises ``SpecError`` or ``PatternError`` with the file, and ``ConfigError`` for two patterns of one name.
    """
    patterns = tuple(require_valid(read_pattern(path), source=str(path)) for path in paths)
    for number, pattern in enumerate(patterns):
        if pattern.name in {other.name for other in patterns[:number]}:
            raise ConfigError(
                f"two patterns are called {pattern.name}: rename a file, what they give would be mixed up"
            )
    return patterns


def drape_patterns(
    patterns: Iterable[Pattern],
    wearer: Callable[[bool], tuple[Body, Measurements]],
    *,
    fabric: Fabric = FABRICS[DEFAULT_FABRIC],
    resolution: float = 1.0,
    device: str = "auto",
) -> Iterator[Fitting]:
    """Each pattern on a body, in order; as many at a time as the device drapes at once.

    ``wearer(legs_apart)`` gives the body with its legs together or, for a garment with legs, apart: they must not
    touch there. What a file does not say is assumed (see ``dress``), told in the log and kept in the ``Fitting``.
    Raises ``PatternError`` for a pattern whose panels cannot be placed, ``MeshError`` with the pattern and its panel or
    seam, and ``ConfigError`` for a device that is not there.
    """
    work = (_work(pattern, wearer, fabric, resolution) for pattern in patterns)
    with LocalDraper(device) as draper:
        yield from in_order(work, draper, ahead=draper.at_once, at_once=draper.at_once)


def _work(
    pattern: Pattern, wearer: Callable[[bool], tuple[Body, Measurements]], fabric: Fabric, resolution: float
) -> Work[Fitting]:
    """A pattern to be draped."""
    dressing, on = _dressed(pattern, wearer)
    start = time.perf_counter()
    mesh = _box_mesh(dressing.pattern, resolution)
    seconds = time.perf_counter() - start

    def finish(draped: Sequence[DrapeReply]) -> Fitting:
        [garment] = draped
        return Fitting(dressing.pattern, on[0], dressing.assumed, mesh, garment.drape, seconds, garment.seconds)

    return Work([DrapeJob(mesh, *on, fabric)], finish)


def _dressed(
    pattern: Pattern, wearer: Callable[[bool], tuple[Body, Measurements]]
) -> tuple[Dressing, tuple[Body, Measurements]]:
    """The pattern made ready, and for whom. Where its file gives panels no place, legs show only once they have one."""
    legs_apart = has_legs(pattern)
    dressing = dress(pattern, *wearer(legs_apart))
    if has_legs(dressing.pattern) and not legs_apart:
        legs_apart = True
        dressing = dress(pattern, *wearer(legs_apart))
    for sentence in dressing.assumed:
        log.info("%s: %s", pattern.name, sentence)
    return dressing, wearer(legs_apart)


def _box_mesh(pattern: Pattern, resolution: float) -> BoxMesh:
    try:
        return build_box_mesh(pattern, spacing=resolution)
    except MeshError as error:
        raise MeshError(f"pattern {pattern.name}: {error}") from error


def write_fitting(fitting: Fitting, folder: Path, *, device: str = "auto") -> None:
    """OBJ, PLY, GLB and pictures of a fitting in ``folder``. Raises ``OutputError``."""
    name, mesh, vertices = safe_name(fitting.pattern.name), fitting.box_mesh, fitting.drape.vertices
    make_folder(folder)
    front, back = render_garment(vertices, mesh, fitting.body, size=PICTURE, device=device)
    for ending, content in {
        ".obj": obj_bytes(vertices, mesh),
        ".ply": ply_bytes(vertices, mesh),
        ".glb": glb_bytes(vertices, mesh, fitting.body),
        "_front.png": png_bytes(front),
        "_back.png": png_bytes(back),
        "_pattern.png": png_bytes(draw_pattern(fitting.pattern)),
    }.items():
        write_whole(folder / f"{name}{ending}", content)


def write_report(
    fittings: Iterable[Fitting], path: Path, *, body: str, fabric: str, resolution: float, device: str
) -> None:
    """What came out of each pattern, with what it was made by, as JSON. Raises ``OutputError``."""
    report = {
        "gcd_dataset": __version__,
        "numpy": np.__version__,
        "machine": platform.processor() or platform.machine(),
        "device": device,
        "body": body,
        "fabric": fabric,
        "resolution_cm": resolution,
        "garments": [{**fitting.row, "assumed": list(fitting.assumed)} for fitting in fittings],
    }
    write_whole(path, (json.dumps(report, indent=2) + "\n").encode())
