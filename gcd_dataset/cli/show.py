"""``gcd show``: pictures and pages of a garment, and the viewer in a browser."""

import argparse
import contextlib
import math
import os
import sys
import threading
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gcd_dataset.cli.common import (
    SOURCE_HELP,
    add_body,
    add_server,
    add_texture,
    add_verb,
    names_a_file,
    natural_number,
    pattern_of,
    position_of,
    reader_of,
    sample_of,
    textures_of,
    wearer_of,
)
from gcd_dataset.errors import ConfigError, GcdError, ShardError

if TYPE_CHECKING:
    from gcd_dataset.bodies import Wearer
    from gcd_dataset.loaders import PublishedGarmentCodeData
    from gcd_dataset.shards import ShardReader
    from gcd_dataset.viewer.garments import Album

HIGHEST_PORT = 65_535
MOST_TILES = 400  # garments on a contact sheet
LARGEST_TILE, SHEET_WIDTH = 512, 4096  # pixels


def add_verbs(verbs: Any) -> None:
    """Add ``show``."""
    show = add_verb(verbs, "show", _show, "garments and patterns in a browser, as a picture, or as a page")
    show.add_argument(
        "what",
        metavar="DATASET|PUBLISHED|SPEC",
        help=f"{SOURCE_HELP}; GarmentCodeData as published; specification JSON, or a folder of it",
    )
    show.add_argument(
        "--index", type=_ranges, metavar="I", help="which sample of the split (default: 0); for --sheet such as 0-63,70"
    )
    show.add_argument("--split", default="train", help="split of the data set (default: train)")
    show.add_argument("--png", type=Path, metavar="FILE", help="views and pattern of a sample, or the pattern alone")
    show.add_argument("--html", type=Path, metavar="FILE", help="pattern, mesh and drape as one self-contained page")
    show.add_argument("--svg", type=Path, metavar="FILE", help="the pattern at true scale, ready for cutting")
    show.add_argument("--sheet", type=Path, metavar="FILE", help="pictures of several garments, as JPEG or PNG")
    show.add_argument(
        "--maps",
        action="store_true",
        help="in the colours of stretch, gap to the skin and pressure; except --svg; --png also as normals, depth, "
        "seam lines, parts and key points",
    )
    add_texture(show, form="--png")
    conditions = "for --sheet: kind, grade or outcome, as in the viewer: kind=hooded grade=clean"
    show.add_argument("--where", nargs="+", default=[], metavar="NAME=VALUE", help=conditions)
    show.add_argument(
        "--truth", metavar="DATASET|SPEC", help="true patterns beside those of SPEC, by name; prints the scores"
    )
    add_body(show, default=None)
    show.add_argument("--port", type=_port, default=0, help="port of the viewer (default: a free one)")
    add_server(show)


def _show(options: argparse.Namespace) -> int:
    files = {"png": options.png, "svg": options.svg, "html": options.html}
    given = {ending: path for ending, path in files.items() if path is not None}
    if options.texture and (options.png is None or options.maps):
        raise ConfigError("--texture is for --png without --maps: leave it out")
    if options.sheet is not None:
        if given or options.truth is not None or options.body is not None:
            raise ConfigError(
                "--sheet shows garments of a DATASET or SPEC: leave out --png, --svg, --html, --truth and --body"
            )
        return _sheet(options)
    [*others, last] = options.index or (range(1),)
    if options.where or others or last.stop != last.start + 1:
        raise ConfigError("--where, and an --index of several garments, are for --sheet: give one index")
    options.index = last.start
    if not given:
        return _serve(options)
    if options.truth is not None:
        raise ConfigError("--truth is shown in the viewer: leave out --png, --svg and --html")
    for ending, path in given.items():
        if path.suffix.lower() != f".{ending}":
            raise ConfigError(f"--{ending} {path}: the file is {ending.upper()}, so end the name in .{ending}")
    return _write(options, given)


