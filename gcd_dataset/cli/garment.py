"""``gcd drape``, ``fit``, ``grade`` and ``measure``: single garments and bodies."""

import argparse
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gcd_dataset.cli.common import (
    BODY_NAMES,
    Parser,
    add_betas,
    add_body,
    add_height,
    add_quiet,
    add_verb,
    body_name,
    design_in,
    wearer_of,
)
from gcd_dataset.errors import ConfigError, PatternError, shown

if TYPE_CHECKING:
    from gcd_dataset.generator.body.tailor import MeasureResult
    from gcd_dataset.generator.fitting import Refusal
    from gcd_dataset.generator.sized import Cut
    from gcd_dataset.records import Body, Layer, Pattern, Pose

DESIGN_HELP = "GarmentCode's design_params.yaml, or ours"
FPS = 30.0
FABRICS = "denim, drill, interlock, wool_light ...; an unknown name lists them all"


def add_verbs(verbs: Any) -> None:
    """Add ``drape``, ``fit``, ``grade`` and ``measure``."""
    drape = add_verb(
        verbs, "drape", _drape, "drape GarmentCode specification files on a body; exit 1 if one does not settle"
    )
    drape.add_argument(
        "spec", nargs="+", type=Path, metavar="SPEC", help="specification JSON; with --cut-for, a file with a design"
    )
    drape.add_argument(
        "--cut-for",
        metavar="SIZE",
        help="draw the designs in this size of a chart, whatever the body's; report.json names both sizes, and the "
        "rules that a garment breaks on the body",
    )
    drape.add_argument("--sizes", metavar="CHART", help="women, men, or a size chart as TOML (default: women)")
    drape.add_argument(
        "--outfit",
        action="store_true",
        help="wear all garments over each other, in the order given, from the skin outwards; files outfit_front.png, "
        "outfit.obj, …, and their layers in report.json",
    )
    _add_draping(drape)

    fit = add_verb(verbs, "fit", _fit, "draw a design for a body, and drape it; exit 1 if it does not settle")
    fit.add_argument("design", type=Path, metavar="DESIGN", help=DESIGN_HELP)
    _add_draping(fit)

    grade = add_verb(verbs, "grade", _grade, "draw a design in all sizes of a chart; exit 1 if a size is rejected")
    grade.add_argument("design", type=Path, metavar="DESIGN", help=DESIGN_HELP)
    grade.add_argument("--chart", required=True, metavar="CHART", help="women, men, or a size chart as TOML")
    grade.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder for specifications, nested SVG, PDF and DXF"
    )
    grade.add_argument(
        "--seam-allowance", type=float, default=1.0, metavar="CM", help="cloth beyond the sew line (default: 1)"
    )
    grade.add_argument("--paper", default="a4", metavar="NAME", help="of the PDF: a4, letter, a3, a1, a0 (default: a4)")

    _add_measure(verbs)


def _add_draping(drape: Parser) -> None:
    add_body(drape)
    drape.add_argument("--fabric", default="default", metavar="NAME", help=f"{FABRICS} (default: default)")
    drape.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for meshes, pictures, report")
    drape.add_argument(
        "--resolution", type=float, default=1.0, metavar="CM", help="length of mesh edges [cm] (default: 1.0)"
    )
    drape.add_argument("--device", default="auto", help="auto, cpu or cuda:0 (default: auto)")
    drape.add_argument(
        "--glb", action="store_true", help="also the garment on its body as GLB, as gcd export writes it"
    )
    drape.add_argument(
        "--pose",
        metavar="POSE",
        help="move the body to this pose under the garment: t-pose, arms-forward, arms-down, stride, or a JSON file of "
        'bend, spread and twist by bone [degrees], such as {"forearm": [30, 0, 0]}',
    )
    drape.add_argument(
        "--motion",
        metavar="MOTION",
        help="move the body under the garment: a gait, such as walk, stroll or march, a BVH file with CMU's joints, or "
        "an NPZ file of AMASS; NAME.motion.z has all frames, NAME_motion.png shows some, and report.json counts the "
        "crossings of each",
    )
    drape.add_argument("--fps", type=float, metavar="N", help="frames of --motion a second, up to 1000 (default: 30)")
    drape.add_argument(
        "--maps", action="store_true", help="also stretch, gap to the skin and pressure on it, by vertex, as NPZ"
    )
    drape.add_argument(
        "--allow-unsettled",
        action="store_true",
        help="exit 0 even if a garment did not settle: fell, slid off, still moves, crosses itself or the body "
        "(default: exit 1; the report is written either way)",
    )
    add_quiet(drape)


