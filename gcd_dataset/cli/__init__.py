"""The ``gcd`` command: parses the options, calls one function of the library, prints its result.

Errors are one line on stderr. Exit 2 for wrong usage: an unknown verb, option, value or name, or options that do not
fit each other, this machine or the existing data set. Exit 1 for bad input: missing or damaged files, or files without
the requested content. Exit 130 after Ctrl-C, 143 after SIGTERM.
"""

import argparse
import logging
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from gcd_dataset import __version__
from gcd_dataset.cli import datasets, doctor, exchange, show
from gcd_dataset.cli.bar import Bar
from gcd_dataset.cli.subject import design_in
from gcd_dataset.cli.verb import (
    BODY_NAMES,
    Parser,
    Stopped,
    add_body,
    add_height,
    add_quiet,
    add_verb,
    body_name,
    interrupts_after_imports,
    natural_number,
    process_count,
    wearer_of,
)
from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.files import discard_stdout, user_path
from gcd_dataset.options import add_options, given_options, options_of, read_options

__all__ = ["main"]

FABRICS = "denim, drill, interlock, wool_light ...; an unknown name lists them all"
BODY_STAGE = "body"  # --stage body: bodies in both poses with their measures, no garments


@interrupts_after_imports()
def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``gcd`` with ``arguments`` and return its exit code."""
    name = "gcd"
    try:
        logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
        logging.getLogger("gcd_dataset").setLevel(logging.INFO)
        options = _with_user_paths(_parse(arguments))
        name = f"gcd {options.verb}"
        return int(options.run(options))
    except KeyboardInterrupt as error:
        stopped = Stopped.of(error)
        print(f"{name}: {stopped}", file=sys.stderr)
        return stopped.exit_code
    except ConfigError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 2
    except GcdError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 1
    except BrokenPipeError:
        discard_stdout()
        return 1


# -------------------------------------------------------------------------------------------------------------- verbs


def _generate(options: argparse.Namespace) -> int:
    from gcd_dataset.generator.recipe import MakeConfig
    from gcd_dataset.making.tasks import parse_job
    from gcd_dataset.verbs import generate

    job = None if options.job is None else parse_job(options.job)
    unit = "garment"
    if options.recipe is not None:
        work = _recipe_work(options, given_options(options, MakeConfig))
    else:
        if options.count is None:
            raise ConfigError("how many? Give --count N, or --recipe NAME for a data set of that name")
        known = {option.name for option in options_of(MakeConfig)}
        given = _read_config(options.config, known) if options.config else {}
        given |= given_options(options, MakeConfig)
        if given.get("stage") == BODY_STAGE:
            work, unit = _people_work(options, given), "body"
        else:
            work = partial(generate, config=MakeConfig(**given), engine=options.engine)
        work = partial(work, options.out, options.count, seed=options.seed or 0)
    with Bar(unit, options.quiet) as bar:
        bar.run(partial(work, job=job, workers=options.workers, log=options.log))
    done, what = bar.progress, "bodies in two poses" if unit == "body" else "garments"
    of_job = "" if job is None else f"job {job}: "
    rejected = f", {done.rejects.total()} designs or drapes rejected" if unit == "garment" else ""
    print(f"{options.out}: {of_job}{done.count} {what}, {done.made} of them made now{rejected}")
    if failed := done.unsettled:
        print(f"  {failed} did not settle: their outcomes are in meta.json")
    for line in datasets.summary_lines(options.out):
        print(f"  {line}")
    return 0


def _recipe_work(options: argparse.Namespace, given: Mapping[str, Any]) -> Callable[..., Any]:
    """The call that makes the data set of a recipe. Raises ``ConfigError`` for options that the recipe fixes."""
    from gcd_dataset.verbs import generate_recipe

    all_given = {"count": options.count, "seed": options.seed, "config": options.config, **given}
    if fixed := [name for name, value in all_given.items() if value is not None and name != "device"]:
        raise ConfigError(
            f"--{fixed[0].replace('_', '-')} is fixed by the recipe: leave it out, or write a recipe of your own"
        )
    device = given.get("device", "auto")
    return partial(generate_recipe, options.out, options.recipe, device=device, engine=options.engine)


def _people_work(options: argparse.Namespace, given: Mapping[str, Any]) -> Callable[..., Any]:
    """The call that makes bodies. Raises ``ConfigError`` for options of garments."""
    from gcd_dataset.verbs import generate_people

    if unused := sorted(given.keys() - {"stage", "bodies"}):
        raise ConfigError(
            f"{unused[0].replace('_', '-')} is for garments, and stage {BODY_STAGE} makes none: leave it out"
        )
    if options.engine != "local":
        raise ConfigError(f"stage {BODY_STAGE} is made on this machine: leave --engine out")
    return partial(generate_people, bodies=given.get("bodies", "random"))


def _drape(options: argparse.Namespace, wearer: Callable[[bool], Any] | None = None) -> int:
    from tqdm.auto import tqdm

    from gcd_dataset.files import make_folder
    from gcd_dataset.generator.drape import fabric_named, log_drape_time, resolve_device
    from gcd_dataset.generator.fitting import (
        Fitting,
        Refusal,
        drape_patterns,
        read_patterns,
        write_fitting,
        write_report,
    )
    from gcd_dataset.generator.recipe import check_resolution
    from gcd_dataset.records import Outcome

    patterns, device = read_patterns(options.spec), resolve_device(options.device)
    resolution, fabric = check_resolution(options.resolution), fabric_named(options.fabric)
    wearer = wearer or wearer_of(options)
    wearer(False)  # raises before anything is written
    folder = make_folder(options.out)
    fittings: list[Fitting | Refusal] = []
    log_drape_time(len(options.spec), device, resolution)
    try:
        done = drape_patterns(patterns, wearer, fabric=fabric, resolution=resolution, device=device)
        for fitting in tqdm(done, total=len(options.spec), unit="garment", disable=options.quiet):
            if isinstance(fitting, Fitting):
                write_fitting(fitting, folder, glb=options.glb, device=device)
            fittings.append(fitting)
    finally:
        made_by = {"body": options.body, "fabric": options.fabric, "device": device}
        if fittings:
            of_files = zip(options.spec, fittings, strict=False)
            write_report(of_files, folder / "report.json", resolution=resolution, **made_by)
    failed = False
    for fitting in fittings:
        if isinstance(fitting, Refusal):
            print(f"gcd {options.verb}: {fitting.name}: REFUSED: {fitting.reason}", file=sys.stderr)
            failed = True
            continue
        drape = fitting.drape
        print(
            f"{fitting.pattern.name}: {drape.outcome.name}, {len(drape.vertices)} vertices, "
            f"{drape.self_crossings} self crossings, {drape.body_crossings} edges through the body, "
            f"{drape.body_through} of the body through the cloth, {fitting.drape_seconds:.1f} s"
        )
        if drape.outcome is not Outcome.SETTLED:
            print(f"  {drape.reason}{': ' if drape.reason else ''}{drape.outcome.value}")
            failed = failed or not options.allow_unsettled
    print(f"{folder}: meshes, pictures and report.json")
    return int(failed)


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


def _measure(options: argparse.Namespace) -> int:
    from gcd_dataset.cli.measure import measured_text
    from gcd_dataset.files import write_whole

    if (options.mesh is None) == (options.shape is None):
        raise ConfigError(f"give a mesh file or --shape {BODY_NAMES}, one of them")
    if options.mesh is None and (options.landmarks or options.segmentation or options.height) is not None:
        raise ConfigError("--landmarks, --segmentation and --height are for a mesh file: leave them out with --shape")
    body = options.mesh if options.shape is None else options.shape
    text = measured_text(body, options.landmarks, options.segmentation, options.height)
    if options.out is None:
        print(text, end="")
    else:
        write_whole(options.out, text.encode())
        print(*(line for line in text.splitlines() if line.startswith("#")), sep="\n", file=sys.stderr)
        print(options.out)
    return 0


def _validate(options: argparse.Namespace) -> int:
    from gcd_dataset.spec import read_pattern
    from gcd_dataset.validate import Severity, check_pattern

    found: list[Severity] = []
    paths = dict.fromkeys(options.spec)
    for path in paths:
        try:
            faults = check_pattern(read_pattern(path))
        except GcdError as error:
            print(f"gcd validate: {error}", file=sys.stderr)
            found.append(Severity.ERROR)
            continue
        listed = [fault for fault in faults if fault.severity is Severity.ERROR or not options.errors]
        if listed:
            print(f"{path}:", *listed, sep="\n  ")
        found += [fault.severity for fault in listed]
    if not found:
        print(f"{len(paths)} pattern{'s' if len(paths) > 1 else ''}: no fault found")
    return 1 if found and (options.strict or Severity.ERROR in found) else 0


# ------------------------------------------------------------------------------------------------------------- options


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The options of a command line. Exits 2 for wrong usage."""
    parser, verbs = _parser()
    options, left = parser.parse_known_args(arguments)
    if left:
        verbs[options.verb].unknown(left)
    return options


