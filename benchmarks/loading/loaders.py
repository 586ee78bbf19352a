"""Batches of the same garments by their indices: ours, memory maps, and libraries that store arrays of any length."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gcd_dataset.loaders import GarmentDataset, GarmentLoader, Hdf5Garments, collate_packed
from gcd_dataset.loaders.batches import POINTS_TO, WHOLE
from gcd_dataset.shards.layout import members_of

__all__ = ["BATCH", "LOADERS", "Batches", "Loader", "pack"]

BATCH = 16
Batches = Callable[[Sequence[int]], Any]
"""Indices of garments to their batch."""
Loader = Callable[[Path, Sequence[str]], Batches | None]
"""``(folder of shards, fields)`` to the batches; ``None`` if the library is not installed. Copies are made once."""
Rows = Mapping[str, Sequence[np.ndarray]]


def ours(folder: Path, fields: Sequence[str]) -> Batches:
    """``GarmentDataset`` and ``collate_packed``, as a ``DataLoader`` calls them."""
    dataset = GarmentDataset(folder, fields=fields)
    return lambda indices: collate_packed(dataset.__getitems__(indices))


def by_garment_loader(folder: Path, fields: Sequence[str]) -> Batches:
    """``GarmentLoader``, its thread included, in an order of its own."""
    loader = GarmentLoader(GarmentDataset(folder, fields=fields), BATCH)
    batches: Iterator[Any] = iter(())

    def following(indices: Sequence[int]) -> Any:
        nonlocal batches
        if (batch := next(batches, None)) is None:
            batches = iter(loader)
            batch = next(batches)
        return batch

    return following


def by_memmap(folder: Path, fields: Sequence[str], *, plain: bool = False) -> Batches:
    """One ``.npy`` file a field, mapped, in 15 lines; ``plain`` as ``np.ndarray``, whose slices cost less."""
    rows, starts = {}, {}
    for field in fields:
        path = _copy(folder, "memmap", fields) / f"{field}.npy"
        if not path.exists():
            values = _values(folder, field)
            np.save(path, np.concatenate(values))
            np.save(path.with_suffix(".ptr.npy"), np.cumsum([0, *map(len, values)]))
        mapped = np.load(path, mmap_mode="r")
        rows[field] = np.asarray(mapped) if plain else mapped
        starts[field] = np.load(path.with_suffix(".ptr.npy")).tolist()

    def batch(indices: Sequence[int]) -> dict[str, Tensor]:
        return pack({f: [rows[f][starts[f][i] : starts[f][i + 1]] for i in indices] for f in fields})

    return batch


def by_plain_memmap(folder: Path, fields: Sequence[str]) -> Batches:
    return by_memmap(folder, fields, plain=True)


def by_hdf5(folder: Path, fields: Sequence[str]) -> Batches:
    """``Hdf5Garments``: concatenated arrays in one file."""
    from gcd_dataset.verbs import export

    path = folder / "garments.h5"
    if not path.exists():
        export(folder, path)
    dataset = Hdf5Garments(path, fields=fields)
    return lambda indices: collate_packed(dataset.__getitems__(indices))


def by_webdataset(folder: Path, fields: Sequence[str]) -> Batches | None:
    """``webdataset`` over the same tars, one after the other, with our decoder; other members are skipped."""
    import webdataset

    from gcd_dataset import decode

    members, shards = members_of(fields), sorted(map(str, folder.glob("*.tar")))
    stream = webdataset.WebDataset(
        shards, shardshuffle=False, select_files=lambda name: name.partition(".")[2] in members, empty_check=False
    )
    samples: Iterator[Any] = iter(())

    def following(indices: Sequence[int]) -> Any:
        nonlocal samples
        found: list[Any] = []
        while len(found) < len(indices):
            if (sample := next(samples, None)) is None:
                samples = iter(stream)
                continue
            fields_of = decode(sample)
            found.append({field: fields_of[field] for field in fields})
        return pack({field: [item[field] for item in found] for field in fields})

    return following


def by_litdata(folder: Path, fields: Sequence[str]) -> Batches | None:
    """``litdata`` over chunks of these fields alone, its best case."""
    if find_spec("litdata") is None:
        return None
    from litdata import StreamingDataset
    from litdata.streaming.writer import BinaryWriter

    copy = _copy(folder, "litdata", fields)
    if not (copy / "index.json").exists():
        writer = BinaryWriter(str(copy), chunk_bytes="64MB")
        for number, item in enumerate(_items(folder, fields)):
            writer.add_item(number, {field: torch.from_numpy(value) for field, value in item.items()})
        writer.done()
        writer.merge()
    dataset = StreamingDataset(str(copy))
    return lambda indices: _packed_items([{f: v.numpy() for f, v in dataset[i].items()} for i in indices])


def by_streaming(folder: Path, fields: Sequence[str]) -> Batches | None:
    """``mosaicml-streaming`` over uncompressed shards of these fields alone."""
    if find_spec("streaming") is None:
        return None
    from streaming import LocalDataset, MDSWriter

    copy = _copy(folder, "streaming", fields)
    if not (copy / "index.json").exists():
        with MDSWriter(out=str(copy), columns=dict.fromkeys(fields, "ndarray"), exist_ok=True) as writer:
            for item in _items(folder, fields):
                writer.write(item)
    dataset = LocalDataset(str(copy))
    return lambda indices: _packed_items([dataset[i] for i in indices])


def by_ninja(folder: Path, fields: Sequence[str]) -> Batches | None:
    """``mmap_ninja``: a ``RaggedMmap`` a field."""
    if find_spec("mmap_ninja") is None:
        return None
    from mmap_ninja import RaggedMmap

    copy = _copy(folder, "ninja", fields)
    for field in fields:
        if not (copy / field).exists():
            RaggedMmap.from_lists(copy / field, _values(folder, field))
    maps = {field: RaggedMmap(copy / field) for field in fields}
    return lambda indices: pack({field: [maps[field][i] for i in indices] for field in fields})


def by_lance(folder: Path, fields: Sequence[str]) -> Batches | None:
    """``lance``: a row a garment, a list of numbers a field; ``take`` of the rows."""
    if find_spec("lance") is None:
        return None
    import lance

    copy = _copy(folder, "lance", fields) / "set.lance"
    if not copy.exists():
        lance.write_dataset(_table(folder, fields), copy)
    dataset, shapes = lance.dataset(copy), _shapes(folder, fields)
    return lambda indices: pack(_of_table(dataset.take(list(indices)), shapes))


def by_arrow(folder: Path, fields: Sequence[str]) -> Batches | None:
    """Arrow's IPC file, mapped; ``take`` of the rows."""
    if find_spec("pyarrow") is None:
        return None
    import pyarrow as pa

    copy = _copy(folder, "arrow", fields) / "set.arrow"
    if not copy.exists():
        table = _table(folder, fields)
        with pa.OSFile(str(copy), "wb") as file, pa.ipc.new_file(file, table.schema) as writer:
            writer.write_table(table)
    table, shapes = pa.ipc.open_file(pa.memory_map(str(copy))).read_all().combine_chunks(), _shapes(folder, fields)
    return lambda indices: pack(_of_table(table.take(list(indices)), shapes))