def _add_measure(verbs: Any) -> None:
    measure = add_verb(verbs, "measure", _measure, "the tailor's measures of a body, as YAML [cm, degrees]")
    measure.add_argument(
        "mesh",
        nargs="?",
        metavar="MESH",
        help="OBJ, PLY, STL or GLB of one body in m, cm or mm (or see --height), closed or with small holes",
    )
    measure.add_argument(
        "--shape", type=body_name, metavar="NAME", help=f"{BODY_NAMES} or smplx:MODEL.npz, instead of a mesh"
    )
    measure.add_argument(
        "--landmarks", type=Path, metavar="JSON", help="landmarks by name: vertex id or [x, y, z] as in the mesh file"
    )
    measure.add_argument(
        "--segmentation", type=Path, metavar="JSON", help="vertex ids by body part (default: detected)"
    )
    add_height(measure)
    add_betas(measure)
    measure.add_argument("--out", type=Path, metavar="YAML", help="file for the measures (default: printed)")


def _drape(options: argparse.Namespace, wearer: Callable[[bool], Any] | None = None) -> int:
    from tqdm.auto import tqdm

    from gcd_dataset.files import make_folder
    from gcd_dataset.generator.drape import fabric_named, log_drape_time, resolve_device
    from gcd_dataset.generator.fitting import (
        Fitting,
        Refusal,
        cut_patterns,
        drape_moving,
        drape_patterns,
        drape_together,
        read_patterns,
        write_fitting,
        write_report,
    )
    from gcd_dataset.generator.recipe import check_resolution
    from gcd_dataset.generator.sized import size_or_none
    from gcd_dataset.records import Outcome

    device = resolve_device(options.device)
    resolution, fabric = check_resolution(options.resolution), fabric_named(options.fabric)
    cut = _cut_size(options)
    wearer = wearer or wearer_of(options)
    body, size = wearer(False)  # raises before anything is written
    pose, poses = _pose_of(options, body), _motion_of(options, body)
    cut = cut and replace(cut, wearer_size=size_or_none(cut.chart, size))
    cuts = list(cut_patterns(options.spec, cut, size)) if cut else []
    patterns = (pattern for pattern, _ in cuts) if cut else read_patterns(options.spec)
    for path, (_, fit) in zip(options.spec, cuts, strict=False):
        for label in fit.labels if fit else ():
            print(f"gcd drape: {path}: on this body, {label.rule}: {label.reason}", file=sys.stderr)
    fittings: list[Fitting | Refusal] = []
    layers: Sequence[Layer] = ()
    done: Iterable[Fitting | Refusal]
    together: dict[str, Any] = {"fabric": fabric, "resolution": resolution, "device": device}
    if not poses:
        log_drape_time(len(options.spec), device, resolution)
    if is_outfit := getattr(options, "outfit", False):
        _require_outfit(options)
        done, whole = drape_together(list(map(_require_pattern, patterns)), wearer, **together)
        folder, layers = make_folder(options.out), whole.outfit.layers if whole.outfit else ()
        write_fitting(whole, folder, glb=options.glb, device=device)
    elif poses:
        folder = make_folder(options.out)
        done = drape_moving(patterns, wearer, poses, fps=options.fps or FPS, **together)
    else:
        folder = make_folder(options.out)
        done = drape_patterns(patterns, wearer, maps=options.maps, pose=pose, **together)
    try:
        for fitting in tqdm(done, total=len(options.spec), unit="garment", disable=options.quiet or is_outfit):
            if isinstance(fitting, Fitting) and not is_outfit:
                write_fitting(fitting, folder, glb=options.glb, device=device)
            fittings.append(fitting)
    finally:
        made_by = {"body": options.body, "fabric": options.fabric, "device": device}
        if fittings:
            of_files = zip(options.spec, fittings, strict=False)
            fits = [fit for _, fit in cuts] or repeat(None)
            write_report(
                of_files,
                folder / "report.json",
                resolution=resolution,
                fits=fits,
                layers=layers,
                pose=pose,
                motion=options.motion,
                **made_by,
            )
    failed = False
    for fitting in fittings:
        if isinstance(fitting, Refusal):
            print(f"gcd {options.verb}: {fitting.name}: {fitting.outcome.name}: {fitting.reason}", file=sys.stderr)
            failed = True
            continue
        drape = fitting.drape
        print(
            f"{fitting.pattern.name}: {drape.outcome.name}, {len(drape.vertices)} vertices, "
            f"{drape.self_crossings} self crossings, {drape.body_crossings} edges through the body, "
            f"{drape.body_through} of the body through the cloth, {fitting.drape_seconds:.1f} s"
        )
        if motion := fitting.motion:
            print(f"  {len(motion.poses)} frames, {motion.is_clean.sum()} without a crossing")
        if drape.outcome is not Outcome.SETTLED:
            print(f"  {drape.reason}{': ' if drape.reason else ''}{drape.outcome.value}")
            failed = failed or not options.allow_unsettled
        if options.verb == "fit":
            print(*(f"  {line}" for line in fitting.ease_lines()), sep="\n")
    for layer in layers:
        inner, outer = (options.spec[number] for number in (layer.inner, layer.outer))
        print(f"{outer} over {inner}: {layer.crossings} crossings, {layer.wrong_order:.1%} of it outside")
    print(f"{folder}: meshes, pictures and report.json")
    return int(failed)