def _parser() -> tuple[Parser, Mapping[str, Parser]]:
    """The parser of ``gcd``, and the parser of each verb by name."""
    parser = Parser(prog="gcd", description="Made-to-measure garments with their sewing patterns.")
    parser.add_argument("--version", action="version", version=f"gcd_dataset {__version__}")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")

    again = (
        "The same command continues a stopped run, and with a larger --count a folder grows:\n"
        "finished samples are not made again."
    )
    generate = add_verb(verbs, "generate", _generate, "make a data set", again)
    generate.add_argument(
        "out", metavar="OUT", help="folder for the shards, created if missing; or a URL such as s3://BUCKET/PREFIX"
    )
    generate.add_argument("--count", type=natural_number, metavar="N", help="number of garments, or of bodies")
    generate.add_argument("--seed", type=natural_number, help="seed of all random numbers (default: 0)")
    generate.add_argument(
        "--recipe",
        metavar="NAME|FILE.toml",
        help="make the data set of a recipe, which fixes count, seed, options and splits; gcd info recipe: lists them",
    )
    generate.add_argument(
        "--workers",
        type=process_count,
        metavar="K|auto",
        help="processes that make garments; on each GPU two more drape them (default: auto, one for each core); with "
        "--engine ray: shards in work at a time (default: as many as the cluster has room for)",
    )
    generate.add_argument(
        "--engine",
        choices=("local", "ray"),
        default="local",
        help="local: this machine; ray: the Ray cluster at RAY_ADDRESS, one that runs on this machine, or a new local "
        "one; needs pip install 'gcd-dataset[ray]' (default: local)",
    )
    generate.add_argument(
        "--config",
        type=Path,
        metavar="FILE.toml",
        help="file with these options, and tables such as [design.pants] that restrict the design parameters",
    )
    generate.add_argument(
        "--job",
        metavar="I/N",
        help="for array jobs: make every N-th shard only, from shard I on, I from 0 to N-1; jobs may run at the same "
        "time, on any machines that share OUT, and the last one writes manifest and index (default: all shards)",
    )
    generate.add_argument(
        "--log", type=Path, metavar="FILE", help="append progress, rate, waits and memory as lines of JSON"
    )
    generate.add_slow_options = partial(_add_make_options, generate)
    add_quiet(generate)

    _add_drape(verbs)
    _add_measure(verbs)

    validate = add_verb(verbs, "validate", _validate, "list the faults of patterns; exit 1 if one forbids sewing")
    validate.add_argument("spec", nargs="+", type=Path, metavar="SPEC", help="specification JSON")
    validate.add_argument("--errors", action="store_true", help="only faults that forbid sewing, no warnings")
    validate.add_argument("--strict", action="store_true", help="exit 1 for warnings too")

    show.add_verbs(verbs)
    datasets.add_verbs(verbs)
    doctor.add_verbs(verbs)
    exchange.add_verbs(verbs)
    return parser, verbs.choices