LOADERS: dict[str, Loader] = {
    "ours": ours, "GarmentLoader": by_garment_loader, "memmap": by_memmap, "memmap as ndarray": by_plain_memmap,
    "mmap_ninja": by_ninja, "hdf5": by_hdf5, "arrow": by_arrow, "lance": by_lance, "litdata": by_litdata,
    "mosaicml-streaming": by_streaming, "webdataset": by_webdataset,
}  # fmt: skip


def pack(rows: Rows) -> dict[str, Tensor]:
    """The arrays of a batch one after the other, copied once, and their starts; row numbers index the whole batch."""
    starts = {field: np.cumsum([0, *map(len, values)]) for field, values in rows.items()}
    batch = {f"{field}_ptr": torch.from_numpy(start) for field, start in starts.items()}
    for field, values in rows.items():
        kind = np.float32 if values[0].dtype.kind == "f" else values[0].dtype
        out = np.empty((starts[field][-1], *values[0].shape[1:]), kind)
        columns = [(column, starts["verts" if target == "vertices" else target]) for column, target in _targets(field)]
        if columns and columns[0][0] == WHOLE:
            for number, value in enumerate(values):
                begin, end = starts[field][number : number + 2]
                np.add(value, columns[0][1][number], out=out[begin:end], casting="unsafe")
        else:
            np.concatenate(values, out=out, casting="unsafe")
            for column, offsets in columns:
                of_rows = np.repeat(offsets[:-1], np.diff(starts[field])).astype(kind)
                out[:, column] += of_rows if isinstance(column, int) else of_rows[:, None]
        batch[field] = torch.from_numpy(out)
    return batch


def _targets(field: str) -> Sequence[tuple[slice | int, str]]:
    return POINTS_TO.get(field, ())


def _packed_items(items: Sequence[Mapping[str, np.ndarray]]) -> dict[str, Tensor]:
    return pack({field: [item[field] for item in items] for field in items[0]})


def _items(folder: Path, fields: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
    dataset: Any = GarmentDataset(folder, fields=fields)
    return ({field: item[field].numpy() for field in fields} for item in (dataset[i] for i in range(len(dataset))))


def _values(folder: Path, field: str) -> list[np.ndarray]:
    return [item[field] for item in _items(folder, [field])]


def _copy(folder: Path, name: str, fields: Sequence[str]) -> Path:
    copy = folder / "copies" / name / "-".join(fields)
    copy.mkdir(parents=True, exist_ok=True)
    return copy


def _shapes(folder: Path, fields: Sequence[str]) -> dict[str, tuple[int, ...]]:
    return {field: _values(folder, field)[0].shape[1:] for field in fields}


def _table(folder: Path, fields: Sequence[str]) -> Any:
    import pyarrow as pa

    return pa.table({field: [value.ravel() for value in _values(folder, field)] for field in fields})


def _of_table(table: Any, shapes: Mapping[str, tuple[int, ...]]) -> Rows:
    columns = {field: table.column(field).combine_chunks() for field in shapes}
    return {
        field: [
            column.values.to_numpy(zero_copy_only=False)[begin:end].reshape(-1, *shapes[field])
            for begin, end in zip(column.offsets.to_numpy()[:-1], column.offsets.to_numpy()[1:], strict=True)
        ]
        for field, column in columns.items()
    }
