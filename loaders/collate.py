"""Collate functions: items of different sizes to one batch, packed or padded."""

import math
from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data._utils.collate import collate, default_collate_fn_map

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import GarmentItem, Item
from gcd_dataset.loaders.batches import POINTS_TO, RAGGED, WHOLE, PackedBatch, PaddedBatch, starts_of
from gcd_dataset.loaders.one_thread import add, concatenate, fill
from gcd_dataset.loaders.stored import StoredItems
from gcd_dataset.loaders.worker import naming_full, sent, unwrap
from gcd_dataset.shards.buffers import read_buffer


def collate_list(items: Sequence[Any]) -> list[Any]:
    """The items in a list, unchanged."""
    return unwrap(sent(list(items)))


def collate_packed(items: Sequence[Item]) -> PackedBatch:
    """Concatenate ragged arrays, as PyTorch Geometric batches graphs; stack the others.

    - A ragged field (``RAGGED``: meshes and patterns) is concatenated along its rows. ``<field>_ptr``, int64 [B+1],
      holds the start of each garment: garment k is ``batch["verts"][ptr[k]:ptr[k + 1]]``.
    - Row numbers are offset to index the concatenated arrays: ``batch["verts"][batch["faces"]]`` are the triangles of
      the whole batch. ``faces``, ``uv_vertex`` and the first column of ``labels`` and ``seams`` refer to ``verts`` and
      ``box``; ``corners`` to ``uv``; ``panel_id`` and ``edges[:, EdgeColumn.PANEL]`` to ``panels``; ``stitches[:, :2]``
      to ``edges``; ``seams[:, 1]`` to ``stitches``. Data types stay. The field referred to must be in the items. The
      second column of ``labels`` stays a row of each garment's ``edge_labels``.
    - Tensors of equal shape, such as ``body``, ``points``, ``front`` and ``back``, are stacked to [B, …].
    - Any other value, such as parsed JSON or the entries a ``transform`` adds, becomes a list of length B.
    - ``batch_size`` is B.

    Raises ``ConfigError`` for an empty batch, items with different fields, different types of one field, row numbers
    without the field that they refer to, and a batch of draped and undraped garments.

    >>> item = {"verts": torch.zeros(3, 3), "faces": torch.tensor([[0, 1, 2]])}
    >>> batch = collate_packed([item, item])
    >>> batch["faces"].tolist(), batch["verts_ptr"].tolist()
    ([[0, 1, 2], [3, 4, 5]], [0, 3, 6])
    """
    if isinstance(items, StoredItems):
        return unwrap(sent(_pack_stored(items)))
    _require_same_fields(items)
    batch = PackedBatch(batch_size=len(items))
    rows = {field: [item[field].shape[0] for item in items] for field in RAGGED if field in items[0]}
    batch |= {f"{field}_ptr": torch.tensor([0, *accumulate(counts)]) for field, counts in rows.items()}
    for field in items[0]:
        values = [item[field] for item in items]
        batch[field] = _pack(values, rows[field], batch, field) if field in rows else _stacked(values, field)
    return unwrap(sent(batch))


def collate_padded(items: Sequence[Item], *, rows: Mapping[str, int] | None = None) -> PaddedBatch:
    """Pad ragged arrays to equal length and stack everything, for networks with inputs of fixed shape.

    - A ragged field becomes [B, n, …], n the rows of the longest garment of the batch; ``<field>_mask``, bool [B, n],
      is true on real rows. Padding is 0 in floating arrays, false in boolean ones, and -1 in integer arrays: a
      row number that refers to nothing.
    - Row numbers count within the garment: ``faces[k]`` are rows of ``verts[k]``.
    - ``rows``: field to a fixed n for all batches: ``functools.partial(collate_padded, rows={"panels": 40})``.
    - All other fields as in ``collate_packed``.

    Raises ``ConfigError`` for an empty batch, items with different fields, and a garment with more rows than ``rows``.

    >>> items = [{"panels": torch.ones(2, 14)}, {"panels": torch.ones(3, 14)}]
    >>> batch = collate_padded(items)
    >>> tuple(batch.panels.shape), batch["panels_mask"].tolist()
    ((2, 3, 14), [[True, True, False], [True, True, True]])
    """
    _require_same_fields(items)
    batch = PaddedBatch(batch_size=len(items))
    for field in items[0]:
        values = [item[field] for item in items]
        if field in RAGGED:
            batch[field], batch[f"{field}_mask"] = _pad(values, field, (rows or {}).get(field))
        else:
            batch[field] = _stacked(values, field)
    return unwrap(sent(batch))


