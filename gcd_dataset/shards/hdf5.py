"""A split as one HDF5 file, for programs that read no tars.

A field is one array: the rows of all samples, one after the other, or the bytes of their JSON, texts or pictures;
sample i has the rows from ``FIELD_ptr[i]`` to ``FIELD_ptr[i + 1]``. ``index``, int64 [n], are the numbers of the
samples, as in their keys; ``crc32``, u4 [n], checksums of the rows of each, in the order of its fields. Attributes:
``format`` and ``split``, of fixed length; ``schema``, ``count``.

Arrays are contiguous and uncompressed: a sample takes one read per field. There are no strings of variable length: on
a damaged heap, where they would lie, libhdf5 loops forever.
"""

import io
import zlib
from collections.abc import Generator, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py
import numpy as np

from gcd_dataset.files import drafted, user_path
from gcd_dataset.shards.codec import DOUBLE, IDS, WIDTHS, decode_fields
from gcd_dataset.shards.layout import MOST_GARMENTS, MOST_VIEWS, SCHEMA, Bytes, fields_of, garments_layout
from gcd_dataset.shards.reader import ShardReader

FORMAT = "gcd_dataset garments"
MEMBER_OF = fields_of(
    garments_layout(caption=True, maps=True, pose=True, views=MOST_VIEWS, garments=MOST_GARMENTS).members
)
"""Field to member, of all fields that a file may hold."""


def form_of(field: str) -> tuple[np.dtype, tuple[int, ...]]:
    """Type and row shape of a field; bytes for texts and pictures."""
    kind = "<i4" if field in IDS else "<f8" if field in DOUBLE else "<f4" if field in WIDTHS else "u1"
    return np.dtype(kind), WIDTHS.get(field, ())


def crc_of(values: Iterable[np.ndarray]) -> int:
    """CRC-32 of arrays, one after the other."""
    return zlib.crc32(b"".join(value.tobytes() for value in values))


def write_hdf5(reader: ShardReader, path: Path | str) -> Generator[int, None, None]:
    """Write all samples of a split to an HDF5 file, yielding the position of each once it is stored.

    The file appears under its name when the iterator ends. Every sample is read twice, first for its size. Raises
    ``OutputError`` where the file cannot be written, ``ShardError`` for a damaged sample.
    """
    with drafted(user_path(path)) as draft, _Sink(draft, "r+") as sink, ThreadPoolExecutor(1) as thread:
        ends = {field: np.zeros(len(reader) + 1, np.int64) for field in fields_of(reader.layout.members)}
        for position in range(len(reader)):
            for field, value in _values(reader, position).items():
                ends[field][position + 1] = ends[field][position] + len(value)
        # In a thread, where no KeyboardInterrupt is raised: libhdf5 would take it for a failed write.
        file = thread.submit(_allocated, sink, reader, ends).result()
        try:
            for position in range(len(reader)):
                thread.submit(_store, file, position, _values(reader, position), ends).result()
                sink.check()
                yield position
        except (OSError, RuntimeError):
            sink.check()  # raises the OSError behind libhdf5's own error
            raise
        finally:
            thread.submit(file.close).result()
        sink.check()


def _values(reader: ShardReader, position: int) -> dict[str, np.ndarray]:
    """Field to rows."""
    members = reader.read(position, reader.layout.members)
    fields = fields_of(members)
    with reader.naming(position):
        arrays = decode_fields(members, [field for field in fields if field in WIDTHS])
    return {f: arrays[f] if f in arrays else np.frombuffer(members[fields[f]], np.uint8) for f in fields}


def _allocated(sink: "_Sink", reader: ShardReader, ends: Mapping[str, np.ndarray]) -> h5py.File:
    file = h5py.File(sink, "w")
    file.attrs.update(format=np.bytes_(FORMAT), schema=SCHEMA, split=np.bytes_(reader.split), count=len(reader))
    file["index"] = np.array([reader.number(position) for position in range(len(reader))], np.int64)
    file.create_dataset("crc32", (len(reader),), "<u4")
    for field, pointers in ends.items():
        dtype, row = form_of(field)
        file.create_dataset(field, (int(pointers[-1]), *row), dtype, fill_time="never")
        file[f"{field}_ptr"] = pointers
    return file


def _store(file: h5py.File, position: int, values: Mapping[str, np.ndarray], ends: Mapping[str, np.ndarray]) -> None:
    for field, rows in values.items():
        file[field][slice(*ends[field][position : position + 2])] = rows
    file["crc32"][position] = crc_of(values.values())


class _Sink(io.FileIO):
    """A file that hides failed writes from libhdf5, which aborts the process on a full disk; ``check`` raises them."""

    fault: OSError | None = None

    def check(self) -> None:
        """Raise the ``OSError`` of the first failed write, if any."""
        if self.fault is not None:
            raise self.fault

    def write(self, data: Bytes) -> int:  # type: ignore[override]
        rest = memoryview(data).cast("B")
        count = len(rest)
        try:
            while rest and self.fault is None:
                rest = rest[super().write(rest) :]
        except OSError as error:
            self.fault = error
        return count

    def truncate(self, size: int | None = None) -> int:
        try:
            return super().truncate(size) if self.fault is None else 0
        except OSError as error:
            self.fault = error
            return 0
