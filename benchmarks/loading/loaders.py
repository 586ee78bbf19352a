"""Ways to load the same garments as batches of ``collate_packed``: ours, three others, and what no loader beats."""

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

__all__ = ["BATCH", "WAYS", "Way"]

BATCH = 16
Way = Callable[[Path, Sequence[str], int], Iterable[Any] | None]
"""Folder of shards, fields, number of workers: an epoch's batches whenever it is iterated; ``None``: not to be had."""


def ours(folder: Path, fields: Sequence[str], workers: int) -> Iterable[Any]:
    """``GarmentLoader``, in random order."""
    return GarmentLoader(GarmentDataset(folder, fields=fields), BATCH, num_workers=workers)


def by_webdataset(folder: Path, fields: Sequence[str], workers: int) -> Iterable[Any]:
    """``webdataset`` over the same shards, in their order; members that are not asked for are passed over."""
    import webdataset

    wanted = members_of(fields)
    shards = sorted(map(str, folder.glob("*.tar")))
    stream = webdataset.WebDataset(
        shards, shardshuffle=False, select_files=lambda name: name.partition(".")[2] in wanted, empty_check=False
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
    """``litdata`` over chunks that hold these fields alone, as it would be given them, in random order."""
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
    """``h5py``: a group a garment, a contiguous array a field, in random order."""
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
    return _batches(_Plain(path, [name for name in fields if FIELDS[name].endswith(".npy")]), workers)


class _Plain(Dataset):
    """The groups of an HDF5 file, opened in each process."""

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
    """The stored bytes of the fields read out of the file cache and copied once, in random order; nothing else.

    Both buffers stay: no loader can hand out the same memory twice.
    """
    return None if workers else _Bytes(folder, fields)


class _Bytes:
    def __init__(self, folder: Path, fields: Sequence[str]) -> None:
        index = read_index(folder)
        columns = [index.layout.members.index(FIELDS[field]) for field in fields]
        offsets, sizes = index.table.offset[:, columns].tolist(), index.table.size[:, columns].tolist()
        self._places = [list(zip(*place, strict=True)) for place in zip(offsets, sizes, strict=True)]
        self._files = [os.open(folder / shard, os.O_RDONLY) for shard in index.shards]
        self._shard = index.shard.tolist()
        largest = max(map(sum, sizes))
        self._read, self._batch = np.empty(largest, np.uint8), np.empty(BATCH * largest, np.uint8)

    def __iter__(self) -> Iterator[None]:
        order, end = Permutation(len(self._places), 0), 0
        for place in range(len(self._places)):
            number, filled = order(place), 0
            for offset, size in self._places[number]:
                os.preadv(self._files[self._shard[number]], [self._read[filled : filled + size].data], offset)
                filled += size
            end = 0 if place % BATCH == 0 else end
            self._batch[end : end + filled] = self._read[:filled]
            end += filled
            if (place + 1) % BATCH == 0:
                yield


def _batches(dataset: Any, workers: int) -> DataLoader:
    mixed = len(dataset) > 0 if isinstance(dataset, _Plain) else False
    return DataLoader(
        dataset, BATCH, shuffle=mixed, num_workers=workers, collate_fn=collate_packed, persistent_workers=workers > 0
    )


WAYS: dict[str, Way] = {
    "ours": ours, "webdataset": by_webdataset, "litdata": by_litdata, "hdf5": by_hdf5, "floor": floor,
}  # fmt: skip