def _pose_of(options: argparse.Namespace, body: "Body") -> "Pose | None":
    """The pose of ``--pose``; prints a warning where it cuts the body. Raises ``BodyError``, ``ConfigError``."""
    if options.pose is None:
        return None
    if getattr(options, "outfit", False):
        raise ConfigError("--outfit is for a body in the A-pose: leave it out with --pose")
    from gcd_dataset.generator.body.pose import named_pose, pose_body
    from gcd_dataset.generator.drape.self_contact import skin_crossings

    pose = named_pose(options.pose)
    if cut := skin_crossings(pose_body(body, pose)):
        print(f"gcd {options.verb}: {options.pose}: in this pose the body cuts itself, at {cut} edges", file=sys.stderr)
    return pose


def _motion_of(options: argparse.Namespace, body: "Body") -> "list[Pose] | None":
    """The poses of ``--motion``; prints a warning where they cut the body. Raises ``BodyError``, ``ConfigError``."""
    if options.motion is None:
        if options.fps is not None:
            raise ConfigError("--fps is the rate of a motion: give --motion")
        return None
    if options.maps or getattr(options, "outfit", False):
        raise ConfigError("--maps and --outfit are for a body at rest, --outfit in the A-pose: leave out --motion")
    if options.pose is not None:
        raise ConfigError("--motion begins in a pose of its own: leave --pose out")
    from gcd_dataset.generator.body import GAITS, named_motion, pose_body
    from gcd_dataset.generator.drape.self_contact import skin_crossings
    from gcd_dataset.generator.standing import with_room

    poses = named_motion(options.motion, fps=options.fps or FPS, body=body)
    if options.motion in GAITS and body.posed is None:
        poses = [*with_room(poses, body)]
    if cut := sum(skin_crossings(pose_body(body, pose)) > 0 for pose in poses):
        told = f"the body cuts itself in {cut} of {len(poses)} frames"
        print(f"gcd {options.verb}: {options.motion}: {told}", file=sys.stderr)
    return poses


def _require_outfit(options: argparse.Namespace) -> None:
    """Raise ``ConfigError`` for files and options that make no outfit."""
    from gcd_dataset.generator.outfits import count_fault
    from gcd_dataset.shards.layout import MOST_GARMENTS

    paths = [path.resolve() for path in options.spec]
    if twice := [path for path, real in zip(options.spec, paths, strict=True) if paths.count(real) > 1]:
        raise ConfigError(f"--outfit: {twice[0]} is given twice: give each garment once")
    if not 2 <= len(paths) <= MOST_GARMENTS:
        raise ConfigError(f"--outfit: {count_fault(len(paths))}")
    if options.maps:
        raise ConfigError("--maps are of a garment alone: leave it out with --outfit")


def _require_pattern(pattern: "Pattern | Refusal") -> "Pattern":
    """The pattern. Raises ``PatternError`` for one that cannot be sewn or worn, and so for its outfit."""
    from gcd_dataset.records import Pattern

    if isinstance(pattern, Pattern):
        return pattern
    raise PatternError(f"{pattern.name}: {pattern.reason}")


def _cut_size(options: argparse.Namespace) -> "Cut | None":
    """``--cut-for`` in ``--sizes``. Raises ``ConfigError`` for a size that the chart lacks."""
    if getattr(options, "cut_for", None) is None:
        if getattr(options, "sizes", None) is not None:
            raise ConfigError("--sizes needs the size to cut: give --cut-for SIZE")
        return None
    from gcd_dataset.generator import read_chart
    from gcd_dataset.generator.sized import Cut

    chart = read_chart(options.sizes or "women")
    chart.body(options.cut_for)
    return Cut(chart, options.cut_for, "")