def _pack_stored(items: StoredItems) -> PackedBatch:
    """The same batch from stored rows: each is copied once."""
    # Arrays until the end: a call of torch takes several times as long as one of NumPy.
    columns = {field: items.column(field) for field in items.fields}
    counts = {field: list(map(len, values)) for field, values in columns.items() if field in RAGGED}
    starts = {f"{field}_ptr": np.array([0, *accumulate(lengths)]) for field, lengths in counts.items()}
    batch = PackedBatch(batch_size=len(items))
    batch |= {name: torch.from_numpy(pointers) for name, pointers in starts.items()}
    for field, values in columns.items():
        if field in counts:
            batch[field] = _concatenated(values, counts[field], items.dtype, starts, field)
        elif isinstance(values[0], np.ndarray) and len(set(map(len, values))) == 1:
            rows = _concatenated(values, list(map(len, values)), items.dtype, starts, field)
            batch[field] = rows.view(len(values), *values[0].shape)
        else:
            batch[field] = _stacked(values, field)
    return batch


def _concatenated(
    values: Sequence[np.ndarray],
    counts: Sequence[int],
    dtype: torch.dtype | None,
    starts: Mapping[str, np.ndarray],
    field: str,
) -> Tensor:
    """Stored rows as one tensor; row numbers in them are offset by each garment's start."""
    first = values[0]
    kind = first.dtype if first.dtype.kind != "f" or dtype is None else NUMPY_TYPES.get(dtype)
    if kind is None:  # such as bfloat16, which NumPy lacks
        return torch.cat([torch.from_numpy(value).to(dtype) for value in values])
    shape = (sum(counts), *first.shape[1:])
    out = np.ndarray(shape, kind, read_buffer(math.prod(shape) * kind.itemsize))
    pointing = POINTS_TO.get(field, ())
    if pointing and pointing[0][0] == WHOLE:  # copy and offset in one pass: the largest arrays
        begin, offsets = 0, starts_of(starts, field, pointing[0][1]).tolist()
        for value, count, offset in zip(values, counts, offsets, strict=False):
            np.add(value, offset, out=out[begin : begin + count], casting="unsafe")
            begin += count
        return torch.from_numpy(out)
    np.concatenate(values, out=out, casting="unsafe")
    for columns, target in pointing:
        offsets = starts_of(starts, field, target)[:-1].astype(kind).repeat(counts)
        for column in out.T[columns]:  # one by one: broadcasting over short rows takes ten times as long
            column += offsets
    return torch.from_numpy(out)


NUMPY_TYPES: Mapping[torch.dtype, np.dtype[Any]] = {
    torch.float16: np.dtype("f2"),
    torch.float32: np.dtype("f4"),
    torch.float64: np.dtype("f8"),
}


def _require_same_fields(items: Sequence[Item]) -> None:
    if not items:
        raise ConfigError("an empty batch: give one garment or more")
    for item in items:
        if not isinstance(item, Mapping):
            raise ConfigError(
                f"an item of the batch is a {type(item).__name__}, not a dict of fields: let the transform return a "
                "dict, or give the loader collate_fn=collate_list or torch's default_collate"
            )
        if item.keys() != items[0].keys():
            odd = ", ".join(sorted(item.keys() ^ items[0].keys()))
            raise ConfigError(f"only some garments of the batch have {odd}: choose the same fields for all")


