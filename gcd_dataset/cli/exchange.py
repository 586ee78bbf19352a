"""``gcd convert`` and ``gcd export``: data sets from and to other formats."""

import argparse
import sys
from collections.abc import Callable, Iterable
from functools import cache, partial
from pathlib import Path
from typing import Any

from gcd_dataset.cli.common import (
    SOURCE_HELP,
    Bar,
    add_quiet,
    add_server,
    add_texture,
    add_verb,
    names_a_file,
    natural_number,
    require_folder,
    sample_of,
    textures_of,
)
from gcd_dataset.cli.datasets import summary_lines
from gcd_dataset.errors import ConfigError, PatternError, ShardError


def add_verbs(verbs: Any) -> None:
    """Add these verbs to ``gcd``."""
    again = (
        "The same command continues a stopped conversion; after further batches are downloaded, convert to another "
        "folder."
    )
    convert = add_verb(verbs, "convert", _convert, "convert the published GarmentCodeData to shards", again)
    convert.add_argument("published", type=Path, metavar="PUBLISHED", help="folder with garments_5000_0 and the like")
    convert.add_argument("out", type=Path, metavar="OUT", help="folder for the shards; created if missing")
    convert.add_argument(
        "--bodies", choices=("both", "default", "random"), default="both", help="bodies of the garments (default: both)"
    )
    convert.add_argument("--workers", type=natural_number, default=0, help="processes (default: this one)")
    convert.add_argument(
        "--cache-dir", type=Path, metavar="DIR", help="folder for unpacked archives (default: beside them)"
    )
    add_quiet(convert)

    _add_export(verbs)


def _add_export(verbs: Any) -> None:
    export = add_verb(verbs, "export", _export, "write a data set, a garment or a pattern in another format")
    export.add_argument("what", nargs="+", metavar="DATASET|SPEC", help=f"{SOURCE_HELP}; or specification JSON")
    export.add_argument("--hdf5", type=Path, metavar="FILE", help="one split as one HDF5 file")
    export.add_argument(
        "--plain", type=Path, metavar="OUT", help="one split as tars of .npy files, texts and pictures in a folder"
    )
    export.add_argument(
        "--layout",
        nargs=2,
        metavar=("published", "OUT"),
        help="train, validation and test in the folders of GarmentCodeData; OUT is created if missing; "
        "the same command resumes a stopped export",
    )
    export.add_argument("--glb", type=Path, metavar="FILE", help="a draped garment on its body, as binary glTF [m]")
    export.add_argument("--obj", type=Path, metavar="FILE", help="the same as OBJ and MTL [cm]")
    export.add_argument("--ply", type=Path, metavar="FILE", help="the draped garment as PLY [cm]")
    export.add_argument(
        "--usd", type=Path, metavar="FILE", help="a draped garment, its body and its seams, as USD [cm]"
    )
    export.add_argument("--dxf", type=Path, metavar="FILE", help="a pattern as DXF in the layers of AAMA and ASTM [mm]")
    export.add_argument("--pdf", type=Path, metavar="FILE", help="a pattern at true scale, tiled on pages")
    export.add_argument("--index", type=natural_number, help="which sample of the split (default: 0)")
    export.add_argument("--split", help="split of the data set (default: train); not with --layout")
    export.add_argument(
        "--seam-allowance", type=float, metavar="CM", help="for --dxf and --pdf: cloth beyond the sew line (default: 1)"
    )
    export.add_argument("--paper", metavar="NAME", help="for --pdf: a4, letter, a3, a1 or a0 (default: a4)")
    export.add_argument(
        "--tile", type=float, metavar="CM", help="for --glb, --obj and --usd: cloth that a texture covers (default: 10)"
    )
    export.add_argument("--no-body", action="store_true", help="for --glb, --obj and --usd: the garment alone")
    add_texture(export, form="--glb")
    add_quiet(export)
    add_server(export)


def _convert(options: argparse.Namespace) -> int:
    from gcd_dataset import convert

    work = partial(convert, options.published, options.out, bodies=options.bodies, workers=options.workers)
    done = Bar("garment", options.quiet, verb="convert").run(partial(work, cache_dir=options.cache_dir))
    print(f"{options.out}: {done.count} garments, {done.made} of them converted now")
    for line in summary_lines(options.out):
        print(f"  {line}")
    if faults := len(done.skipped):
        print(f"gcd convert: {faults} garments were skipped; the same command tries them again", file=sys.stderr)
    return 1 if faults else 0


OPTIONS_OF = {
    "hdf5": ("split",),
    "plain": ("split",),
    "layout": (),
    "glb": ("index", "split", "tile", "no_body", "texture", "endpoint"),
    "obj": ("index", "split", "tile", "no_body", "endpoint"),
    "ply": ("index", "split", "endpoint"),
    "usd": ("index", "split", "tile", "no_body", "endpoint"),
    "dxf": ("index", "split", "seam_allowance", "endpoint"),
    "pdf": ("index", "split", "seam_allowance", "paper", "endpoint"),
}
"""Format to the options that it takes."""
DATA_SETS = ("hdf5", "plain", "layout")
PATTERN_FORMATS = ("dxf", "pdf")  # of a specification file; the others drape it


