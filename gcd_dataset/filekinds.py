"""Recognises files of other kinds that are given in place of JSON, by content first, then by the end of the name.

Also folders in the published layout of GarmentCodeData: ``garments_5000_0/default_body`` and so on.
"""

import contextlib
import re
from collections.abc import Mapping
from pathlib import Path

from gcd_dataset.files import open_regular

BODY_FOLDERS: Mapping[str, str] = {"default": "default_body", "random": "random_body"}
"""Choice of ``bodies`` to the folder of a batch."""

HEAD = 4096  # bytes that are looked at
REDRAW = "gcd cannot convert it: write its panels and seams in Python (docs/guides/own-garment.md)"
BODY = "if it is a body, give it as --body"
CONTENTS = (
    (rb"\Aversion https://git-lfs", "a pointer of Git LFS", "get the file itself with git lfs pull"),
    (rb"\A(?:\xff\xfe|\xfe\xff)", "text in UTF-16", "save it as UTF-8"),
    (rb"(?i)\A\s*<(?:!doctype\s+)?html", "a web page, perhaps the error of a server", "download the file again"),
    (rb"\A\s*<(?s:.*<)?(?:\w+:)?svg\b", "an SVG drawing", "give the specification that it was drawn from"),
    (rb"\A\s*<(?s:.*<)?(?:pattern|vit|vst|smis|smms)\b", "a file of Valentina or Seamly2D (XML)", REDRAW),
    (rb"\A\s*<", "XML", ""),
    (rb"(?m)^\s*0\r?\n\s*SECTION\b|\AAutoCAD Binary DXF", "a DXF drawing", REDRAW),
    (rb"\A%(?:PDF|!PS)", "a PDF or PostScript drawing", REDRAW),
    (rb"\A(?:\x89PNG|\xff\xd8\xff|GIF8|BM|II\*\x00|MM\x00\*|8BPS|RIFF....WEBP|....ftyp(?:hei|avi))", "a picture", ""),
    (rb"\A(?:glTF|ply\r?\n|solid |Kaydara FBX|#usda|PXR-USDC|BLENDER)|(?m:^v[ \t]+[-+.\d])", "a mesh", BODY),
    (rb"\A(?:\x89HDF|(?s:.{257})ustar)", "a file of a data set", "give the data set, and --index for one garment"),
    (rb"\A(?:\x93NUMPY|\x80[\x02-\x05])", "arrays of NumPy or pickled objects", ""),
)
"""What a file begins with, what it is, and how to go on: empty if only another file helps."""
ARCHIVE = re.compile(rb"PK\x03\x04|\x1f\x8b|\x28\xb5\x2f\xfd|BZh|\xfd7zXZ|7z\xbc\xaf|Rar!")
ENDINGS = {
    (".zprj", ".zpac", ".pacx"): ("a file of CLO or Marvelous Designer", REDRAW),
    (".val", ".sm2d", ".vit", ".vst", ".smis", ".smms"): ("a file of Valentina or Seamly2D", REDRAW),
    (".dxf", ".plt", ".hpgl", ".pds", ".ai", ".eps"): ("a drawing of a CAD program", REDRAW),
    (".npz", ".pt", ".pkl"): ("arrays of NumPy or pickled objects", ""),
    (".stl", ".obj", ".fbx", ".3mf", ".usdz"): ("a mesh", BODY),
    (".yaml", ".yml"): ("YAML", "a design becomes a pattern with gcd fit"),
}


def other_kind(path: Path) -> tuple[str, str] | None:
    """What a file is that is no JSON, and how to go on, for a message; ``None`` if it is unknown or cannot be read."""
    try:
        with open_regular(path) as file:
            head = file.read(HEAD)
    except (OSError, ValueError):
        return None
    if re.match(rb"(?:\xef\xbb\xbf)?\s*[\[{]", head):
        return None
    for content, kind, remedy in CONTENTS:
        if re.search(content, head.removeprefix(b"\xef\xbb\xbf")):
            return kind, remedy
    for endings, found in ENDINGS.items():
        if path.suffix.lower() in endings:
            return found
    if ARCHIVE.match(head):
        return "an archive", "unpack it"
    return None if head.strip() else ("empty", "")


def is_published(folder: Path) -> bool:
    """Whether a folder is GarmentCodeData as published, one of its batches, or the folder that holds it."""
    if folder.name in BODY_FOLDERS.values():
        return True
    with contextlib.suppress(OSError):
        return is_batch(folder) or find_batches(folder) is not None
    return False


def find_batches(folder: Path) -> Path | None:
    """The folder of the batches: ``folder`` or one of its subfolders; ``None`` without batches. Raises ``OSError``."""
    candidates = (folder, *sorted(inner for inner in folder.iterdir() if inner.is_dir()))
    return next((path for path in candidates if any(map(is_batch, path.iterdir()))), None)


def is_batch(folder: Path) -> bool:
    """Whether a folder is a batch of garments, such as ``garments_5000_0``."""
    return folder.is_dir() and any((folder / body_folder).is_dir() for body_folder in BODY_FOLDERS.values())