def _require_same_type(values: Sequence[Tensor], field: str) -> None:
    """Raise ``ConfigError`` for different types of one field: in one array some would lose digits."""
    if any(value.dtype != values[0].dtype for value in values):
        types = ", ".join(dict.fromkeys(str(value.dtype) for value in values))
        raise ConfigError(
            f"{field} has types {types} in one batch: give the data set one type, such as dtype=torch.float32"
        )


def _pack(values: list[Tensor], counts: list[int], batch: PackedBatch, field: str) -> Tensor:
    """The concatenated rows; row numbers in them are offset by each garment's start."""
    _require_same_type(values, field)
    starts = [(column, starts_of(batch, field, target)) for column, target in POINTS_TO.get(field, ())]
    rows = _empty((sum(counts), *values[0].shape[1:]), values[0])
    if starts and starts[0][0] == WHOLE:  # copy and offset in one pass: the largest arrays
        for value, start, out in zip(values, starts[0][1].tolist(), torch.split(rows, counts), strict=False):
            add(value, start, out)
        return rows
    concatenate(values, rows)
    for column, start in starts:
        offsets = start[:-1].to(rows.dtype).repeat_interleave(torch.tensor(counts), output_size=len(rows))
        entries = rows[:, column]
        entries += offsets if entries.ndim == 1 else offsets[:, None]
    return rows


def _pad(values: list[Tensor], field: str, count: int | None) -> tuple[Tensor, Tensor]:
    """The padded values [B, n, …] and their mask [B, n]."""
    _require_same_type(values, field)
    lengths = [len(value) for value in values]
    longest = max(lengths) if count is None else count
    if max(lengths) > longest:
        raise ConfigError(
            f"a garment has {max(lengths)} rows of {field}, more than rows={longest}: give more, or leave rows out"
        )
    rows = _empty((len(values), longest, *values[0].shape[1:]), values[0])
    padding = 0 if values[0].is_floating_point() or values[0].dtype == torch.bool else -1
    for value, out in zip(values, rows, strict=True):
        concatenate([value], out[: len(value)])
        fill(out[len(value) :], padding)
    mask = np.arange(longest) < np.array(lengths)[:, None]
    return rows, torch.from_numpy(mask).to(values[0].device)


def _stacked(values: list[Any], field: str) -> Any:
    """Tensors of equal shape stacked; anything else as a list."""
    first = values[0]
    if all(isinstance(value, Tensor) and value.shape == first.shape for value in values):
        _require_same_type(values, field)
        batch = _empty((len(values), *first.shape), first)
        concatenate([value[None] for value in values], batch)
        return batch
    return values


def _empty(shape: Sequence[int], like: Tensor) -> Tensor:
    """Memory for a batch; on the CPU from a pool of buffers that are reused."""
    size = math.prod(shape) * like.itemsize
    if not size or like.device.type != "cpu":
        return torch.empty(shape, dtype=like.dtype, device=like.device)
    return torch.from_numpy(read_buffer(size)).view(like.dtype).view(shape)


def _default_collate(items: Sequence[GarmentItem], *, collate_fn_map: Any = None) -> dict[str, Any]:
    """torch's ``default_collate`` for garments. Raises ``ConfigError`` if they differ in size."""
    batch = {}
    for field in items[0]:
        try:
            with naming_full():
                batch[field] = collate([item[field] for item in items], collate_fn_map=collate_fn_map)
        except (RuntimeError, TypeError, KeyError, ValueError) as error:
            raise ConfigError(
                f"{field} differs in size or kind between garments, and torch's default collate stacks equal ones: "
                "give the DataLoader collate_fn=collate_packed, or collate_padded, of gcd_dataset.loaders"
            ) from error
    return batch


default_collate_fn_map[GarmentItem] = _default_collate