def _write(options: argparse.Namespace, given: dict[str, Path]) -> int:
    from gcd_dataset.files import write_whole
    from gcd_dataset.generator.drawing import draw_pattern, png_bytes, sample_sheet
    from gcd_dataset.generator.svg import pattern_svg
    from gcd_dataset.outfits import joined
    from gcd_dataset.records import Pattern, Sample
    from gcd_dataset.viewer.content import content_of
    from gcd_dataset.viewer.garments import NO_BODY, published_content
    from gcd_dataset.viewer.maps import maps_sheet, require_maps, textured_sheet
    from gcd_dataset.viewer.page import page_of

    published = _published(options)
    if published is not None:
        subject: Sample | Pattern = published.sample(position_of(options, len(published)))
    else:
        if names_a_file(options.what):
            position_of(options, 1)
        subject = pattern_of(options) if names_a_file(options.what) else sample_of(options)
    draw: Callable[[Sample], Any] = maps_sheet if options.maps else sample_sheet
    if options.texture:
        if not isinstance(subject, Sample):
            raise ConfigError(f"{options.what} is not draped, and --texture is for draped garments: leave it out")
        draw = partial(textured_sheet, textures=textures_of(options))
    is_png_alone = options.html is None and options.png is not None
    has_maps = isinstance(subject, Sample) and (is_png_alone or subject.maps is not None)
    require_maps(not options.maps or has_maps, options.what)
    wearer = _wearer(options, is_spec=isinstance(subject, Pattern))
    if wearer and options.html is None:
        raise ConfigError("--body is for --html and the viewer, which show panels round it: leave it out")
    if options.png is not None:
        picture = draw(subject) if isinstance(subject, Sample) else draw_pattern(subject)
        write_whole(options.png, png_bytes(picture))
    if options.svg is not None:
        write_whole(options.svg, pattern_svg(joined(subject).pattern if isinstance(subject, Sample) else subject))
    if options.html is not None:
        content = (
            content_of(subject, wearer=wearer) if published is None else published_content(published, options.index)
        )
        write_whole(options.html, page_of(content, maps=options.maps).encode())
        if problem := dict(content.tables.get("Recipe", ())).get(NO_BODY):
            print(f"gcd show: {problem}", file=sys.stderr)
    print(*given.values(), sep="\n")
    if isinstance(subject, Sample) and subject.caption is not None:
        print(subject.caption)
    return 0


