"""Batches of the same garments by their indices: ours, memory maps, and libraries that store arrays of any length.

Copies for other libraries hold the fields to be read alone, which is their best case. They lie in ``FOLDER/copies``.
"""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gcd_dataset.loaders import GarmentDataset, GarmentLoader, Hdf5Garments, collate_packed
from gcd_dataset.loaders.batches import POINTS_TO, WHOLE
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import Edge, EdgeRef, Panel, Pattern, Placement, Sample, Seam
from gcd_dataset.shards import ShardWriter, encode_sample
from gcd_dataset.shards.index import GRADES, OUTCOMES, SplitIndex, index_name
from gcd_dataset.shards.layout import MEMBERS, is_picture, member_name, members_of
from gcd_dataset.shards.manifest import MANIFEST, Manifest, Plan, ShardRecord, SplitRecord
from gcd_dataset.shards.tar import BLOCK, END, tar_entry

BATCH = 16
Batches = Callable[[Sequence[int]], Any]
"""Indices of garments to their batch."""
Rows = Mapping[str, Sequence[np.ndarray]]


def opened(folder: Path, fields: Sequence[str]) -> GarmentDataset:
    """The garments, with their cache in the folder."""
    return GarmentDataset(folder, fields=fields, cache_dir=folder / "cache")


def ours(folder: Path, fields: Sequence[str]) -> Batches:
    """``GarmentDataset`` and ``collate_packed``, as a ``DataLoader`` calls them."""
    dataset = opened(folder, fields)
    return lambda indices: collate_packed(dataset.__getitems__(indices))


def by_garment_loader(folder: Path, fields: Sequence[str]) -> Batches:
    """``GarmentLoader``, its thread included, in an order of its own."""
    return following(_epochs(GarmentLoader(opened(folder, fields), BATCH)))


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


def by_hdf5(folder: Path, fields: Sequence[str]) -> Batches:
    """``Hdf5Garments``: concatenated arrays in one file."""
    from gcd_dataset import export

    path = folder / "garments.h5"
    if not path.exists():
        export(folder, path)
    dataset = Hdf5Garments(path, fields=fields)
    return lambda indices: collate_packed(dataset.__getitems__(indices))


def by_webdataset(folder: Path, fields: Sequence[str]) -> Batches:
    """``webdataset`` over the same tars, one after the other, with our decoder; other members are skipped."""
    import webdataset

    from gcd_dataset import decode

    members, shards = members_of(fields), sorted(map(str, folder.glob("*.tar")))
    stream = webdataset.WebDataset(
        shards, shardshuffle=False, select_files=lambda name: name.partition(".")[2] in members, empty_check=False
    )
    samples = ({field: decoded[field] for field in fields} for decoded in map(decode, _epochs(stream)))
    return lambda indices: packed_items([next(samples) for _ in indices])


def by_litdata(folder: Path, fields: Sequence[str]) -> Batches:
    """``litdata`` over chunks of these fields alone."""
    from litdata import StreamingDataset

    dataset = StreamingDataset(str(write_litdata(folder, fields)))
    return lambda indices: packed_items([arrays_of(dataset[i]) for i in indices])


def write_litdata(folder: Path, fields: Sequence[str]) -> Path:
    """The garments as chunks of ``litdata``."""
    from litdata.streaming.writer import BinaryWriter

    copy = _copy(folder, "litdata", fields)
    if not (copy / "index.json").exists():
        writer = BinaryWriter(str(copy), chunk_bytes="64MB")
        for number, item in enumerate(_items(folder, fields)):
            writer.add_item(number, {field: torch.from_numpy(value) for field, value in item.items()})
        writer.done()
        writer.merge()
    return copy


def arrays_of(item: Mapping[str, Tensor]) -> dict[str, np.ndarray]:
    return {field: value.numpy() for field, value in item.items()}


def by_streaming(folder: Path, fields: Sequence[str]) -> Batches:
    """``mosaicml-streaming`` over uncompressed shards of these fields alone."""
    from streaming import LocalDataset

    dataset = LocalDataset(str(write_streaming(folder, fields)))
    return lambda indices: packed_items([dataset[i] for i in indices])


