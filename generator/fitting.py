"""Fittings: patterns read from files and draped on a body, written as pictures, mesh files and a report."""

import io
import json
import logging
import math
import platform
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import count, pairwise, repeat
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from gcd_dataset import __version__
from gcd_dataset.bodies import Wearer
from gcd_dataset.bodyfiles import write_measurements
from gcd_dataset.errors import ConfigError, DrapeError, MeshError, PatternError, SpecError
from gcd_dataset.faults import Severity, require_valid
from gcd_dataset.files import make_folder, safe_name, write_whole
from gcd_dataset.generator.body.pose import pose_body, pose_degrees
from gcd_dataset.generator.drape import DEFAULT_FABRIC, FABRICS, DrapeJob, Fabric, drape_motion, drape_outfit
from gcd_dataset.generator.drape.drape import garment_motion
from gcd_dataset.generator.drapers import DrapeReply
from gcd_dataset.generator.drapers.draper import DrapeWork, in_order
from gcd_dataset.generator.drapers.local import LocalDraper
from gcd_dataset.generator.drawing import draw_pattern, png_bytes
from gcd_dataset.generator.dressing import Dressing, dress, has_legs
from gcd_dataset.generator.ease import ease_of
from gcd_dataset.generator.garments import DrawnGarment, GarmentDesign, Reject, check_design, read_design
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.generator.outfits import is_tucked, order_fault, worn_outfit
from gcd_dataset.generator.pipeline import build_pattern
from gcd_dataset.generator.render.plain import garment_scene, start_plain
from gcd_dataset.generator.sized import Cut, lifted
from gcd_dataset.generator.svg import nest_svg, pattern_svg
from gcd_dataset.outfits import joined_drape, joined_mesh, joined_pattern
from gcd_dataset.records import (
    FPS,
    Body,
    BoxMesh,
    Drape,
    Ease,
    Fit,
    GarmentMotion,
    Layer,
    Maps,
    Measurements,
    Outcome,
    Outfit,
    PanelRole,
    Pattern,
    Pose,
    WornGarment,
)
from gcd_dataset.release.published_names import ENDINGS
from gcd_dataset.shards.motion import encode_motion
from gcd_dataset.spec import pattern_name, read_pattern, write_pattern

log = logging.getLogger(__name__)

PICTURE_SIZE = 800  # pixels
CROSSINGS = ("self_crossings", "body_crossings", "body_through")
STRIP, STRIP_SIZE = 8, 300  # frames in the picture of a motion, and pixels of each


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
    ease: Mapping[str, Ease]
    """See ``ease_of``."""
    mesh_seconds: float
    drape_seconds: float
    """Time of its batch, divided by the number of garments in it."""
    maps: Maps | None = None
    outfit: Outfit | None = None
    """The garments that this one joins."""
    motion: GarmentMotion | None = None
    """The garment on the moving body; ``body`` and ``drape`` are those of its first frame."""
    home: Body | None = None
    """The body of a motion in the A-pose."""

    def body_in(self, frame: int) -> Body:
        """The body in a frame of the motion."""
        assert self.motion is not None and self.home is not None
        return pose_body(self.home, self.motion.poses[frame])

    @property
    def row(self) -> dict[str, Any]:
        """The entry of a report: number of vertices, outcome, frames, crossings, stretch, times and ease."""
        motion = self.motion
        counts = dict(zip(CROSSINGS, motion.crossings.T.tolist(), strict=True)) if motion else {}
        return {
            "pattern": self.pattern.name,
            "vertices": len(self.box_mesh.vertices),
            "outcome": self.drape.outcome.name,
            "reason": self.drape.reason,
            "frames": self.drape.frames,
            "self_crossings": self.drape.self_crossings,
            "body_crossings": self.drape.body_crossings,
            "body_through": self.drape.body_through,
            "stretch_median": round(self.drape.stretch_median, 4),
            "stretch_p99": round(self.drape.stretch_p99, 4),
            "mesh_seconds": round(self.mesh_seconds, 3),
            "drape_seconds": round(self.drape_seconds, 3),
            "ease": {
                name: {key: x if math.isfinite(x) else None for key, x in asdict(ease).items()}
                for name, ease in self.ease.items()
            },
            **({"motion": {"fps": motion.fps, "clean_frames": int(motion.is_clean.sum()), **counts}} if motion else {}),
        }

    def ease_lines(self) -> Iterator[str]:
        """A table of the girths and lengths that the garment has [cm]."""
        yield f"{'[cm]':10}{'cloth':>8}{'body':>8}{'ease':>8}{'worn':>8}"
        for name, ease in self.ease.items():
            columns = (ease.cloth, ease.body, ease.ease, ease.worn)
            if math.isfinite(ease.cloth) or math.isfinite(ease.worn):
                yield f"{name:10}" + "".join(f"{x:8.1f}" if math.isfinite(x) else f"{'':8}" for x in columns)


