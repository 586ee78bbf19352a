"""``gcd reconstruct``: the pattern of a scan or of pictures, by draping."""

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gcd_dataset.cli.common import add_body, add_quiet, add_verb, natural_number, wearer_of
from gcd_dataset.errors import BodyError, ConfigError, DrapeError, GcdError

if TYPE_CHECKING:
    from gcd_dataset.bodies import Wearer
    from gcd_dataset.generator.garments import GarmentDesign
    from gcd_dataset.records import BodyShape

POINTS = 8192  # of a scan
DRAWN = 256  # random designs, where none are proposed
UNFITTED = GcdError("its wearer was not fitted, since a worker was killed: repeat the command")
DESIGNS, MEASURES = "*_design_params.yaml", "*_measurements.yaml"


def add_verbs(verbs: Any) -> None:
    """Add ``reconstruct``."""
    verb = add_verb(
        verbs, "reconstruct", _reconstruct, "find the pattern of scans and pictures by draping; exit 1 if one has none"
    )
    verb.add_argument(
        "scan",
        nargs="+",
        type=Path,
        metavar="SCAN",
        help="mesh or points of a garment [cm], y up, facing z: see gcd score; or a folder of pictures of one, cut "
        "out, with cameras: docs/reconstruction.md",
    )
    verb.add_argument(
        "--proposals",
        type=Path,
        metavar="DIR",
        help=f"folder with a folder for each scan, named after its file: {DESIGNS}, tried first, and {MEASURES}, the "
        f"wearer without --body (default: {DRAWN} random designs)",
    )
    verb.add_argument("--partial", action="store_true", help="a scan shows a part of its garment, such as one side")
    verb.add_argument(
        "--rounds",
        type=natural_number,
        choices=range(5),
        default=4,
        metavar="N",
        help="of refinement, 0 to 4 (default: 4)",
    )
    add_body(verb, default=None)
    verb.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for patterns, drapes, report")
    verb.add_argument(
        "--resolution", type=float, default=2.0, metavar="CM", help="length of mesh edges [cm] (default: 2)"
    )
    verb.add_argument("--device", default="auto", help="auto, cpu or cuda:0 (default: auto)")
    verb.add_argument("--workers", type=natural_number, default=0, metavar="K", help="processes (default: 0)")
    add_quiet(verb)


def _reconstruct(options: argparse.Namespace) -> int:
    from tqdm.auto import tqdm

    from gcd_dataset.files import make_folder, write_whole
    from gcd_dataset.generator.drape import resolve_device
    from gcd_dataset.generator.fitting import garment_name
    from gcd_dataset.generator.recipe import check_resolution
    from gcd_dataset.release.published_names import ENDINGS
    from gcd_dataset.workers import parallel_map, process_pool

    resolve_device(options.device), check_resolution(options.resolution)
    _require_own_names(options.scan, options.out)
    wearer = wearer_of(argparse.Namespace(**{**vars(options), "body": options.body or "neutral"}))
    wearer(False)  # an error of --body is no error of a scan
    rows, folder = list[dict[str, Any]](), make_folder(options.out)
    proposals = None if options.body or options.measurements else options.proposals
    with process_pool(options.workers) if options.workers > 1 else nullcontext(1) as pool:
        shapes = parallel_map(partial(_proposed_shape, proposals), options.scan, pool)  # while others are searched
        for scan in tqdm(options.scan, unit="scan", disable=options.quiet):
            row: dict[str, Any] = {"error": "stopped before its design was found"}
            for ending in (ENDINGS["spec"], DESIGNS[1:]):  # an answer of an earlier run
                (folder / f"{garment_name(scan)}{ending}").unlink(missing_ok=True)
            try:
                row = _reconstruct_one(scan, options, wearer, next(shapes, UNFITTED), pool)
                apart = (
                    "{mean_cm:.2f} cm on average, 95 % within {p95_cm:.2f} cm" if "mean_cm" in row else "IoU {iou:.3f}"
                )
                print(f"{scan.stem}: {apart.format_map(row)}, {row['seconds']:.1f} s")
            except GcdError as error:
                told = str(error) if str(error).startswith(str(scan)) else f"{scan}: {error}"
                row = {"error": told}
                print(f"gcd reconstruct: {told}", file=sys.stderr)
            finally:
                rows.append({"scan": str(scan), **row})
                write_whole(folder / "report.json", (json.dumps({"scans": rows}, indent=1) + "\n").encode())
    print(f"{folder}: patterns, designs, drapes and report.json")
    return int(any("error" in row for row in rows))


def _require_own_names(scans: Sequence[Path], out: Path) -> None:
    """Raise ``ConfigError`` if the files of a scan would replace it, or those of another scan."""
    from gcd_dataset.generator.fitting import garment_name

    named: dict[str, Path] = {}
    for scan in scans:
        other = named.setdefault(garment_name(scan).casefold(), scan)
        if other is not scan:
            raise ConfigError(f"{scan}: named as {other}, whose files it would replace: rename one of them")
        if scan.parent.resolve() == out.resolve():
            raise ConfigError(f"{scan}: lies in --out {out}, where files have its name: give another folder")