def write_streaming(folder: Path, fields: Sequence[str]) -> Path:
    """The garments as shards of ``mosaicml-streaming``."""
    from streaming import MDSWriter

    copy = _copy(folder, "streaming", fields)
    if not (copy / "index.json").exists():
        with MDSWriter(out=str(copy), columns=dict.fromkeys(fields, "ndarray"), exist_ok=True) as writer:
            for item in _items(folder, fields):
                writer.write(item)
    return copy


def by_arrow(folder: Path, fields: Sequence[str]) -> Batches:
    """Arrow's IPC file, mapped; ``take`` of the rows."""
    import pyarrow as pa

    copy = _copy(folder, "arrow", fields) / "set.arrow"
    if not copy.exists():
        table = _table(folder, fields)
        with pa.OSFile(str(copy), "wb") as file, pa.ipc.new_file(file, table.schema) as writer:
            writer.write_table(table)
    table, shapes = pa.ipc.open_file(pa.memory_map(str(copy))).read_all().combine_chunks(), _shapes(folder, fields)
    return lambda indices: pack(_of_table(table.take(list(indices)), shapes))


LOADERS: Mapping[str, tuple[str, Callable[[Path, Sequence[str]], Batches]]] = {
    "ours": ("torch", ours),
    "GarmentLoader": ("torch", by_garment_loader),
    "memmap": ("numpy", by_memmap),
    "memmap as ndarray": ("numpy", partial(by_memmap, plain=True)),
    "HDF5": ("h5py", by_hdf5),
    "Arrow": ("pyarrow", by_arrow),
    "litdata": ("litdata", by_litdata),
    "mosaicml streaming": ("streaming", by_streaming),
    "webdataset": ("webdataset", by_webdataset),
}
"""Name to the module that must be installed, and ``(folder of shards, fields)`` to the batches."""


def installed_loaders(folder: Path, fields: Sequence[str]) -> dict[str, Batches]:
    """The loaders that are installed, each with its own copy of the garments."""
    return {name: load(folder, fields) for name, (module, load) in LOADERS.items() if find_spec(module) is not None}


def following(batches: Iterator[Any]) -> Batches:
    """The next batch, whatever the indices."""
    return lambda indices: next(batches)


def pack(rows: Rows) -> dict[str, Tensor]:
    """The arrays of a batch one after the other, copied once, and their starts; row numbers index the whole batch."""
    starts = {field: np.cumsum([0, *map(len, values)]) for field, values in rows.items()}
    batch = {f"{field}_ptr": torch.from_numpy(start) for field, start in starts.items()}
    for field, values in rows.items():
        kind = np.float32 if values[0].dtype.kind == "f" else values[0].dtype
        out = np.empty((starts[field][-1], *values[0].shape[1:]), kind)
        pointing = POINTS_TO.get(field, ())
        columns = [(column, starts["verts" if target == "vertices" else target]) for column, target in pointing]
        if columns and columns[0][0] == WHOLE:
            for number, value in enumerate(values):
                begin, end = starts[field][number : number + 2]
                np.add(value, columns[0][1][number], out=out[begin:end], casting="unsafe")
        else:
            np.concatenate(values, out=out, casting="unsafe")
            for column, offsets in columns:
                of_rows = np.repeat(offsets[:-1], np.diff(starts[field])).astype(kind)
                for entries in out.T[column]:  # one by one: broadcasting over short rows takes ten times as long
                    entries += of_rows
        batch[field] = torch.from_numpy(out)
    return batch


def packed_items(items: Sequence[Mapping[str, np.ndarray]]) -> dict[str, Tensor]:
    return pack({field: [item[field] for item in items] for field in items[0]})


def _epochs(items: Any) -> Iterator[Any]:
    """The items of one epoch after the other."""
    while True:
        yield from items