@dataclass(frozen=True)
class Refusal:
    """A pattern that was not draped: it cannot be read, sewn, placed or meshed."""

    name: str
    reason: str
    assumed: tuple[str, ...] = ()
    outcome: Outcome = Outcome.REFUSED

    @property
    def row(self) -> dict[str, Any]:
        """The entry of a report."""
        return {"pattern": self.name, "outcome": self.outcome.name, "reason": self.reason}


def read_patterns(paths: Sequence[Path | str]) -> Iterator[Pattern | Refusal]:
    """The patterns in specification files, or why one cannot be read or sewn, in order.

    Outputs go by a pattern's name: of two files of one name the second gets a number, as in ``dress-2``.
    """
    for path, name in zip(paths, _distinct([pattern_name(path) for path in paths]), strict=True):
        try:
            yield replace(require_valid(read_pattern(path), source=str(path)), name=name)
        except (SpecError, PatternError) as error:
            yield Refusal(name, str(error))


def cut_patterns(
    paths: Sequence[Path | str], cut: Cut, wearer: Measurements
) -> Iterator[tuple[Pattern | Refusal, Fit | None]]:
    """The patterns of designs in files, drawn for a size, at the wearer's height, and how they fit; in order.

    A file without a design, or a design that cannot be cut in this size or put on by the wearer, is a ``Refusal``.
    """
    for path, name in zip(paths, _distinct([garment_name(Path(path)) for path in paths]), strict=True):
        try:
            design = read_design(path)
            pattern = build_pattern(cut.measures, design, name=name)
        except (SpecError, ConfigError, PatternError) as error:
            yield Refusal(name, str(error)), None
            continue
        fit = cut.fit(pattern, design, wearer)
        if fit.obstacle:
            yield Refusal(name, fit.obstacle.reason, outcome=Outcome.CANNOT_BE_PUT_ON), fit
        else:
            yield lifted(pattern, design, cut_for=cut.measures, wearer=wearer), fit


def _distinct(names: Sequence[str]) -> Iterator[str]:
    """The names, with a number where files of an earlier name, or of a later one as it is, would be overwritten."""
    given, used = {_file_key(name) for name in names}, set[str]()
    for name in names:
        numbered = (f"{name}-{number}" for number in count(2))
        free = (other for other in numbered if _file_key(other) not in given | used)
        yield (distinct := name if _file_key(name) not in used else next(free))
        used.add(_file_key(distinct))


def _file_key(name: str) -> str:
    return safe_name(name).casefold()  # some file systems ignore case


def write_drawn(
    design: GarmentDesign, size: Measurements, folder: Path, *, source: Path
) -> tuple[Path, tuple[Reject, ...]]:
    """Write specification, SVG and measures of a design for a wearer, named after its file ``source``.

    Returns the path of the specification, and the rules that the design breaks on this wearer. Raises ``PatternError``
    for a pattern that cannot be drawn or sewn, ``BodyError`` for impossible measures, ``OutputError``.
    """
    name = garment_name(source)
    try:
        drawn = DrawnGarment.of(size, design, name=name)
    except PatternError as error:
        raise PatternError(f"{source}: {error}") from error
    rejects = check_design(drawn)
    if any(fault.severity is Severity.ERROR for fault in drawn.faults):
        raise PatternError(f"{source}: cannot be sewn for this body: {'; '.join(map(str, rejects))}")
    spec, svg, measures = (make_folder(folder) / f"{name}{ENDINGS[kind]}" for kind in ("spec", "svg", "measures"))
    write_pattern(drawn.pattern, spec)
    write_whole(svg, pattern_svg(drawn.pattern))
    write_measurements(size, measures)
    return spec, rejects


def garment_name(source: Path) -> str:
    """The name of a design's garment, from its file."""
    return safe_name(source.stem.removesuffix("_design_params"))


