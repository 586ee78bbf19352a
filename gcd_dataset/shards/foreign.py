"""Indexes tars that other programs wrote for ``webdataset``.

Each tar is read once from end to end, for the CRC-32 of every member; nothing is extracted. As in ``webdataset``, a
sample is a run of files whose paths agree up to the first dot of the file name; the rest of the name is the member.
"""

import itertools
import re
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import BinaryIO, NamedTuple

import numpy as np

from gcd_dataset.errors import ShardError, shown
from gcd_dataset.files import open_regular
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.index import ShardIndex, ShardTable
from gcd_dataset.shards.layout import foreign_layout
from gcd_dataset.shards.tar import BLOCK, padded, require_header

__all__ = ["SPLITS", "ForeignSample", "foreign_index", "foreign_shards", "samples_of", "scan_foreign"]

CHUNK = 1 << 20  # bytes of a read
LONGEST_HEADER = 1 << 20  # bytes of a long name or of extended attributes; valid ones are far shorter
LARGEST = (1 << 32) - 1  # bytes of a member: sizes in an index are u32
REMEDY = "get it again from its maker, or leave it out"

FILE, FOLDER = (b"0", b"\0", b"7"), b"5"  # type flags of POSIX.1-2001
PAX, PAX_ALL, LONG_NAME, LONG_LINK = b"x", b"g", b"L", b"K"
KINDS = {b"1": "a hard link", b"2": "a symbolic link", b"3": "a device", b"4": "a device", b"6": "a pipe"}

SPLITS = {
    "train": ("train", "training"),
    "validation": ("validation", "valid", "val", "dev"),
    "test": ("test", "testing", "eval", "evaluation"),
}
"""Split to the words that name it in a file name, as on the Hugging Face Hub."""


class ForeignSample(NamedTuple):
    """The members of one sample in a foreign tar."""

    key: str
    members: Mapping[str, tuple[int, int, int]]
    """Member to (offset, size, CRC-32) of its content."""


def foreign_shards(names: Iterable[str], split: str) -> tuple[str, ...]:
    """The tars of a split among file names, sorted; a name without a split counts as ``train``.

    >>> foreign_shards(["b-00001.tar", "b-00000.tar", "b-test-00000.tar", "b.txt"], "train")
    ('b-00000.tar', 'b-00001.tar')
    """
    return tuple(sorted(name for name in names if name.endswith(".tar") and _split_of(name) == split))


def _split_of(name: str) -> str:
    words = set(re.split(r"[^a-z]+", name.lower()))
    return next((split for split, known in SPLITS.items() if words & set(known)), "train")


def foreign_index(archives: Mapping[str, Sequence[ForeignSample]], lengths: Sequence[int]) -> ShardIndex:
    """The index of archives, given as file name to samples; ``lengths``: bytes of each archive."""
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
            grade=np.zeros(len(samples), np.uint8),
        ),
        layout=layout,
        keys=tuple(sample.key for sample in samples),
    )


def scan_foreign(path: Path) -> list[ForeignSample]:
    """The samples of an archive. Raises ``ShardError`` naming a member that is damaged, or no plain file."""
    try:
        with reading(path), open_regular(path) as file:
            return list(samples_of(file))
    except ShardError as error:
        if str(error).startswith(str(path)):
            raise
        raise ShardError(f"{path}: {error}: {REMEDY}") from error


def samples_of(file: BinaryIO) -> Iterator[ForeignSample]:
    """The samples of an archive; ``file`` is at its first byte. Raises ``ShardError``."""
    for key, entries in itertools.groupby(_entries(file), key=lambda entry: _key_and_member(entry[0])[0]):
        members: dict[str, tuple[int, int, int]] = {}
        for name, offset, size, crc in entries:
            member = _key_and_member(name)[1]
            if member in members:
                raise ShardError(f"member {shown(name)} occurs twice")
            members[member] = (offset, size, crc)
        yield ForeignSample(key, members)


def _key_and_member(name: str) -> tuple[str, str]:
    """(``a/b``, ``c.npy``) for ``a/b.c.NPY``, as ``webdataset`` splits names."""
    folder, slash, file = name.rpartition("/")
    stem, _, member = file.partition(".")
    return folder + slash + stem, member.lower()


