"""A tar of one sample: the form in which samples wait until their shard is complete."""

import zlib
from collections.abc import Mapping
from pathlib import Path

from gcd_dataset.errors import ShardError
from gcd_dataset.files import write_whole
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.index import scan_shard
from gcd_dataset.shards.layout import GARMENTS, Bytes, Layout, member_name
from gcd_dataset.shards.tar import END, tar_entry

__all__ = ["read_single", "write_single"]


def write_single(path: Path, index: int, members: Mapping[str, Bytes], layout: Layout = GARMENTS) -> None:
    """Write the members of a sample as a tar, atomically. Raises ``OutputError``."""
    entries = [tar_entry(member_name(index, member), members[member]) for member in layout.members]
    write_whole(path, b"".join([*entries, bytes(END)]))


def read_single(path: Path, layout: Layout = GARMENTS) -> dict[str, memoryview]:
    """The members of the sample in a tar, their CRC-32 checked. Raises ``ShardError``."""
    table = scan_shard(path, layout)
    if len(table) != 1:
        raise ShardError(f"{path}: {len(table)} samples, expected one")
    with reading(path):
        data = memoryview(bytearray(path.read_bytes()))
    entries = zip(layout.members, table.offset[0].tolist(), table.size[0].tolist(), table.crc[0].tolist(), strict=True)
    members = {}
    for member, offset, size, crc in entries:
        members[member] = data[offset : offset + size]
        if zlib.crc32(members[member]) != crc:
            raise ShardError(f"{path}: member {member}: bytes differ from the written ones")
    return members