def _export(options: argparse.Namespace) -> int:
    given = [form for form in OPTIONS_OF if getattr(options, form) is not None]
    if len(given) != 1:
        raise ConfigError(f"give {', '.join(f'--{form}' for form in OPTIONS_OF)}: one of them")
    [form] = given
    options.sources, options.what = options.what, options.what[0]
    is_data_set = form in DATA_SETS or not any(map(names_a_file, options.sources))
    if is_data_set and len(options.sources) > 1:
        raise ConfigError(f"{len(options.sources)} inputs: give one data set, or specification files")
    for name in sorted({name for names in OPTIONS_OF.values() for name in names} - set(OPTIONS_OF[form])):
        if getattr(options, name) not in (None, False):
            raise ConfigError(_unused(name, form))
    return _export_data_set(options, form) if form in DATA_SETS else _export_garment(options, form)


def _unused(option: str, form: str) -> str:
    """The message about an option that the format does not take."""
    takers = [f"--{other}" for other, names in OPTIONS_OF.items() if option in names]
    reason = ""
    if (option, form) == ("split", "layout"):
        reason = ": --layout takes train, validation and test, and lists them in its split file"
    return f"--{option.replace('_', '-')} is for {', '.join(takers)}{reason or ': leave it out'}"


def _export_garment(options: argparse.Namespace, form: str) -> int:
    """Export a sample, or the pattern of a specification file."""
    from datetime import date

    from gcd_dataset import exports

    file: Path = getattr(options, form)
    chosen: dict[str, Any] = {
        name: getattr(options, name)
        for name in ("seam_allowance", "paper", "tile")
        if getattr(options, name) is not None
    }
    if options.no_body:
        chosen["body"] = False
    if textures := textures_of(options):
        chosen["textures"] = textures
    if form == "dxf":
        chosen["created"] = date.today()
    write = partial(getattr(exports, form), **chosen)
    if any(map(names_a_file, options.sources)):
        if used := [name for name in ("index", "split", "endpoint") if getattr(options, name) is not None]:
            raise ConfigError(f"--{used[0]} is for a data set, and {options.what} is a specification: leave it out")
        return _export_patterns(options.sources, form, file, write)
    options.index = options.index or 0
    write(sample_of(options), file)
    print(file)
    return 0


def _export_patterns(sources: list[str], form: str, out: Path, write: Callable[[Any, Path], None]) -> int:
    """Export specification files, several of them to the folder ``out``; a bad one costs no other."""
    from gcd_dataset.exports.inputs import require_suffix
    from gcd_dataset.files import make_folder, safe_name
    from gcd_dataset.generator.body import named_body
    from gcd_dataset.generator.fitting import Fitting, Refusal, drape_patterns, read_patterns
    from gcd_dataset.records import Outcome

    if len(sources) == 1:
        require_suffix(out, *((".usd", ".usda", ".usdc") if form == "usd" else (f".{form}",)))
    elif out.suffix:
        raise ConfigError(f"--{form} {out}: {len(sources)} files are exported: give a folder")
    garments: Iterable[Any] = read_patterns(sources)
    if form not in PATTERN_FORMATS:
        garments = drape_patterns(garments, cache(lambda legs: named_body("neutral", legs_apart=legs)[:2]))
    failed = False
    for garment in garments:
        name = garment.pattern.name if isinstance(garment, Fitting) else garment.name
        file = out if len(sources) == 1 else make_folder(out) / f"{safe_name(name)}.{form}"
        try:
            if isinstance(garment, Refusal):
                raise PatternError(garment.reason)
            write(garment, file)
            print(file)
            if isinstance(garment, Fitting) and garment.drape.outcome is not Outcome.SETTLED:
                outcome, reason = garment.drape.outcome, garment.drape.reason
                raise PatternError(": ".join(filter(None, (name, outcome.name, reason, outcome.value))))
        except (PatternError, ShardError) as error:
            print(f"gcd export: {error}", file=sys.stderr)
            failed = True
    return int(failed)


def _export_data_set(options: argparse.Namespace, form: str) -> int:
    """Export a split, or all splits in the published layout."""
    if options.layout is not None and options.layout[0] != "published":
        raise ConfigError(f"--layout {options.layout[0]}: unknown layout: give published")
    from gcd_dataset import export

    out = options.hdf5 or options.plain or Path(options.layout[1])
    resumes = form == "layout"
    again = "the same command continues from there" if resumes else f"{out} was not written: run it again"
    bar, folder = Bar("garment", options.quiet, verb="export", again=again), require_folder(options.what)
    exported: Any = "published" if form == "layout" else form
    bar.run(partial(export, folder, out, exported, split=options.split))
    done = bar.progress
    layout = " in the published layout" if form == "layout" else ""
    print(f"{out}: {done.count} garments of {done.split}{layout}")
    return 0
