"""``gcd doctor``: what in a data set would harm a training."""

import argparse
import json
from functools import partial
from pathlib import Path
from typing import Any

from gcd_dataset.cli.bar import Bar
from gcd_dataset.cli.verb import SOURCE_HELP, add_quiet, add_server, add_verb


def add_verbs(verbs: Any) -> None:
    """Add this verb to ``gcd``."""
    doctor = add_verb(verbs, "doctor", _doctor, "list what in a data set would harm a training; exit 1 if anything")
    doctor.add_argument(
        "dataset",
        metavar="DATASET|PUBLISHED",
        help=f"{SOURCE_HELP}; an HDF5 file; or GarmentCodeData as published: the folder with garments_5000_0",
    )
    doctor.add_argument("--quick", action="store_true", help="read 200 garments of each split, evenly spaced")
    doctor.add_argument("--json", action="store_true", help="print the report as JSON")
    doctor.add_argument(
        "--cache-dir",
        type=Path,
        metavar="DIR",
        help="folder for data from a server, and for the indices of published archives",
    )
    add_quiet(doctor)
    add_server(doctor)


def _doctor(options: argparse.Namespace) -> int:
    from gcd_dataset.verbs import doctor

    with Bar("garment", options.quiet, verb="doctor", again="nothing was changed") as bar:
        work = partial(doctor, options.dataset, quick=options.quick, endpoint=options.endpoint)
        report = bar.run(partial(work, cache_dir=options.cache_dir))
    if options.json:
        print(json.dumps(report.to_json(), indent=1, ensure_ascii=False))
    else:
        print(*report.lines(), sep="\n")
    return 1 if report.harmful else 0