def _sheet(options: argparse.Namespace) -> int:
    """Write a contact sheet; a garment that cannot be read is reported, and its place left white."""
    import numpy as np

    from gcd_dataset.exports.inputs import require_suffix
    from gcd_dataset.files import write_whole
    from gcd_dataset.generator.drawing import captioned, contact_sheet, jpeg_bytes, png_bytes
    from gcd_dataset.viewer.maps import with_legend

    is_png = require_suffix(options.sheet, ".jpg", ".jpeg", ".png").suffix.lower() == ".png"
    album = _album(options)
    chosen = _chosen(options, album)
    columns = math.ceil(math.sqrt(len(chosen)))
    size, tiles, faults = min(LARGEST_TILE, SHEET_WIDTH // columns // 2 * 2), [], 0
    for position in chosen:
        try:
            picture = album.picture(position, size)
        except GcdError as error:
            print(f"gcd show: {error}", file=sys.stderr)
            picture, faults = np.full((size, size, 3), 255, np.uint8), faults + 1
        tiles.append(captioned(picture, album.key(position)))
    sheet = contact_sheet(tiles, columns=columns)
    sheet = with_legend(sheet) if options.maps else sheet
    write_whole(options.sheet, (png_bytes if is_png else jpeg_bytes)(sheet))
    print(f"{options.sheet}: {len(chosen)} of {len(album)} garments")
    return 1 if faults else 0


def _chosen(options: argparse.Namespace, album: "Album") -> list[int]:
    """Positions for a contact sheet. Raises ``ConfigError`` for none or too many, ``ShardError`` for unknown ones."""
    from gcd_dataset.viewer.garments import Filter

    try:
        where = Filter(**dict(condition.split("=", 1) for condition in options.where))
    except (TypeError, ValueError) as error:
        raise ConfigError(f"--where {' '.join(options.where)}: write kind=, grade= or outcome=VALUE") from error
    if where.kind or where.outcome:
        album.read_tags()
    chosen: list[int] = album.matches(where).tolist()
    if options.index is not None:
        admitted, last = set(chosen), max(part.stop for part in options.index) - 1
        if last >= len(album):
            raise ShardError(f"{options.what}: garment {last} of {len(album)}: give 0 to {len(album) - 1}")
        chosen = [position for part in options.index for position in part if position in admitted]
    if not 0 < len(chosen) <= MOST_TILES:
        known = "; ".join(f"{name} {', '.join(values)}" for name, values in asdict(album.facets()).items() if values)
        remedy = f"select 1 to {MOST_TILES} by --index and --where"
        raise ConfigError(f"{options.what}: {len(chosen)} garments selected: {remedy}: {known or 'no kinds'}")
    return chosen


def _serve(options: argparse.Namespace) -> int:
    """The viewer, until it is interrupted."""
    from gcd_dataset.viewer.garments import SpecAlbum
    from gcd_dataset.viewer.server import Gallery, serve

    album = _album(options)
    site = Gallery(album, position_of(options, len(album)))
    if isinstance(album, SpecAlbum) and options.truth is not None:
        lines = (print(line, flush=True) for line in album.scores())
        threading.Thread(target=list, args=(lines,), daemon=True).start()
    with contextlib.suppress(KeyboardInterrupt):
        serve(site, port=options.port)
    if not site.has_ended():  # the interpreter would wait for threads, which may wait for a server
        sys.stdout.flush()
        os._exit(0)
    return 0


def _album(options: argparse.Namespace) -> "Album":
    from gcd_dataset.shards.store import is_set
    from gcd_dataset.viewer.garments import PublishedAlbum, ShardAlbum, spec_album
    from gcd_dataset.viewer.maps import require_maps

    folder = Path(options.what)
    if options.truth is not None and is_set(folder):
        raise ConfigError(f"{folder}: a data set: give predictions, specification files, and the data set as --truth")
    published = _published(options) if options.truth is None else None
    is_no_set = "://" not in options.what and folder.is_dir() and not is_set(folder)
    is_spec = options.truth is not None or names_a_file(options.what) or (is_no_set and any(folder.glob("*.json")))
    require_maps(not options.maps or (published is None and not is_spec), options.what)
    wearer = _wearer(options, is_spec=is_spec and published is None)
    if published is not None:
        return PublishedAlbum(published, options.what)
    if is_spec:
        return spec_album(folder, None if options.truth is None else _truth(options), wearer)
    return ShardAlbum(reader_of(options.what, options), options.what, maps=options.maps)


def _wearer(options: argparse.Namespace, *, is_spec: bool) -> "Wearer | None":
    """The body that the panels of a specification are placed round; ``None``: the neutral one."""
    if not any((options.body, options.measurements, options.segmentation, options.height, options.betas)):
        return None
    if not is_spec:
        raise ConfigError("--body and the options of its file are for the panels of a SPEC: leave them out")
    options.body = options.body or "neutral"
    wearer = wearer_of(options)
    wearer(False)  # an unreadable body is named before anything is written or served
    return wearer


def _truth(options: argparse.Namespace) -> "Path | ShardReader":
    """The source of true patterns: a specification file, a folder of them, or a data set."""
    from gcd_dataset.shards.store import is_set

    path = Path(options.truth)
    if names_a_file(options.truth) or (path.is_dir() and not is_set(path)):
        return path
    return reader_of(options.truth, options)


def _published(options: argparse.Namespace) -> "PublishedGarmentCodeData | None":
    """GarmentCodeData as published in the folder ``what``; ``None`` for anything else."""
    from gcd_dataset.filekinds import is_published
    from gcd_dataset.shards.access import reading
    from gcd_dataset.shards.store import is_set

    folder = Path(options.what)
    with reading(folder):
        if "://" in options.what or not folder.is_dir() or is_set(folder) or not is_published(folder):
            return None
    from gcd_dataset.loaders import PublishedGarmentCodeData

    return PublishedGarmentCodeData(folder, split=options.split)


def _ranges(text: str) -> list[range]:
    """Option type: whole numbers and ranges of them, such as ``0-63,70``."""
    pairs = [part.split("-", 1) for part in text.split(",")]
    found = [range(int(pair[0]), int(pair[-1]) + 1) for pair in pairs if all(map(str.isdecimal, pair))]
    if len(found) < len(pairs) or not all(found):
        raise argparse.ArgumentTypeError(f"{text} is not a whole number of 0 or more, nor a list such as 0-63,70")
    return found


def _port(text: str) -> int:
    port = natural_number(text)
    if port > HIGHEST_PORT:
        raise argparse.ArgumentTypeError(f"{text} is above {HIGHEST_PORT}")
    return port
