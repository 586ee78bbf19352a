"""Loaders of the same garments as batches of ``collate_packed``: ours, three others, and a lower bound."""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from gcd_dataset.loaders import GarmentDataset, GarmentLoader, collate_packed
from gcd_dataset.loaders.base import Item, tensor_of
from gcd_dataset.loaders.order import Permutation
from gcd_dataset.shards import read_index
from gcd_dataset.shards.codec import decode_fields
from gcd_dataset.shards.layout import FIELDS, members_of

__all__ = ["BATCH", "LOADERS", "Loader"]

BATCH = 16
Loader = Callable[[Path, Sequence[str], int], Iterable[Any] | None]
"""``(folder of shards, fields, workers)`` to an iterable of an epoch's batches; ``None`` if not available."""


def ours(folder: Path, fields: Sequence[str], workers: int) -> Iterable[Any]:
    """``GarmentLoader``, in random order."""
    return GarmentLoader(GarmentDataset(folder, fields=fields), BATCH, num_workers=workers)


def by_webdataset(folder: Path, fields: Sequence[str], workers: int) -> Iterable[Any]:
    """``webdataset`` over the same shards, sequentially; unneeded members are skipped."""
    import webdataset

    members = members_of(fields)
    shards = sorted(map(str, folder.glob("*.tar")))
    stream = webdataset.WebDataset(
        shards, shardshuffle=False, select_files=lambda name: name.partition(".")[2] in members, empty_check=False
    )
    return _batches(stream.map(_Decoded(fields)), workers)


class _Decoded:
    """A sample of ``webdataset`` as an item."""

    def __init__(self, fields: Sequence[str]) -> None:
        self._fields = fields

    def __call__(self, sample: dict[str, Any]) -> Item:
        values = decode_fields(sample, self._fields)
        return {n: tensor_of(v, torch.float32) if isinstance(v, np.ndarray) else v for n, v in values.items()}


def by_litdata(folder: Path, fields: Sequence[str], workers: int) -> Iterable[Any] | None:
    """``litdata`` over chunks that hold only these fields, its best case, in random order."""
    if find_spec("litdata") is None:
        return None
    from litdata import StreamingDataLoader, StreamingDataset
    from litdata.streaming.writer import BinaryWriter

    chunks = folder / "litdata" / "-".join(fields)
    if not (chunks / "index.json").exists():
        chunks.mkdir(parents=True, exist_ok=True)
        writer = BinaryWriter(str(chunks), chunk_bytes="64MB")
        for number, item in enumerate(GarmentDataset(folder, fields=fields)):
            writer.add_item(number, item)
        writer.done()
        writer.merge()
    return StreamingDataLoader(
        StreamingDataset(str(chunks), shuffle=True),
        batch_size=BATCH,
        num_workers=workers,
        collate_fn=collate_packed,
        persistent_workers=workers > 0,
    )


def by_hdf5(folder: Path, fields: Sequence[str], workers: int) -> Iterable[Any] | None:
    """``h5py``: one group per garment, one contiguous array per field, in random order."""
    if find_spec("h5py") is None:
        return None
    import h5py

    path = folder / "plain.h5"
    if not path.exists():
        with h5py.File(path, "w") as file:
            for number, item in enumerate(GarmentDataset(folder)):
                arrays = {name: value.numpy() for name, value in item.items() if isinstance(value, Tensor)}
                for name, array in arrays.items():
                    file.create_dataset(f"{number}/{name}", data=array)
    return _batches(_Hdf5Arrays(path, [name for name in fields if FIELDS[name].endswith(".npy")]), workers)


class _Hdf5Arrays(Dataset):
    """The groups of an HDF5 file; each process opens the file."""

    def __init__(self, path: Path, fields: Sequence[str]) -> None:
        import h5py

        self._path, self._fields = path, fields
        self._file: Any = None
        with h5py.File(path) as file:
            self._length = len(file)

    def __len__(self) -> int:
        return self._length

    def __getitem__(self, index: int) -> Item:
        import h5py

        if self._file is None:
            self._file = h5py.File(self._path)
        group = self._file[str(index)]
        return {name: torch.from_numpy(group[name][()]) for name in self._fields}


def floor(folder: Path, fields: Sequence[str], workers: int) -> Iterable[Any] | None:
    """A lower bound: reads the stored bytes of the fields from the page cache and copies them once, in random order.

    It reuses both buffers; a loader cannot, since batches keep their memory.
    """
    return None if workers else _Bytes(folder, fields)


class _Bytes:
    def __init__(self, folder: Path, fields: Sequence[str]) -> None:
        index = read_index(folder)
        columns = [index.layout.members.index(FIELDS[field]) for field in fields]
        offsets, sizes = index.table.offset[:, columns].tolist(), index.table.size[:, columns].tolist()
        self._spans = [list(zip(*spans, strict=True)) for spans in zip(offsets, sizes, strict=True)]
        self._files = [os.open(folder / shard, os.O_RDONLY) for shard in index.shards]
        self._shard = index.shard.tolist()
        largest = max(map(sum, sizes))
        self._read, self._batch = np.empty(largest, np.uint8), np.empty(BATCH * largest, np.uint8)

    def __iter__(self) -> Iterator[None]:
        order, end = Permutation(len(self._spans), 0), 0
        for offset_in_epoch in range(len(self._spans)):
            index, filled = order(offset_in_epoch), 0
            for offset, size in self._spans[index]:
                os.preadv(self._files[self._shard[index]], [self._read[filled : filled + size].data], offset)
                filled += size
            end = 0 if offset_in_epoch % BATCH == 0 else end
            self._batch[end : end + filled] = self._read[:filled]
            end += filled
            if (offset_in_epoch + 1) % BATCH == 0:
                yield


def _batches(dataset: Any, workers: int) -> DataLoader:
    is_indexed = isinstance(dataset, _Hdf5Arrays) and len(dataset) > 0
    return DataLoader(
        dataset,
        BATCH,
        shuffle=is_indexed,
        num_workers=workers,
        collate_fn=collate_packed,
        persistent_workers=workers > 0,
    )


LOADERS: dict[str, Loader] = {
    "ours": ours, "webdataset": by_webdataset, "litdata": by_litdata, "hdf5": by_hdf5, "floor": floor,
}  # fmt: skip
