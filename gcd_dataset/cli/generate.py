"""``gcd generate``: data sets of garments, of bodies, and of recipes."""

import argparse
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from gcd_dataset.cli import datasets
from gcd_dataset.cli.common import Bar, Parser, add_quiet, add_verb, natural_number, process_count
from gcd_dataset.errors import ConfigError
from gcd_dataset.options import add_options, given_options, options_of, read_options

BODY_STAGE = "body"  # --stage body: bodies in both poses with their measures, no garments


def add_verbs(verbs: Any) -> None:
    """Add ``generate``."""
    again = "The same command continues a stopped run: finished samples are not made again."
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
    generate.add_argument("--log", type=Path, metavar="FILE", help="append progress, rate and memory as lines of JSON")
    generate.add_slow_options = partial(_add_make_options, generate)
    add_quiet(generate)


def _add_make_options(parser: Parser) -> None:
    """Add the options of ``MakeConfig``; its import takes a second."""
    from gcd_dataset.generator.recipe import MakeConfig

    add_options(parser, MakeConfig, more_choices={"stage": (BODY_STAGE,)})


def _generate(options: argparse.Namespace) -> int:
    from gcd_dataset import generate
    from gcd_dataset.generator.recipe import MakeConfig
    from gcd_dataset.making.tasks import parse_job

    job = None if options.job is None else parse_job(options.job)
    unit = "garment"
    if options.recipe is not None:
        work = _recipe_work(options, given_options(options, MakeConfig))
    else:
        if options.count is None:
            raise ConfigError("how many? Give --count N, or --recipe NAME for a data set of that name")
        known = {option.name for option in options_of(MakeConfig)}
        given = read_options(options.config, known) if options.config else {}
        if "design" in given:
            given["design"] = _overlay(options.config, given["design"])
        given |= given_options(options, MakeConfig)
        if given.get("stage") == BODY_STAGE:
            work, unit = _people_work(options, given), "body"
        else:
            work = partial(generate, config=MakeConfig(**given), engine=options.engine)
        work = partial(work, options.out, options.count, seed=options.seed or 0)
    bar = Bar(unit, options.quiet)
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
    from gcd_dataset import generate_recipe

    all_given = {"count": options.count, "seed": options.seed, "config": options.config, **given}
    if fixed := [name for name, value in all_given.items() if value is not None and name != "device"]:
        raise ConfigError(
            f"--{fixed[0].replace('_', '-')} is fixed by the recipe: leave it out, or write a recipe of your own"
        )
    device = given.get("device", "auto")
    return partial(generate_recipe, options.out, options.recipe, device=device, engine=options.engine)


def _people_work(options: argparse.Namespace, given: Mapping[str, Any]) -> Callable[..., Any]:
    """The call that makes bodies. Raises ``ConfigError`` for options of garments."""
    from gcd_dataset import generate_people

    if unused := sorted(given.keys() - {"stage", "bodies"}):
        raise ConfigError(
            f"{unused[0].replace('_', '-')} is for garments, and stage {BODY_STAGE} makes none: leave it out"
        )
    if options.engine != "local":
        raise ConfigError(f"stage {BODY_STAGE} is made on this machine: leave --engine out")
    return partial(generate_people, bodies=given.get("bodies", "random"))


def _overlay(path: Path, values: Any) -> Any:
    """The restrictions on designs in a config file. Raises ``ConfigError`` naming the invalid parameter."""
    from gcd_dataset.generator.garments.overlay import Overlay

    if not isinstance(values, Mapping):
        raise ConfigError(f"{path}: design is {values!r}: write tables such as [design.pants]")
    try:
        return Overlay.from_dict(values)
    except ConfigError as error:
        raise ConfigError(f"{path}: design: {error}") from error