def _items(folder: Path, fields: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
    dataset: Any = opened(folder, fields)
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


CONFIGS: Mapping[str, tuple[str, ...]] = {
    "geometry": ("panels", "faces", "uv", "panel_id", "verts"),
    "points": ("panels", "edges", "stitches", "points"),
    "patterns": ("panels", "edges", "stitches"),
}
"""Configuration to the fields that are read; the shards hold all fields."""

FINENESS = 16  # 14 500 vertices on average: a dress at 1 cm has 14 475
POINTS = 8192
PANELS, CORNERS, SEAMS = 11, 7, 28  # the mean of GarmentCodeData's patterns: 10.9 panels of 6.8 edges, 28 stitches
SHARD = 32  # samples per shard: small, so that every worker of a stream has shards of its own
LARGE_SHARD, SAMPLE = 128, 130_048  # samples of a shard of a large data set; bytes of a sample
RECIPE = {"fake": True, "fineness": FINENESS}


def large_sample(index: int) -> Sample:
    """A finely meshed tube with a patchwork as its pattern."""
    sample = fake_sample(0, index, fineness=FINENESS, points=POINTS)
    assert sample.box_mesh is not None
    names = tuple(f"panel_{i}" for i in range(PANELS))
    patch = np.arange(len(sample.box_mesh.faces)) * PANELS // len(sample.box_mesh.faces)
    mesh = replace(sample.box_mesh, panel_id=patch, panel_names=names, panel_labels=PANELS * ("body",))
    return replace(
        sample, pattern=_patchwork(sample.key, names), box_mesh=replace(mesh, labels={}, seams=mesh.seams[:0])
    )


def _patchwork(name: str, names: tuple[str, ...]) -> Pattern:
    """Regular polygons, sewn together edge by edge."""
    angle = 2 * np.pi * np.arange(CORNERS) / CORNERS
    corners = 20 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    edges = tuple(Edge(i, (i + 1) % CORNERS) for i in range(CORNERS))
    still = np.zeros(3)
    panels = tuple(
        Panel(panel, corners, edges, Placement(np.array([40.0 * i, 0, 0]), still)) for i, panel in enumerate(names)
    )
    sides = [EdgeRef(panel, edge) for edge in range(CORNERS) for panel in names]
    seams = tuple(Seam(left, right) for left, right in zip(sides[::2], sides[1::2], strict=False))
    return Pattern(name, panels, seams[:SEAMS])


def write_shards(folder: Path, count: int) -> Path:
    """Write the first ``count`` garments as shards. Returns the folder."""
    with ShardWriter(folder, seed=0, recipe=RECIPE, shard_size=SHARD) as writer:
        for index in range(count):
            writer.write(large_sample(index))
    return folder


def write_large_index(folder: Path, count: int) -> int:
    """Write manifest and index of ``count`` samples, only the first of which exists. Returns the bytes of the index."""
    folder.mkdir(parents=True, exist_ok=True)
    shards = tuple(
        ShardRecord(number, min(LARGE_SHARD, count - first), SAMPLE * LARGE_SHARD + END, f"{number:064x}")
        for number, first in enumerate(range(0, count, LARGE_SHARD))
    )
    for shard in shards:
        with (folder / shard.name("train")).open("wb") as file:
            file.truncate(shard.size)  # takes no room
    members = encode_sample(fake_sample(0, 0))
    first = b"".join(tar_entry(member_name(0, name), data) for name, data in members.items() if not is_picture(name))
    with (folder / shards[0].name("train")).open("r+b") as file:
        file.write(first)
    plan = Plan("garments", 0, {"stage": "drape", "points": POINTS}, count, LARGE_SHARD)
    record = SplitRecord(plan, shards, tuple(member for member in MEMBERS if not is_picture(member)))
    random, numbers = np.random.default_rng(0), np.arange(count, dtype=np.int32)
    blocks = numbers % LARGE_SHARD * (SAMPLE // BLOCK) + random.integers(0, SAMPLE // BLOCK - 1, count, np.int32)
    blocks[:2] = 0, len(first) // BLOCK
    grades = random.choice([GRADES.index("clean"), GRADES.index("paper")], count, p=[0.98, 0.02]).astype(np.uint8)
    outcomes = np.full(count, OUTCOMES.index("SETTLED"), np.uint8)
    index = SplitIndex(record, numbers, blocks.astype(np.int32), np.zeros(0, np.int32), grades, outcomes).to_bytes()
    record = replace(record, index_sha256=hashlib.sha256(index).hexdigest())
    (folder / index_name("train")).write_bytes(index)
    (folder / MANIFEST).write_bytes(Manifest({"train": record}).to_bytes())
    return len(index)