def _fit(options: argparse.Namespace) -> int:
    """Write the pattern of a design for a body, then drape it as ``gcd drape`` does."""
    from gcd_dataset.generator.drape import fabric_named, resolve_device
    from gcd_dataset.generator.fitting import write_drawn
    from gcd_dataset.generator.recipe import check_resolution

    resolve_device(options.device), check_resolution(options.resolution), fabric_named(options.fabric)
    design, wearer = design_in(options.design), wearer_of(options)
    spec, rejects = write_drawn(design, wearer(False)[1], options.out, source=options.design)
    for reject in rejects:
        print(f"gcd fit: {options.design}: on this body, {reject}", file=sys.stderr)
    options.spec = [spec]
    return _drape(options, wearer)


def _grade(options: argparse.Namespace) -> int:
    from gcd_dataset.generator import grade, read_chart
    from gcd_dataset.generator.fitting import garment_name, write_graded
    from gcd_dataset.records import Pattern

    chart = read_chart(options.chart)
    found = grade(design_in(options.design), chart, name=garment_name(options.design))
    graded = {size: pattern for size, pattern in found.items() if isinstance(pattern, Pattern)}
    for size, reject in found.items():
        if size not in graded:
            print(f"gcd grade: {options.design}: size {shown(size)}: {reject}", file=sys.stderr)
    if not graded:
        raise PatternError(f"{options.design}: rejected in all sizes of {chart.source}: change the design")
    write_graded(graded, options.out, seam_allowance=options.seam_allowance, paper=options.paper)
    print(f"{options.out}: {len(graded)} of {len(found)} sizes: specifications, and nests as PDF, DXF and SVG")
    return int(len(graded) < len(found))


def _measure(options: argparse.Namespace) -> int:
    from gcd_dataset.files import write_whole

    if (options.mesh is None) == (options.shape is None):
        raise ConfigError(f"give a mesh file or --shape {BODY_NAMES}, one of them")
    if options.mesh is None and (options.landmarks or options.segmentation or options.height) is not None:
        raise ConfigError("--landmarks, --segmentation and --height are for a mesh file: leave them out with --shape")
    body = options.mesh if options.shape is None else options.shape
    text = measured_text(body, options.landmarks, options.segmentation, options.height, options.betas)
    if options.out is None:
        print(text, end="")
    else:
        write_whole(options.out, text.encode())
        print(*(line for line in text.splitlines() if line.startswith("#")), sep="\n", file=sys.stderr)
        print(options.out)
    return 0


def measured_text(
    body: str,
    landmarks: Path | None = None,
    segmentation: Path | None = None,
    height: float | None = None,
    betas: str | None = None,
) -> str:
    """The measures of a mesh or model file, or of a generated body given by name, as commented YAML.

    Generated bodies are measured in the A-pose with the legs straight. ``height`` [cm] gives the scale of a mesh file,
    ``betas`` the shape of a model file. Errors: see ``named_body``.
    """
    from gcd_dataset.bodyfiles import measurements_text
    from gcd_dataset.generator.body import build_body
    from gcd_dataset.generator.body.by_name import shape_by_name
    from gcd_dataset.generator.body.measuring import measure_closely
    from gcd_dataset.generator.body.mesh_bodies import measure_file

    shape = shape_by_name(body, legs_apart=False)
    if shape is None:
        taken, remarks = measure_file(body, landmarks, segmentation, height=height, betas=betas)
    elif betas is not None:
        raise ConfigError(f"{body}: --betas are the shape of a model file: leave them out, or give smplx:MODEL.npz")
    else:
        taken, remarks = (
            measure_closely(build_body(shape, name=body)),
            ["mesh of the body model: landmarks known by vertex"],
        )
    comments = [f"measures of {shown(body)} [cm, degrees]", *remarks, *_border_remarks(taken)]
    return "".join(f"# {comment}\n" for comment in comments) + measurements_text(taken.measurements)


def _border_remarks(taken: "MeasureResult") -> list[str]:
    """One line for each girth that was measured at the end of its search range."""
    return [
        f"{girth}: measured at height {taken.levels[girth]:.1f} cm, {abs(by):.1f} cm {'above' if by > 0 else 'below'} "
        f"its landmark, {'where the legs part' if girth == 'leg_circ' else 'the end of the search range'}"
        for girth, by in taken.at_border.items()
    ]
