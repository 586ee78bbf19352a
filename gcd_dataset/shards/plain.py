"""A split as tars for programs that know nothing of this package: a ``.npy`` file a field, texts and pictures."""

import io
from collections.abc import Generator, Mapping
from pathlib import Path

import numpy as np

from gcd_dataset.files import make_folder, open_whole
from gcd_dataset.shards.codec import WIDTHS, decode_fields
from gcd_dataset.shards.layout import Bytes, fields_of, member_name
from gcd_dataset.shards.reader import ShardReader
from gcd_dataset.shards.tar import END, tar_entry

__all__ = ["write_plain"]

SAMPLES = 256  # of a tar


def write_plain(reader: ShardReader, folder: Path | str) -> Generator[int, None, None]:
    """Write a split as ``train-00000.tar``, …, yielding the position of each sample once it is written.

    A tar appears under its name when it is complete. Raises ``OutputError``, and ``ShardError`` for a damaged sample.
    """
    folder = make_folder(folder)
    for first in range(0, len(reader), SAMPLES):
        with open_whole(folder / f"{reader.split}-{first // SAMPLES:05d}.tar") as tar:
            for position in range(first, min(first + SAMPLES, len(reader))):
                with reader.naming(position):
                    members = _plain(reader.read(position, reader.layout.members))
                for member, data in members.items():
                    tar.write(tar_entry(member_name(reader.number(position), member), data))
                yield position
            tar.write(bytes(END))


def _plain(members: Mapping[str, Bytes]) -> dict[str, Bytes]:
    """Texts and pictures as they are, and arrays as ``FIELD.npy``."""
    arrays = decode_fields(members, [field for field in fields_of(members) if field in WIDTHS])
    others = {member: data for member, data in members.items() if not member.endswith(".z")}
    return {**others, **{f"{field}.npy": _npy(array) for field, array in arrays.items()}}


def _npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array(file, np.ascontiguousarray(array), version=(1, 0), allow_pickle=False)
    return file.getvalue()
