"""Fittings: patterns read from files and draped on a body, written as pictures, mesh files and a report."""

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
from gcd_dataset.bodyfiles import write_measurements
from gcd_dataset.errors import ConfigError, MeshError, PatternError
from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.generator.drape import DEFAULT_FABRIC, FABRICS, DrapeJob, Fabric
from gcd_dataset.generator.drapers import DrapeReply
from gcd_dataset.generator.drapers.in_order import Work, in_order
from gcd_dataset.generator.drapers.local import LocalDraper
from gcd_dataset.generator.drawing import draw_pattern, png_bytes
from gcd_dataset.generator.dressing import Dressing, dress, has_legs
from gcd_dataset.generator.garments import DrawnOutfit, OutfitDesign, Reject, check_outfit
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.generator.render import render_garment
from gcd_dataset.generator.svg import pattern_svg
from gcd_dataset.meshfiles import glb_bytes, obj_bytes, ply_bytes
from gcd_dataset.names import safe_name
from gcd_dataset.records import Body, BoxMesh, Drape, Measurements, Pattern
from gcd_dataset.release.published_names import ENDINGS
from gcd_dataset.spec import read_pattern, write_pattern
from gcd_dataset.validate import Severity, require_valid

__all__ = ["Fitting", "drape_patterns", "read_patterns", "write_drawn", "write_fitting", "write_report"]

log = logging.getLogger(__name__)

PICTURE_SIZE = 800  # pixels


@dataclass(frozen=True)
class Fitting:
    """One pattern draped on one body."""

    pattern: Pattern
    """The pattern as draped: missing values are filled with the assumed ones."""
    body: Body
    assumed: tuple[str, ...]
    """One sentence for each value that the file lacks: the assumed value and the reason."""
    box_mesh: BoxMesh
    drape: Drape
    mesh_seconds: float
    drape_seconds: float
    """Time of its batch, divided by the number of garments in it."""

    @property
    def row(self) -> dict[str, Any]:
        """The entry of a report: number of vertices, outcome, frames, crossings, stretch and times."""
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
    """The valid patterns in specification files.

    Raises ``SpecError`` or ``PatternError`` with the file, and ``ConfigError`` for two patterns with the same name.
    """
    patterns = tuple(require_valid(read_pattern(path), source=str(path)) for path in paths)
    for number, pattern in enumerate(patterns):
        if pattern.name in {other.name for other in patterns[:number]}:
            raise ConfigError(f"two patterns are called {pattern.name}: rename a file, since outputs go by this name")
    return patterns


def write_drawn(
    design: OutfitDesign, size: Measurements, folder: Path, *, source: Path
) -> tuple[Path, tuple[Reject, ...]]:
    """Write specification, SVG and measures of a design for a wearer, named after its file ``source``.

    Returns the path of the specification, and the rules that the design breaks on this wearer. Raises ``PatternError``
    for a pattern that cannot be drawn or sewn, ``BodyError`` for impossible measures, ``OutputError``.
    """
    name = safe_name(source.stem.removesuffix("_design_params"))
    try:
        drawn = DrawnOutfit.of(size, design, name=name)
    except PatternError as error:
        raise PatternError(f"{source}: {error}") from error
    rejects = check_outfit(drawn)
    if any(fault.severity is Severity.ERROR for fault in drawn.faults):
        raise PatternError(f"{source}: cannot be sewn for this body: {'; '.join(map(str, rejects))}")
    spec, svg, measures = (make_folder(folder) / f"{name}{ENDINGS[kind]}" for kind in ("spec", "svg", "measures"))
    write_pattern(drawn.pattern, spec)
    write_whole(svg, pattern_svg(drawn.pattern))
    write_measurements(size, measures)
    return spec, rejects


def drape_patterns(
    patterns: Iterable[Pattern],
    wearer: Callable[[bool], tuple[Body, Measurements]],
    *,
    fabric: Fabric = FABRICS[DEFAULT_FABRIC],
    resolution: float = 1.0,
    device: str = "auto",
) -> Iterator[Fitting]:
    """Drape each pattern on a body, in batches as large as suits the device; yields the fittings in order.

    ``wearer(legs_apart)`` returns the body and its measures; legs are apart for garments with legs, so that the thighs
    do not touch. Values missing from a file are assumed (see ``dress``), logged and recorded in the ``Fitting``.
    ``resolution`` is the length of mesh edges [cm]. Raises ``PatternError`` for a pattern with panels that cannot be
    placed, ``MeshError`` with the pattern and its panel or seam, and ``ConfigError`` for a missing device.
    """
    work = (_work(pattern, wearer, fabric, resolution) for pattern in patterns)
    with LocalDraper(device) as draper:
        yield from in_order(work, draper, ahead=draper.at_once, at_once=draper.at_once)


def _work(
    pattern: Pattern, wearer: Callable[[bool], tuple[Body, Measurements]], fabric: Fabric, resolution: float
) -> Work[Fitting]:
    """The drape job of a pattern, and the function that makes a ``Fitting`` of the reply."""
    dressing, (body, size) = _dress(pattern, wearer)
    start = time.perf_counter()
    mesh = _box_mesh(dressing.pattern, resolution)
    seconds = time.perf_counter() - start

    def finish(replies: Sequence[DrapeReply]) -> Fitting:
        [reply] = replies
        return Fitting(dressing.pattern, body, dressing.assumed, mesh, reply.drape, seconds, reply.seconds)

    return Work([DrapeJob(mesh, body, size, fabric)], finish)


def _dress(
    pattern: Pattern, wearer: Callable[[bool], tuple[Body, Measurements]]
) -> tuple[Dressing, tuple[Body, Measurements]]:
    """The pattern with its panels placed, and the body and measures for which they are placed."""
    legs_apart = has_legs(pattern)
    dressing = dress(pattern, *wearer(legs_apart))
    if has_legs(dressing.pattern) and not legs_apart:  # openings show legs once ``dress`` has placed them
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
    """Write OBJ, PLY, GLB and pictures of a fitting to ``folder``. Raises ``OutputError``."""
    name, mesh, vertices = safe_name(fitting.pattern.name), fitting.box_mesh, fitting.drape.vertices
    make_folder(folder)
    front, back = render_garment(vertices, mesh, fitting.body, size=PICTURE_SIZE, device=device)
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
    """Write a JSON report: the settings, and the result of each pattern. Raises ``OutputError``."""
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