def _entries(file: BinaryIO) -> Iterator[tuple[str, int, int, int]]:
    """Name, offset, size and CRC-32 of every plain file."""
    position, name, pax_size = 0, "", -1
    while header := _exactly(file, BLOCK, "a header", may_end=True):
        if header == bytes(BLOCK):
            return
        require_header(header, position)
        kind, size = header[156:157], _number(header[124:136], position)
        offset = position + BLOCK
        if kind in (PAX, PAX_ALL, LONG_NAME, LONG_LINK):
            if size > LONGEST_HEADER:
                raise ShardError(f"a header of {size} bytes at byte {position}, over the limit of {LONGEST_HEADER}")
            text = _exactly(file, padded(size), "a header")[:size]
            if kind == LONG_NAME:
                name = _text(text.rstrip(b"\0"))
            elif kind == PAX:
                attributes = _pax(text)
                name, pax_size = attributes.get("path", name), int(attributes.get("size", pax_size))
            position = offset + padded(size)
            continue
        size = pax_size if pax_size >= 0 else size
        path = name or _header_path(header)
        _require_harmless(path, kind)
        if kind == FOLDER:
            size = 0
        if size > LARGEST:
            raise ShardError(f"member {shown(path)} has {size} bytes: members up to 4 GiB are read")
        crc = _crc(file, size, path)
        if kind != FOLDER and "." in path.rpartition("/")[2]:
            yield path, offset, size, crc
        position, name, pax_size = offset + padded(size), "", -1


def _require_harmless(name: str, kind: bytes) -> None:
    """Raise ``ShardError`` for a link, a device, or a path that leads outside the archive."""
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or "\0" in name:
        raise ShardError(f"member {shown(name)} points outside the archive")
    if kind not in FILE and kind != FOLDER:
        raise ShardError(f"member {shown(name)} is {KINDS.get(kind, f'of kind {kind!r}')}, not a plain file")


def _header_path(header: bytes) -> str:
    name, prefix = header[:100].partition(b"\0")[0], header[345:500].partition(b"\0")[0]
    return _text(prefix + b"/" + name if prefix and header[257:262] == b"ustar" else name)


def _text(name: bytes) -> str:
    return name.decode("utf-8", "backslashreplace")


def _number(text: bytes, position: int) -> int:
    """A header's number: octal digits, or base 256 (GNU) for large ones."""
    if text[0] == 0x80:
        return int.from_bytes(text[1:], "big")
    digits = text.strip(b" \0")
    if not re.fullmatch(rb"[0-7]*", digits):
        raise ShardError(f"no tar header at byte {position}")
    return int(digits or b"0", 8)


def _pax(text: bytes) -> dict[str, str]:
    """Extended attributes (pax, POSIX.1-2001): lines of ``LENGTH NAME=VALUE``."""
    attributes, start = {}, 0
    while start < len(text):
        match = re.compile(rb"(\d{1,7}) ([^=]+)=").match(text, start)
        if match is None or not len(match[0]) < int(match[1]) <= len(text) - start:
            raise ShardError("a damaged header of extended attributes")
        attributes[_text(match[2])] = _text(text[match.end() : start + int(match[1]) - 1])
        start += int(match[1])
    if not re.fullmatch(r"[0-9]{1,18}", attributes.get("size", "0")):  # int() refuses thousands of digits
        raise ShardError("a damaged header of extended attributes")
    return attributes


def _crc(file: BinaryIO, size: int, name: str) -> int:
    """CRC-32 of the next ``size`` bytes; skips their padding."""
    crc, left = 0, size
    while left:
        piece = file.read(min(left, CHUNK))
        if not piece:
            raise ShardError(f"member {shown(name)} is cut off: only {size - left} of its {size} bytes are present")
        crc, left = zlib.crc32(piece, crc), left - len(piece)
    _exactly(file, padded(size) - size, f"the padding of member {shown(name)}")
    return crc


def _exactly(file: BinaryIO, size: int, name: str, *, may_end: bool = False) -> bytes:
    """The next ``size`` bytes. Raises ``ShardError`` where the file ends within them; ``may_end``: or before them."""
    content = b""
    while len(content) < size and (piece := file.read(size - len(content))):
        content += piece
    if len(content) < size and not (may_end and not content):
        raise ShardError(f"{name} is cut off")
    return content