def _proposed_shape(proposals: Path | None, scan: Path) -> "BodyShape | GcdError | None":
    """The body of the measures that are proposed for a scan; ``None`` without."""
    from gcd_dataset.bodyfiles import read_measurements
    from gcd_dataset.generator.body import fit_shape

    measures = sorted((proposals / scan.stem).glob(MEASURES)) if proposals else []
    try:
        return fit_shape(read_measurements(measures[0])).shape if measures else None
    except BodyError as error:
        return BodyError(f"{measures[0]}: {error}")
    except GcdError as error:
        return error


def _reconstruct_one(
    scan: Path, options: argparse.Namespace, wearer: "Wearer", proposed: "BodyShape | GcdError | None", pool: Any
) -> dict[str, Any]:
    """Find the design of a scan and write it; the row of the report. Raises ``GcdError``.

    ``wearer``: if none is ``proposed``.
    """
    from gcd_dataset.files import write_whole
    from gcd_dataset.generator.drawing import png_bytes
    from gcd_dataset.generator.fitting import (
        Refusal,
        drape_patterns,
        garment_name,
        read_patterns,
        write_drawn,
        write_fitting,
    )
    from gcd_dataset.generator.garments.design import write_design
    from gcd_dataset.generator.search import ROUNDS, ScanPoints, search
    from gcd_dataset.generator.silhouettes import Silhouettes
    from gcd_dataset.scoring.distances import Cloud, MeshShape, mean_and_p95, read_points

    begun = time.perf_counter()
    target = (
        Silhouettes.read(scan, device=options.device)
        if scan.is_dir()
        else ScanPoints.of(read_points(scan, POINTS), partial=options.partial)
    )
    designs, wearer, shape = _proposed(scan, options, wearer, proposed)
    found = search(
        target, designs, wearer, ranked=options.proposals is not None,
        rounds=ROUNDS[: options.rounds], resolution=options.resolution, device=options.device, workers=pool,
    )  # fmt: skip
    seconds, design, name = time.perf_counter() - begun, found.drape.design, garment_name(scan)
    spec, rejects = write_drawn(design, wearer(False)[1], options.out, source=scan)
    write_design(design, options.out / f"{name}_design_params.yaml")
    if shape is not None:  # else the wearer is a mesh
        _write_body(shape, options.out / name)
    [fitting] = drape_patterns(read_patterns([spec]), wearer, resolution=options.resolution, device=options.device)
    if isinstance(fitting, Refusal):
        raise DrapeError(f"{scan}: {fitting.reason}")
    write_fitting(fitting, options.out, device=options.device)
    if isinstance(target, Silhouettes):
        seen = fitting.box_mesh, fitting.drape.vertices, fitting.body
        write_whole(options.out / f"{name}_pictures.png", png_bytes(target.beside(*seen)))
        apart = {"iou": round(float(target.overlaps(*seen).mean()), 3)}
    else:
        surface = MeshShape.of(fitting.drape.vertices, fitting.box_mesh.faces)
        mean, p95 = mean_and_p95(Cloud.of(target.points), surface, both_ways=not options.partial)
        apart = {"mean_cm": round(mean, 3), "p95_cm": round(p95, 3)}
    return {
        **apart, "outcome": fitting.drape.outcome.name, "remarks": [str(reject) for reject in rejects],
        "seconds": round(seconds, 1),
    }  # fmt: skip


def _proposed(
    scan: Path, options: argparse.Namespace, wearer: "Wearer", proposed: "BodyShape | GcdError | None"
) -> "tuple[Iterator[GarmentDesign], Wearer, BodyShape | None]":
    """Designs to begin with, the wearer, and its shape, ``None`` for a mesh. Raises ``GcdError``."""
    from gcd_dataset.generator.body import build_body, measure
    from gcd_dataset.generator.body.by_name import shape_by_name
    from gcd_dataset.generator.garments import read_design
    from gcd_dataset.generator.garments.sampling import attempted_design

    folder = options.proposals and options.proposals / scan.stem
    files = sorted(folder.glob(DESIGNS)) if folder else []
    if folder and not files:
        raise ConfigError(f"{folder}: no {DESIGNS}: propose designs for {scan}, or leave --proposals out")
    shape = shape_by_name(options.body or "neutral", legs_apart=False)
    if isinstance(proposed, GcdError):
        raise proposed
    if proposed is not None:
        shape = proposed
        bodies = [build_body(replace(shape, legs_apart=apart)) for apart in (False, True)]
        fitted = measure(bodies[False])
        wearer = lambda legs_apart: (bodies[legs_apart], fitted)  # noqa: E731
    if files:
        return map(read_design, files), wearer, shape
    size = wearer(False)[1]
    return (attempted_design(0, number, 0, (size,)).design for number in range(DRAWN)), wearer, shape


def _write_body(shape: "BodyShape", stem: Path) -> None:
    """The weights and the pose, as ``gcd score`` reads them."""
    import io

    import numpy as np

    from gcd_dataset.files import write_whole

    content = io.BytesIO()
    np.save(content, shape.weights)
    write_whole(stem.with_name(f"{stem.name}.npy"), content.getvalue())
    pose = json.dumps({"pose": {"arm_angle": shape.arm_angle}})
    write_whole(stem.with_name(f"{stem.name}.meta.json"), pose.encode())