def write_graded(graded: Mapping[str, Pattern], folder: Path, *, seam_allowance: float, paper: str) -> None:
    """Write a garment in several sizes: a specification for each, and all sizes nested in one PDF, DXF and SVG.

    ``graded``: size to pattern, all of one name. For ``seam_allowance`` [cm], ``paper`` and errors see ``exports.pdf``.
    """
    from gcd_dataset import exports

    name = safe_name(next(iter(graded.values())).name)
    exports.pdf(graded, make_folder(folder) / f"{name}.pdf", seam_allowance=seam_allowance, paper=paper)
    exports.dxf(graded, folder / f"{name}.dxf", seam_allowance=seam_allowance)
    write_whole(folder / f"{name}{ENDINGS['svg']}", nest_svg(graded))
    for file, pattern in zip(_distinct([f"{name}_{size}" for size in graded]), graded.values(), strict=True):
        write_pattern(pattern, folder / f"{safe_name(file)}{ENDINGS['spec']}")


def drape_patterns(
    patterns: Iterable[Pattern | Refusal],
    wearer: Wearer,
    *,
    fabric: Fabric = FABRICS[DEFAULT_FABRIC],
    resolution: float = 1.0,
    device: str = "auto",
    maps: bool = False,
    pose: Pose | None = None,
) -> Iterator[Fitting | Refusal]:
    """Drape each pattern on a body, in batches as large as suits the device; yields the fittings in order.

    ``wearer(legs_apart)`` returns the body and its measures; legs are apart for garments with legs, so that the thighs
    do not touch. Values missing from a file are assumed (see ``dress``), logged and recorded in the ``Fitting``.
    ``resolution`` is the length of mesh edges [cm]; ``maps``: compute ``Fitting.maps``; ``pose``: the body moves to it
    once the garment is at rest, and the fitting has no ease, which belongs to the A-pose. A pattern that cannot be
    placed or meshed costs no other: it yields a ``Refusal``, as do those of ``read_patterns``. Raises ``BodyError`` for
    an unusable body, ``ConfigError`` for a missing device.
    """
    work = (_work(pattern, wearer, fabric, resolution, maps=maps, pose=pose) for pattern in patterns)
    with LocalDraper(device) as draper:
        yield from in_order(work, draper, ahead=draper.at_once, at_once=draper.at_once)


def _work(
    pattern: Pattern | Refusal, wearer: Wearer, fabric: Fabric, resolution: float, *, maps: bool, pose: Pose | None
) -> DrapeWork[Fitting | Refusal]:
    """The drape job of a pattern, and the function that makes a ``Fitting`` of the reply; without a job a refusal."""
    prepared = _prepared(pattern, wearer, fabric, resolution)
    if isinstance(prepared, Refusal):
        return DrapeWork([], lambda _: prepared)
    dressing, job, seconds = prepared
    mesh, body, size = job.box_mesh, job.body, job.measurements

    def finish(replies: Sequence[DrapeReply]) -> Fitting:
        [reply] = replies
        drape = reply.drape
        ease = {} if pose else ease_of(dressing.pattern, mesh, body, size, drape.vertices)
        posed = pose_body(body, pose) if pose else body
        return Fitting(dressing.pattern, posed, dressing.assumed, mesh, drape, ease, seconds, reply.seconds, reply.maps)

    return DrapeWork([replace(job, pose=pose)], finish, maps=maps)


def _prepared(
    pattern: Pattern | Refusal, wearer: Wearer, fabric: Fabric, resolution: float
) -> tuple[Dressing, DrapeJob, float] | Refusal:
    """The pattern as placed, its drape job, and the time to mesh it [s]."""
    if isinstance(pattern, Refusal):
        return pattern
    try:
        dressing, (body, size) = _dress(pattern, wearer)
        start = time.perf_counter()
        mesh = build_box_mesh(dressing.pattern, spacing=resolution)
        seconds = time.perf_counter() - start
        job = DrapeJob(mesh, body, size, fabric)
        job.require_drapeable()
    except (PatternError, MeshError, DrapeError) as error:
        return Refusal(pattern.name, str(error))
    return dressing, job, seconds


