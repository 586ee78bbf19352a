"""Tars that other programs have written for ``webdataset``: what lies in them, and where.

They are read from end to end once, for the hashes; nothing is ever extracted. A sample is the files whose names agree
up to the first dot behind the last slash, one behind the other; what follows that dot is the member.
"""

import itertools
import re
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import BinaryIO, NamedTuple

import numpy as np

from gcd_dataset.errors import ShardError, shown
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.index import ShardIndex, ShardTable
from gcd_dataset.shards.layout import foreign_layout
from gcd_dataset.shards.tar import BLOCK, padded, require_header

__all__ = ["SPLITS", "ForeignSample", "foreign_index", "foreign_shards", "samples_of", "scan_foreign"]

PIECE = 1 << 20  # bytes read at once
LONGEST_HEADER = 1 << 20  # bytes of a long name or of extended attributes; none that is meant well comes near
LARGEST = (1 << 32) - 1  # bytes of a member, as an index can hold
REMEDY = "get it anew from whoever made it, or leave it out"

FILE, FOLDER = (b"0", b"\0", b"7"), b"5"
PAX, PAX_ALL, LONG_NAME, LONG_LINK = b"x", b"g", b"L", b"K"
KINDS = {b"1": "a hard link", b"2": "a symbolic link", b"3": "a device", b"4": "a device", b"6": "a pipe"}

SPLITS = {
    "train": ("train", "training"),
    "validation": ("validation", "valid", "val", "dev"),
    "test": ("test", "testing", "eval", "evaluation"),
}
"""Words in the name of a file that say which split it belongs to: those of the Hub."""


class ForeignSample(NamedTuple):
    """The files of one sample."""

    key: str
    members: Mapping[str, tuple[int, int, int]]
    """Member to offset, size and CRC-32 of its content."""


def foreign_shards(names: Iterable[str], split: str) -> tuple[str, ...]:
    """The tars of a split among file names, sorted; those that name no split are of ``train``.

    >>> foreign_shards(["b-00001.tar", "b-00000.tar", "b-test-00000.tar", "b.txt"], "train")
    ('b-00000.tar', 'b-00001.tar')
    """
    return tuple(sorted(name for name in names if name.endswith(".tar") and _split_of(name) == split))


def _split_of(name: str) -> str:
    words = set(re.split(r"[^a-z]+", name.lower()))
    return next((split for split, known in SPLITS.items() if words & set(known)), "train")


def foreign_index(archives: Mapping[str, Sequence[ForeignSample]], lengths: Sequence[int]) -> ShardIndex:
    """The index of archives, from file name to samples; ``lengths``: bytes of each."""
    samples = [sample for content in archives.values() for sample in content]
    layout = foreign_layout(tuple(sorted({member for sample in samples for member in sample.members})))
    missing = (-1, 0, 0)
    rows = [[sample.members.get(member, missing) for member in layout.members] for sample in samples]
    table = np.array(rows, np.int64).reshape(len(samples), len(layout.members), 3)
    return ShardIndex(
        shards=tuple(archives),
        length=np.array(lengths, np.int64),
        shard=np.repeat(np.arange(len(archives), dtype=np.int32), [len(content) for content in archives.values()]),
        table=ShardTable(
            sample=np.arange(len(samples)),
            offset=table[:, :, 0],
            size=table[:, :, 1].astype(np.uint32),
            crc=table[:, :, 2].astype(np.uint32),
            settled=np.zeros(len(samples), bool),
        ),
        layout=layout,
        keys=tuple(sample.key for sample in samples),
    )


def scan_foreign(path: Path) -> list[ForeignSample]:
    """The samples of an archive. Raises ``ShardError`` with the member that is damaged, or not a plain file."""
    try:
        with reading(path), path.open("rb") as file:
            return list(samples_of(file))
    except ShardError as error:
        if str(error).startswith(str(path)):
            raise
        raise ShardError(f"{path}: {error}: {REMEDY}") from error


def samples_of(file: BinaryIO) -> Iterator[ForeignSample]:
    """The samples of an archive that is read from its beginning. Raises ``ShardError``."""
    for key, entries in itertools.groupby(_entries(file), key=lambda entry: _key_and_member(entry[0])[0]):
        members: dict[str, tuple[int, int, int]] = {}
        for name, *place in entries:
            member = _key_and_member(name)[1]
            if member in members:
                raise ShardError(f"member {shown(name)} is there twice")
            members[member] = (place[0], place[1], place[2])
        yield ForeignSample(key, members)


