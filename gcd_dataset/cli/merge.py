"""Data sets made in parts: ``gcd generate --shard`` and ``gcd merge``."""

import argparse
import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gcd_dataset.cli.bar import Bar
from gcd_dataset.cli.verb import add_quiet, add_verb, require_folder
from gcd_dataset.errors import ConfigError, shown

if TYPE_CHECKING:
    from gcd_dataset.verbs import JobPart

__all__ = ["add_shard", "add_verbs", "parse_part", "summary_lines"]

SLURM, TASK = "SLURM", "SLURM_ARRAY_TASK_ID"


def add_verbs(verbs: Any) -> None:
    """Add the verb ``merge`` to ``gcd``."""
    merge = add_verb(verbs, "merge", _merge, "join the parts made by gcd generate --shard; same bytes as a single run")
    merge.add_argument("out", metavar="OUT", help="folder of the parts; all must be finished")
    add_quiet(merge)


def add_shard(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--shard`` to ``gcd generate``."""
    parser.add_argument(
        "--shard",
        metavar="I/N",
        help=f"make only part I of N, I from 0 to N-1, for gcd merge; all parts go to the same OUT; {SLURM}/N takes I "
        f"from {TASK} (default: the whole data set)",
    )


def parse_part(text: str) -> "JobPart":
    """The part written as ``I/N`` or ``SLURM/N``. Raises ``ConfigError``."""
    from gcd_dataset.verbs import JobPart

    number, _, of = text.partition("/")
    try:
        if number.upper() != SLURM:
            return JobPart.parse(text)
        array = f"submit it with sbatch --array=0-{JobPart.parse(f'0/{of}').of - 1}"
        if (task := os.environ.get(TASK)) is None:
            raise ConfigError(f"{TASK} is not set: {array}, or give I/{of}")
        try:
            return JobPart.parse(f"{task}/{of}")
        except ConfigError as error:
            raise ConfigError(f"{TASK} is {shown(task)}: {array}") from error
    except ConfigError as error:
        raise ConfigError(f"--shard {shown(text)}: {error}") from error


def summary_lines(out: Path | str, part: "JobPart | None") -> Iterator[str]:
    """Lines printed after a run: samples by split if there are several, and the next step for parts."""
    from gcd_dataset.shards.job_parts import part_folder, parts_waiting
    from gcd_dataset.shards.manifest import read_manifest

    if "://" in str(out):
        return
    out = Path(out)
    manifest = read_manifest(out if part is None else part_folder(out, part.number, part.of))
    if manifest is not None and len(manifest.counts) > 1:
        yield ", ".join(f"{split} {count}" for split, count in sorted(manifest.counts.items(), reverse=True))
    waiting = None if part is None else parts_waiting(out)
    if waiting is not None:
        yield waiting
    elif part is not None:
        yield "the data set is already merged and complete"


def _merge(options: argparse.Namespace) -> int:
    from gcd_dataset.verbs import merge

    folder = require_folder(options.out)
    with Bar("garment", options.quiet, verb="merge") as bar:
        counts = bar.run(partial(merge, folder))
    splits = ", ".join(f"{split} {count}" for split, count in sorted(counts.items(), reverse=True))
    print(f"{folder}: {sum(counts.values())} garments: {splits}")
    return 0