def drape_moving(
    patterns: Iterable[Pattern | Refusal],
    wearer: Wearer,
    poses: Sequence[Pose],
    *,
    fps: float = FPS,
    fabric: Fabric = FABRICS[DEFAULT_FABRIC],
    resolution: float = 1.0,
    device: str = "auto",
) -> Iterator[Fitting | Refusal]:
    """Drape each pattern on a body that moves through poses, ``fps`` a second, as ``drape_motion`` does.

    Other arguments as for ``drape_patterns``. ``Fitting.motion`` ends before a frame in which the garment slides off,
    falls, diverges or has no room for its contacts: the drape has that outcome, and its reason names the frame, from 1.
    A garment that does not come to rest in the first pose has no motion. Raises ``BodyError`` for an impossible pose.
    """
    for pattern in patterns:
        prepared = _prepared(pattern, wearer, fabric, resolution)
        if isinstance(prepared, Refusal):
            yield prepared
            continue
        dressing, job, seconds = prepared
        start = time.perf_counter()
        drapes = list(drape_motion(job, poses, fps=fps, device=device))
        taken, rest, last = time.perf_counter() - start, drapes[0], drapes[-1]
        motion = garment_motion(drapes, job.box_mesh.faces, poses, fps=fps)
        if motion.ended is not Outcome.SETTLED:
            where = f"frame {len(drapes)} of {len(poses)}"
            rest = replace(rest, outcome=last.outcome, reason=f"{where}: {last.reason}" if last.reason else where)
        fitting = Fitting(dressing.pattern, job.body, dressing.assumed, job.box_mesh, rest, {}, seconds, taken)
        yield replace(
            fitting, body=pose_body(job.body, poses[0]), home=job.body, motion=motion if motion.poses else None
        )


def drape_together(
    patterns: Sequence[Pattern],
    wearer: Wearer,
    *,
    fabric: Fabric = FABRICS[DEFAULT_FABRIC],
    resolution: float = 1.0,
    device: str = "auto",
) -> tuple[list[Fitting], Fitting]:
    """The garments of an outfit, from the skin outwards, draped over each other; and all of them as one fitting.

    Other arguments as for ``drape_patterns``; all garments are on one body, its legs apart if one has legs. Raises
    ``PatternError`` for garments that cannot be worn in this order (``order_fault``), or cannot be placed;
    ``MeshError`` and ``ConfigError``.
    """
    apart = any(has_legs(dress(pattern, *wearer(False)).pattern) for pattern in patterns)
    body, size = person = wearer(apart)
    dressings = [_dress(pattern, lambda _: person)[0] for pattern in patterns]
    placed = [dressing.pattern for dressing in dressings]
    for number, outer in enumerate(placed):
        if reason := order_fault(placed[:number], outer, size):
            raise PatternError(f"the garments cannot be worn in this order: {reason}")
    start = time.perf_counter()
    meshes = [build_box_mesh(pattern, spacing=resolution) for pattern in placed]
    between = time.perf_counter()
    tucked = [*(is_tucked(inner, outer, size) for inner, outer in pairwise(placed)), False]
    jobs = [
        DrapeJob(
            mesh,
            body,
            size,
            fabric,
            tucked_below=meshes[number + 1].vertices[:, 1].max() if tucked[number] else -math.inf,
            under_sleeves=any(PanelRole.ARM in over.panel_labels for over in meshes[number + 1 :]),
        )
        for number, mesh in enumerate(meshes)
    ]
    drapes = drape_outfit(jobs, device=device)
    seconds = (between - start) / len(jobs), (time.perf_counter() - between) / len(jobs)
    fittings = [
        Fitting(
            one.pattern,
            body,
            one.assumed,
            mesh,
            drape,
            ease_of(one.pattern, mesh, body, size, drape.vertices),
            *seconds,
        )
        for one, mesh, drape in zip(dressings, meshes, drapes, strict=True)
    ]
    garments = [
        WornGarment(one.pattern, {}, one.box_mesh, one.drape, tucked=inside)
        for one, inside in zip(fittings, tucked, strict=True)
    ]
    outfit = worn_outfit(garments, body)
    pattern = replace(joined_pattern(placed), name="outfit")
    mesh, drape = joined_mesh(meshes, [len(one.seams) for one in placed]), joined_drape(drapes)
    return fittings, Fitting(pattern, body, (), mesh, drape, {}, *seconds, outfit=outfit)


