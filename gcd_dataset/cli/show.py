"""``gcd show``: pictures and pages of a garment, and the viewer in a browser."""

import argparse
import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gcd_dataset.cli.subject import names_a_file, pattern_of, sample_of
from gcd_dataset.cli.verb import SOURCE_HELP, add_server, add_verb, natural_number, open_source
from gcd_dataset.errors import ConfigError

if TYPE_CHECKING:
    from gcd_dataset.viewer.album import Album
    from gcd_dataset.viewer.server import Design

__all__ = ["add_verbs"]

DEFAULT_DESIGN = "default"
HIGHEST_PORT = 65_535


def add_verbs(verbs: Any) -> None:
    """Add ``show``."""
    show = add_verb(verbs, "show", _show, "garments and patterns in a browser, as a picture, or as a page")
    show.add_argument(
        "what",
        nargs="?",
        metavar="DATASET|SPEC",
        help=f"{SOURCE_HELP}; GarmentCodeData as published; specification JSON, or a folder of it",
    )
    show.add_argument("--index", type=natural_number, default=0, help="which sample of the split (default: 0)")
    show.add_argument("--split", default="train", help="split of the data set (default: train)")
    show.add_argument("--png", type=Path, metavar="FILE", help="views and pattern of a sample, or the pattern alone")
    show.add_argument("--html", type=Path, metavar="FILE", help="pattern, mesh and drape as one self-contained page")
    show.add_argument("--svg", type=Path, metavar="FILE", help="the pattern at true scale, ready for cutting")
    show.add_argument(
        "--truth", type=Path, metavar="DIR", help="the true patterns beside those of the folder SPEC, by file name"
    )
    show.add_argument(
        "--design",
        nargs="?",
        const=DEFAULT_DESIGN,
        metavar="YAML",
        help="design by hand, from a file of design parameters or from a dress; without DATASET",
    )
    show.add_argument("--port", type=_port, default=0, help="port of the viewer (default: a free one)")
    add_server(show)


def _show(options: argparse.Namespace) -> int:
    files = {"png": options.png, "svg": options.svg, "html": options.html}
    given = {ending: path for ending, path in files.items() if path is not None}
    if (options.what is None) == (options.design is None):
        raise ConfigError("give either a DATASET or SPEC, or --design")
    if not given:
        return _serve(options)
    if options.design is not None or options.truth is not None:
        raise ConfigError("--design and --truth are shown in the viewer: leave out --png, --svg and --html")
    for ending, path in given.items():
        if path.suffix.lower() != f".{ending}":
            raise ConfigError(f"--{ending} {path}: the file is {ending.upper()}, so end the name in .{ending}")
    return _write(options, given)


def _write(options: argparse.Namespace, given: dict[str, Path]) -> int:
    from gcd_dataset.files import write_whole
    from gcd_dataset.generator.drawing import draw_pattern, png_bytes, sample_sheet
    from gcd_dataset.generator.svg import pattern_svg
    from gcd_dataset.records import Sample
    from gcd_dataset.viewer.content import content_of
    from gcd_dataset.viewer.page import page_of

    subject = pattern_of(options) if names_a_file(options.what) else sample_of(options)
    if options.png is not None:
        picture = sample_sheet(subject) if isinstance(subject, Sample) else draw_pattern(subject)
        write_whole(options.png, png_bytes(picture))
    if options.svg is not None:
        write_whole(options.svg, pattern_svg(subject.pattern if isinstance(subject, Sample) else subject))
    if options.html is not None:
        write_whole(options.html, page_of(content_of(subject)).encode())
    print(*given.values(), sep="\n")
    if isinstance(subject, Sample) and subject.caption is not None:
        print(subject.caption)
    return 0


def _serve(options: argparse.Namespace) -> int:
    """The viewer, until it is interrupted."""
    from gcd_dataset.viewer.server import Gallery, serve

    site = _design(options.design) if options.design is not None else Gallery(_album(options), options.index)
    with contextlib.suppress(KeyboardInterrupt):
        serve(site, port=options.port)
    return 0


def _album(options: argparse.Namespace) -> "Album":
    from gcd_dataset.shards import ShardReader
    from gcd_dataset.viewer.album import PublishedAlbum, ShardAlbum, spec_album

    folder = Path(options.what)
    is_no_set = "://" not in options.what and folder.is_dir() and not (folder / "manifest.json").exists()
    if options.truth is not None or names_a_file(options.what) or (is_no_set and any(folder.glob("*.json"))):
        return spec_album(folder, options.truth)
    if is_no_set and any(folder.glob("garments_5000_*")):
        from gcd_dataset.loaders import PublishedGarmentCodeData

        return PublishedAlbum(PublishedGarmentCodeData(folder, split=options.split or "train"), options.what)
    return ShardAlbum(ShardReader(open_source(options.what, options.endpoint), options.split or "train"), options.what)


def _design(start: str) -> "Design":
    from gcd_dataset.generator.garments.design_file import read_design
    from gcd_dataset.viewer.design_desk import Desk
    from gcd_dataset.viewer.server import Design

    return Design(Desk() if start == DEFAULT_DESIGN else Desk(read_design(start)))


def _port(text: str) -> int:
    port = natural_number(text)
    if port > HIGHEST_PORT:
        raise argparse.ArgumentTypeError(f"{text} is above {HIGHEST_PORT}")
    return port
