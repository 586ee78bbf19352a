"""USTAR archives (POSIX.1-1988), reproducible: equal members give equal bytes."""

import os
from collections.abc import Callable, Iterator
from typing import NamedTuple

from gcd_dataset.errors import ShardError, shown
from gcd_dataset.shards.layout import Bytes

BLOCK = 512
ZEROS = bytes(BLOCK)
END = 2 * BLOCK  # bytes of zeros at the end of an archive
CHUNK = 1 << 20  # bytes
LONGEST_NAME = 100
LARGEST = 8**11 - 1  # bytes: eleven octal digits
CHECKSUM = slice(148, 156)
KIND, PLAIN = 156, ord("0")


class TarMember(NamedTuple):
    """Name, offset and size of a member's content in an archive."""

    name: str
    offset: int
    size: int


def padded(size: int) -> int:
    """``size`` rounded up to whole blocks."""
    return -(-size // BLOCK) * BLOCK


def tar_entry(name: str, data: Bytes) -> bytes:
    """A member in an archive: header, content, zeros up to the next block.

    Owner 0, mode 0644, mtime 0. Raises ``ShardError`` for a name or content too long for USTAR.
    """
    encoded = name.encode()
    if len(encoded) > LONGEST_NAME or len(data) > LARGEST:
        raise ShardError(f"{name}: {len(data)} bytes under a name of {len(encoded)} do not fit into a tar header")
    header = b"".join(
        (
            encoded.ljust(LONGEST_NAME, b"\0"),
            b"0000644\0" + 2 * b"0000000\0",  # mode, user, group
            b"%011o\0" % len(data) + b"00000000000\0",  # size, time
            8 * b" ",  # the checksum counts its own field as spaces
            b"0" + bytes(100) + b"ustar\x0000",  # a plain file, no link, the format
            bytes(32 + 32) + 2 * b"0000000\0",  # names of user and group, device
            bytes(155 + 12),
        )
    )
    signed = header[: CHECKSUM.start] + b"%06o\0 " % sum(header) + header[CHECKSUM.stop :]
    return b"".join((signed, data, bytes(padded(len(data)) - len(data))))


def tar_entries(file: int) -> Iterator[TarMember]:
    """The members of the archive open as descriptor ``file``, up to the zeros or the end of the file.

    Raises ``ShardError`` where a header is damaged, a member is cut off, or other bytes follow the zeros at the end.
    """
    end, position = os.fstat(file).st_size, 0
    for member in _members(lambda place: os.pread(file, BLOCK, place), end):
        yield member
        position = member.offset + padded(member.size)
    for place in range(position, end, CHUNK):
        if os.pread(file, CHUNK, place).strip(b"\0"):  # zeros have overwritten a header
            raise ShardError(f"zeros at byte {position}, but content after them")


def samples_in(content: memoryview) -> Iterator[tuple[str, dict[str, memoryview]]]:
    """Key and members of each sample of one of our archives in memory, or of a run of whole samples cut out of one.

    Raises ``ShardError`` for a damaged header, a member that is cut off, and a duplicate member or sample.
    """
    key, members, past = "", dict[str, memoryview](), set[str]()
    for name, offset, size in _members(lambda place: bytes(content[place : place + BLOCK]), len(content)):
        next_key, _, member = name.partition(".")
        if next_key != key:
            if key:
                yield key, members
            past.add(key)
            key, members = next_key, {}
        if member in members or key in past:
            raise ShardError(f"member {shown(name)} occurs twice, again at byte {offset}")
        members[member] = content[offset : offset + size]
    if key:
        yield key, members


def _members(header_at: Callable[[int], bytes], end: int) -> Iterator[TarMember]:
    """The members of an archive up to byte ``end``, or the first block of zeros. Raises ``ShardError``."""
    position = 0
    while position < end and (header := header_at(position)) != ZEROS:
        name, size = _parse(header, position)
        position += BLOCK
        if position + padded(size) > end:
            raise ShardError(f"member {shown(name)} is cut off at byte {end}")
        yield TarMember(name, position, size)
        position += padded(size)


def _octal(digits: bytes) -> int:
    return int(digits, 8) if not digits.strip(b"01234567") else -1


def _parse(header: bytes, position: int) -> tuple[str, int]:
    """Name and size of a member, from a header by any program. Raises ``ShardError`` unless its checksum matches."""
    blank = header[: CHECKSUM.start] + 8 * b" " + header[CHECKSUM.stop :]
    digits = header[CHECKSUM].strip(b" \0")
    if len(header) < BLOCK or not digits.isdigit() or _octal(digits) != sum(blank):
        raise ShardError(f"no tar header at byte {position}")
    try:
        name, size = header[:LONGEST_NAME].rstrip(b"\0").decode("ascii"), _octal(header[124:135])
    except ValueError as error:
        raise ShardError(f"tar header of another program at byte {position}") from error
    if size < 0 or header[135] != 0:  # other readers would take it for a twelfth digit
        raise ShardError(f"tar header of another program at byte {position}")
    if header[KIND] != PLAIN:
        raise ShardError(f"member {name} at byte {position} is not a plain file")
    return name, size