def _dress(pattern: Pattern, wearer: Wearer) -> tuple[Dressing, tuple[Body, Measurements]]:
    """The pattern with its panels placed, and the body and measures for which they are placed."""
    legs_apart = has_legs(pattern)
    dressing = dress(pattern, *wearer(legs_apart))
    if has_legs(dressing.pattern) and not legs_apart:  # openings show legs once ``dress`` has placed them
        legs_apart = True
        dressing = dress(pattern, *wearer(legs_apart))
    for sentence in dressing.assumed:
        log.info("%s: %s", pattern.name, sentence)
    return dressing, wearer(legs_apart)


def write_fitting(fitting: Fitting, folder: Path, *, glb: bool = False, device: str = "auto") -> None:
    """Write pictures of a fitting to ``folder``, and unless it diverged OBJ with MTL, PLY, and GLB if ``glb``.

    GLB includes the body; see ``gcd_dataset.exports``. Maps, if it has them, become an NPZ file with the fields of
    ``Maps``, in the order of the PLY's vertices; a motion becomes ``.motion.z`` and a picture of frames in a row, from
    the front and from the side. Raises ``OutputError``.
    """
    from gcd_dataset import exports

    name, mesh, vertices = safe_name(fitting.pattern.name), fitting.box_mesh, fitting.drape.vertices
    make_folder(folder)
    scene, sides = garment_scene(vertices, mesh, fitting.body), ("front", "side", "back")
    pictures = start_plain([scene], size=PICTURE_SIZE, sides=sides, device=device).lend_rgb()
    for side, picture in zip((*sides, "pattern"), (*pictures, draw_pattern(fitting.pattern)), strict=True):
        write_whole(folder / f"{name}_{side}.png", png_bytes(picture))
    if fitting.maps is not None:
        content, maps = io.BytesIO(), fitting.maps
        stretch, gap, pressure = (value.astype(np.float32) for value in (maps.stretch, maps.gap, maps.pressure))
        np.savez(content, stretch=stretch, gap=gap, pressure=pressure, softened=np.float32(maps.softened))
        write_whole(folder / f"{name}_maps.npz", content.getvalue())
    if fitting.motion is not None:
        write_whole(folder / f"{name}.motion.z", encode_motion(fitting.motion))
        write_whole(folder / f"{name}_motion.png", png_bytes(_strip(fitting, device)))
    if np.isfinite(vertices).all():
        exports.obj(fitting, folder / f"{name}.obj", body=False)
        exports.ply(fitting, folder / f"{name}.ply")
        if glb:
            exports.glb(fitting, folder / f"{name}.glb")


def _strip(fitting: Fitting, device: str) -> UInt8[np.ndarray, "h w 3"]:
    """Frames of a motion at equal intervals, from the front, and below from the side."""
    assert fitting.motion is not None
    at = fitting.motion.vertices
    frames = np.unique(np.linspace(0, len(at) - 1, STRIP).round().astype(int)).tolist()
    scenes = [garment_scene(at[frame], fitting.box_mesh, fitting.body_in(frame)) for frame in frames]
    pictures = start_plain(scenes, size=STRIP_SIZE, sides=("front", "side"), device=device).lend_rgb()
    return np.concatenate([np.concatenate(list(pictures[row::2]), axis=1) for row in range(2)])


def write_report(
    done: Iterable[tuple[Path, Fitting | Refusal]],
    path: Path,
    *,
    body: str,
    fabric: str,
    resolution: float,
    device: str,
    fits: Iterable[Fit | None] = repeat(None),
    layers: Sequence[Layer] = (),
    pose: Pose | None = None,
    motion: str | None = None,
) -> None:
    """Write a JSON report: the settings, and the result of each file. Raises ``OutputError``.

    ``fits``: of the files in order, for garments cut for a size; ``layers``: of an outfit of all files; ``motion``: its
    name or file.
    """
    report = {
        "gcd_dataset": __version__,
        "numpy": np.__version__,
        "machine": platform.processor() or platform.machine(),
        "device": device,
        "body": body,
        **({"pose": pose_degrees(pose)} if pose else {}),
        **({"motion": motion} if motion else {}),
        "fabric": fabric,
        "resolution_cm": resolution,
        "garments": [
            {
                "file": str(file),
                **fitting.row,
                "assumed": list(fitting.assumed),
                **({"fit": asdict(fit)} if fit else {}),
            }
            for (file, fitting), fit in zip(done, fits, strict=False)
        ],
        **({"layers": [asdict(layer) for layer in layers]} if layers else {}),
    }
    write_whole(path, (json.dumps(report, indent=2) + "\n").encode())
