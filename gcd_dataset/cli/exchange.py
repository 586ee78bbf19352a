"""``gcd convert`` and ``gcd export``: data sets from and to other formats."""

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import Any

from gcd_dataset.cli.bar import Bar
from gcd_dataset.cli.verb import INTERRUPTED, add_quiet, add_verb, natural_number, require_folder, stopped
from gcd_dataset.errors import ConfigError

__all__ = ["add_verbs"]


def add_verbs(verbs: Any) -> None:
    """Add these verbs to ``gcd``."""
    convert = add_verb(verbs, "convert", _convert, "convert the published GarmentCodeData to shards")
    convert.add_argument("published", type=Path, metavar="PUBLISHED", help="folder with garments_5000_0 and the like")
    convert.add_argument("out", type=Path, metavar="OUT", help="folder for the shards; created if missing")
    convert.add_argument(
        "--bodies", choices=("both", "default", "random"), default="both", help="bodies of the garments (default: both)"
    )
    convert.add_argument("--workers", type=natural_number, default=0, help="processes (default: this one)")
    convert.add_argument(
        "--cache-dir", type=Path, metavar="DIR", help="folder for the indices of archives (default: beside them)"
    )
    add_quiet(convert)

    export = add_verb(verbs, "export", _export, "write a data set in another format")
    export.add_argument("dataset", metavar="DATASET", help="folder of shards")
    export.add_argument("--hdf5", type=Path, metavar="FILE", help="one split as one HDF5 file")
    export.add_argument(
        "--layout",
        nargs=2,
        metavar=("published", "OUT"),
        help="train, validation and test in the folders of GarmentCodeData; OUT is created if missing; "
        "the same command resumes a stopped export",
    )
    export.add_argument("--split", help="split for --hdf5 (default: train)")
    add_quiet(export)


def _convert(options: argparse.Namespace) -> int:
    from gcd_dataset.verbs import convert

    work = partial(convert, options.published, options.out, bodies=options.bodies, workers=options.workers)
    with Bar("garment", options.quiet, verb="convert") as bar:
        splits = bar.run(partial(work, cache_dir=options.cache_dir))
    if bar.interrupted:
        return stopped("convert", f"{bar.progress.done} of {bar.progress.count} of {bar.progress.split}")
    for done in splits:
        print(f"{options.out}: {done.split}: {done.done} garments, {done.made} of them converted now")
    if faults := sum(len(done.skipped) for done in splits):
        print(f"gcd convert: {faults} garments were skipped; the same command tries them again", file=sys.stderr)
    return 1 if faults else 0


def _export(options: argparse.Namespace) -> int:
    if (options.hdf5 is None) == (options.layout is None):
        raise ConfigError("give --hdf5 FILE or --layout published OUT, one of them")
    if options.layout is not None and options.layout[0] != "published":
        raise ConfigError(f"--layout {options.layout[0]}: unknown layout: give published")
    if options.layout is not None and options.split is not None:
        raise ConfigError(
            "--split is for --hdf5: --layout takes train, validation and test, and lists them in its split file"
        )
    from gcd_dataset.verbs import export
    from gcd_dataset.verbs.exporting import Form

    form: Form = "hdf5" if options.layout is None else "published"
    out = options.hdf5 if options.layout is None else Path(options.layout[1])
    with Bar("garment", options.quiet, verb="export") as bar:
        bar.run(partial(export, require_folder(options.dataset), out, form, split=options.split))
    done = bar.progress
    if bar.interrupted and form == "hdf5":
        print(f"gcd export: stopped; {out} was not written: start again", file=sys.stderr)
        return INTERRUPTED
    if bar.interrupted:
        return stopped("export", f"{done.made} of {done.count}")
    layout = "" if form == "hdf5" else " in the published layout"
    print(f"{out}: {done.count} garments of {done.split}{layout}")
    return 0