def _key_and_member(name: str) -> tuple[str, str]:
    """``a/b.c.NPY`` as (``a/b``, ``c.npy``), as ``webdataset`` takes it."""
    folder, slash, file = name.rpartition("/")
    stem, _, member = file.partition(".")
    return folder + slash + stem, member.lower()


def _entries(file: BinaryIO) -> Iterator[tuple[str, int, int, int]]:
    """Name, offset, size and CRC-32 of every plain file."""
    position, name, size_told = 0, "", -1
    while header := _exactly(file, BLOCK, "a header", may_end=True):
        if header == bytes(BLOCK):
            return
        require_header(header, position)
        kind, size = header[156:157], _number(header[124:136], position)
        place = position + BLOCK
        if kind in (PAX, PAX_ALL, LONG_NAME, LONG_LINK):
            if size > LONGEST_HEADER:
                raise ShardError(f"a header of {size} bytes at byte {position}, where {LONGEST_HEADER} are plenty")
            text = _exactly(file, padded(size), "a header")[:size]
            if kind == LONG_NAME:
                name = _text(text.rstrip(b"\0"))
            elif kind == PAX:
                told = _pax(text)
                name, size_told = told.get("path", name), int(told.get("size", size_told))
            position = place + padded(size)
            continue
        size = size_told if size_told >= 0 else size
        full = name or _full_name(header)
        _require_harmless(full, kind)
        if kind == FOLDER:
            size = 0
        if size > LARGEST:
            raise ShardError(f"member {shown(full)} has {size} bytes: members up to 4 GiB are read")
        crc = _crc(file, size, full)
        if kind != FOLDER and "." in full.rpartition("/")[2]:
            yield full, place, size, crc
        position, name, size_told = place + padded(size), "", -1


def _require_harmless(name: str, kind: bytes) -> None:
    """Raise ``ShardError`` for anything but a plain file or folder inside."""
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or "\0" in name:
        raise ShardError(f"member {shown(name)} points outside the archive")
    if kind not in FILE and kind != FOLDER:
        raise ShardError(f"member {shown(name)} is {KINDS.get(kind, f'of kind {kind!r}')}, not a plain file")


def _full_name(header: bytes) -> str:
    name, prefix = header[:100].partition(b"\0")[0], header[345:500].partition(b"\0")[0]
    return _text(prefix + b"/" + name if prefix and header[257:262] == b"ustar" else name)


def _text(name: bytes) -> str:
    return name.decode("utf-8", "backslashreplace")


def _number(text: bytes, position: int) -> int:
    """A number in octal digits, or in base 256 where these do not reach."""
    if text[0] == 0x80:
        return int.from_bytes(text[1:], "big")
    digits = text.strip(b" \0")
    if not re.fullmatch(rb"[0-7]*", digits):
        raise ShardError(f"no tar header at byte {position}")
    return int(digits or b"0", 8)


def _pax(text: bytes) -> dict[str, str]:
    """Extended attributes: lines of ``LENGTH NAME=VALUE``."""
    told, place = {}, 0
    while place < len(text):
        match = re.compile(rb"(\d{1,7}) ([^=]+)=").match(text, place)
        if match is None or not len(match[0]) < int(match[1]) <= len(text) - place:
            raise ShardError("a damaged header of extended attributes")
        told[_text(match[2])] = _text(text[match.end() : place + int(match[1]) - 1])
        place += int(match[1])
    if not re.fullmatch(r"[0-9]{1,18}", told.get("size", "0")):  # Python refuses to read thousands of digits
        raise ShardError("a damaged header of extended attributes")
    return told


def _crc(file: BinaryIO, size: int, name: str) -> int:
    """CRC-32 of the next ``size`` bytes; what pads them is passed over."""
    crc, left = 0, size
    while left:
        piece = file.read(min(left, PIECE))
        if not piece:
            raise ShardError(f"member {shown(name)} is cut off: {size - left} of its {size} bytes are there")
        crc, left = zlib.crc32(piece, crc), left - len(piece)
    _exactly(file, padded(size) - size, f"what pads member {shown(name)}")
    return crc


def _exactly(file: BinaryIO, size: int, what: str, *, may_end: bool = False) -> bytes:
    """The next bytes. Raises ``ShardError`` where the file ends among them."""
    content = b""
    while len(content) < size and (piece := file.read(size - len(content))):
        content += piece
    if len(content) < size and not (may_end and not content):
        raise ShardError(f"{what} is cut off")
    return content