def _add_drape(verbs: Any) -> None:
    drape = add_verb(
        verbs, "drape", _drape, "drape GarmentCode specification files on a body; exit 1 if one does not settle"
    )
    drape.add_argument("spec", nargs="+", type=Path, metavar="SPEC", help="specification JSON")
    _add_draping(drape)

    fit = add_verb(verbs, "fit", _fit, "draw a design for a body, and drape it; exit 1 if it does not settle")
    fit.add_argument("design", type=Path, metavar="DESIGN", help="GarmentCode's design_params.yaml, or ours")
    _add_draping(fit)


def _add_draping(drape: Parser) -> None:
    """Add the options of ``_drape``."""
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
    measure.add_argument("--shape", type=body_name, metavar="NAME", help=f"{BODY_NAMES}, instead of a mesh")
    measure.add_argument(
        "--landmarks", type=Path, metavar="JSON", help="landmarks by name: vertex id or [x, y, z] as in the mesh file"
    )
    measure.add_argument(
        "--segmentation", type=Path, metavar="JSON", help="vertex ids by body part (default: detected)"
    )
    add_height(measure)
    measure.add_argument("--out", type=Path, metavar="YAML", help="file for the measures (default: printed)")


def _add_make_options(parser: Parser) -> None:
    """Add the options of ``MakeConfig``; its import takes a second."""
    from gcd_dataset.generator.recipe import MakeConfig

    add_options(parser, MakeConfig, more_choices={"stage": (BODY_STAGE,)})


def _with_user_paths(options: argparse.Namespace) -> argparse.Namespace:
    """The options with a leading ``~`` expanded in every path: shells do not expand ``--out=~/x``."""
    return argparse.Namespace(**{name: _expanded(value) for name, value in vars(options).items()})


def _expanded(value: Any) -> Any:
    if isinstance(value, list):
        return [_expanded(entry) for entry in value]
    return type(value)(user_path(value)) if isinstance(value, str | Path) and str(value).startswith("~") else value


def _read_config(path: Path, known: set[str]) -> dict[str, Any]:
    """The options in a TOML file. Raises ``ConfigError`` with the line, or the unknown name."""
    values = read_options(path, known)
    if "design" in values:
        values["design"] = _overlay(path, values["design"])
    return values


def _overlay(path: Path, values: Any) -> Any:
    """The restrictions on designs in a config file. Raises ``ConfigError`` naming the invalid parameter."""
    from gcd_dataset.generator.garments.overlay import Overlay

    if not isinstance(values, Mapping):
        raise ConfigError(f"{path}: design is {values!r}: write tables such as [design.pants]")
    try:
        return Overlay.from_dict(values)
    except ConfigError as error:
        raise ConfigError(f"{path}: design: {error}") from error
