"""``gcd convert`` and ``gcd export``: data sets from and to the forms of others."""

import argparse
import sys
from pathlib import Path
from typing import Any

from gcd_dataset.cli.verb import INTERRUPTED, add_quiet, add_verb, natural, require_folder, stopped
from gcd_dataset.errors import ConfigError

__all__ = ["add_verbs"]

HDF5 = (".h5", ".hdf5")


def add_verbs(verbs: Any) -> None:
    """Give ``gcd`` these verbs."""
    convert = add_verb(verbs, "convert", _convert, "the published GarmentCodeData into shards")
    convert.add_argument("published", type=Path, metavar="PUBLISHED", help="folder with garments_5000_0 and its like")
    convert.add_argument("out", type=Path, metavar="OUT", help="folder for the shards; made if it is not there")
    convert.add_argument(
        "--bodies", choices=("both", "default", "random"), default="both", help="who wears them (default: both)"
    )
    convert.add_argument("--workers", type=natural, default=0, help="processes (default: this one)")
    convert.add_argument(
        "--cache-dir", type=Path, metavar="DIR", help="where indices of archives are kept (default: beside them)"
    )
    add_quiet(convert)

    export = add_verb(verbs, "export", _export, "a data set in the forms of other programs")
    export.add_argument("dataset", metavar="DATASET", help="folder of shards")
    export.add_argument("--hdf5", type=Path, metavar="FILE", help="one split as one HDF5 file")
    export.add_argument(
        "--layout",
        nargs=2,
        metavar=("published", "OUT"),
        help="train, validation and test in the folders of GarmentCodeData; OUT is made if it is not there, "
        "and gone on with where it was stopped",
    )
    export.add_argument("--split", help="split for --hdf5 (default: train)")
    add_quiet(export)


def _convert(options: argparse.Namespace) -> int:
    from tqdm import tqdm

    from gcd_dataset.cli.convert import convert, plan_convert

    faults = 0
    for plan in plan_convert(options.published, options.out, bodies=options.bodies, cache_dir=options.cache_dir):
        there, made, split = plan.there, 0, plan.source.split
        garments = convert(plan, workers=options.workers)
        try:
            bar = tqdm(garments, total=plan.count, initial=there, unit="garment", desc=split, disable=options.quiet)
            for garment in bar:
                made += not garment.fault
                if garment.fault:
                    faults += 1
                    bar.write(f"gcd convert: left out: {garment.fault}", file=sys.stderr)
        except KeyboardInterrupt:
            garments.close()
            return stopped("convert", f"{there + made} of {plan.count} of {split}")
        print(f"{options.out}: {split}: {there + made} garments, {made} of them converted now")
    if faults:
        print(f"gcd convert: {faults} garments were left out; the same command tries them again", file=sys.stderr)
    return 1 if faults else 0


def _export(options: argparse.Namespace) -> int:
    if (options.hdf5 is None) == (options.layout is None):
        raise ConfigError("give --hdf5 FILE or --layout published OUT, one of them")
    if options.layout is not None and options.layout[0] != "published":
        raise ConfigError(f"--layout {options.layout[0]}: there is published")
    if options.layout is not None and options.split is not None:
        raise ConfigError(
            "--split is for --hdf5: --layout takes train, validation and test, whose names go into its split file"
        )
    return _export_hdf5(options) if options.layout is None else _export_layout(options)


def _export_hdf5(options: argparse.Namespace) -> int:
    from tqdm import tqdm

    from gcd_dataset.shards import ShardReader
    from gcd_dataset.shards.hdf5 import write_hdf5

    folder = require_folder(options.dataset)
    if options.hdf5.resolve().is_relative_to(folder.resolve()) and options.hdf5.suffix not in HDF5:
        raise ConfigError(
            f"{options.hdf5}: in the folder of the data set itself: end its name in {HDF5[0]}, or choose another folder"
        )
    reader = ShardReader(folder, "train" if options.split is None else options.split)
    stored = write_hdf5(reader, options.hdf5)
    try:
        for _ in tqdm(stored, total=len(reader), unit="garment", disable=options.quiet):
            pass
    except KeyboardInterrupt:
        stored.close()
        print(f"gcd export: stopped; {options.hdf5} was not written: begin again", file=sys.stderr)
        return INTERRUPTED
    print(f"{options.hdf5}: {len(reader)} garments of {reader.split}")
    return 0


def _export_layout(options: argparse.Namespace) -> int:
    from tqdm import tqdm

    from gcd_dataset.cli.export import export_published, exported_splits

    readers, out = exported_splits(require_folder(options.dataset)), Path(options.layout[1])
    count, there = sum(map(len, readers.values())), 0
    written = export_published(readers, out)
    try:
        for _ in tqdm(written, total=count, unit="garment", disable=options.quiet):
            there += 1
    except KeyboardInterrupt:
        written.close()
        return stopped("export", f"{there} of {count}")
    print(f"{out}: {count} garments of {', '.join(readers)} in the published layout")
    return 0
