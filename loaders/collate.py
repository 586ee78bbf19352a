"""Batches of garments, which differ in size."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import Item
from gcd_dataset.shards.room import room_for
from gcd_dataset.tensors import EdgeColumn, StitchColumn

__all__ = ["collate_list", "collate_packed"]

RAGGED = (
    "panels", "edges", "stitches", "faces", "uv", "panel_id", "labels", "seams", "corners", "uv_vertex", "box", "verts",
)  # fmt: skip
"""Fields whose number of rows differs from garment to garment."""

ALL = slice(None)
POINTS_TO: Mapping[str, Sequence[tuple[slice | int, str]]] = {
    "faces": [(ALL, "vertices")],
    "uv_vertex": [(ALL, "vertices")],
    "labels": [(0, "vertices")],
    "seams": [(0, "vertices"), (1, "stitches")],
    "corners": [(ALL, "uv")],
    "panel_id": [(ALL, "panels")],
    "edges": [(EdgeColumn.PANEL, "panels")],
    "stitches": [(slice(StitchColumn.LEFT, StitchColumn.RIGHT + 1), "edges")],
}
"""Field to those of its columns that hold row numbers, each with the field whose rows they are."""


def collate_list(items: Sequence[Any]) -> list[Any]:
    """The items as they are, in a list."""
    return list(items)


def collate_packed(items: Sequence[Item]) -> dict[str, Any]:
    """One dict for the batch: ragged arrays one below the other, as graphs are batched in PyTorch Geometric.

    - A ragged field (``RAGGED``: meshes and patterns) is concatenated along its rows. ``<field>_ptr``, int64 [B+1],
      holds where each garment begins: garment k is ``batch["verts"][ptr[k]:ptr[k + 1]]``.
    - Row numbers are raised so that they index the concatenated arrays: ``batch["verts"][batch["faces"]]`` are the
      triangles of the whole batch. ``faces``, ``uv_vertex`` and the first column of ``labels`` and ``seams`` point to
      ``verts`` and to ``box``; ``corners`` to ``uv``; ``panel_id`` and ``edges[:, EdgeColumn.PANEL]`` to ``panels``;
      ``stitches[:, :2]`` to ``edges``; ``seams[:, 1]`` to ``stitches``. Data types stay as they are. The field pointed
      to must be in the items. The second column of ``labels`` stays a row of each garment's ``edge_labels``.
    - Tensors of one shape, such as ``body``, ``points``, ``front`` and ``back``, are stacked to [B, …].
    - Everything else, such as parsed JSON and what a ``transform`` has added, becomes a list of length B.
    - ``batch_size`` is B.

    Raises ``ConfigError`` for an empty batch, items with different fields, row numbers without the field that they
    point to, and a batch of draped and undraped garments.

    >>> item = {"verts": torch.zeros(3, 3), "faces": torch.tensor([[0, 1, 2]])}
    >>> batch = collate_packed([item, item])
    >>> batch["faces"].tolist(), batch["verts_ptr"].tolist()
    ([[0, 1, 2], [3, 4, 5]], [0, 3, 6])
    """
    _require_same_fields(items)
    batch: dict[str, Any] = {"batch_size": len(items)}
    batch |= {f"{field}_ptr": _pointers([item[field] for item in items]) for field in RAGGED if field in items[0]}
    for field in items[0]:
        values = [item[field] for item in items]
        if field in RAGGED:
            batch[field] = _packed(values, batch, field)
        else:
            batch[field] = _stacked(values) if _of_one_shape(values) else values
    return batch


def _require_same_fields(items: Sequence[Item]) -> None:
    if not items:
        raise ConfigError("a batch of no garments: give collate_packed one or more")
    for item in items[1:]:
        if item.keys() != items[0].keys():
            odd = ", ".join(sorted(item.keys() ^ items[0].keys()))
            raise ConfigError(f"only some garments of the batch have {odd}: choose the same fields for all")


def _pointers(values: Sequence[Tensor]) -> Tensor:
    """Where the rows of each value begin, and the end of the last."""
    return torch.tensor([0] + [len(value) for value in values]).cumsum(0)


def _of_one_shape(values: Sequence[Any]) -> bool:
    return all(isinstance(value, Tensor) and value.shape == values[0].shape for value in values)


def _starts(pointers: Mapping[str, Any], field: str, target: str) -> Tensor:
    """Row of ``target`` at which each garment begins, and the end of the last."""
    if target != "vertices":
        if f"{target}_ptr" not in pointers:
            raise ConfigError(f"{field} holds rows of {target}: load the field {target} too")
        return pointers[f"{target}_ptr"]
    own = pointers[f"{field}_ptr"]
    there = [starts for name in ("verts", "box") if (starts := pointers.get(f"{name}_ptr")) is not None and starts[-1]]
    if not there and not own[-1]:
        return torch.zeros_like(own)
    if not there:
        raise ConfigError(f"{field} holds rows of verts and box: load the field verts or box too")
    if not all(torch.equal(starts, there[0]) for starts in there):
        raise ConfigError("draped and undraped garments in one batch: load verts or box, not both")
    return there[0]


def _packed(values: Sequence[Tensor], batch: Mapping[str, Any], field: str) -> Tensor:
    """The rows one below the other, and the row numbers in them raised by where each garment begins."""
    starts = [(column, _starts(batch, field, target)) for column, target in POINTS_TO.get(field, ())]
    rows = _room((int(batch[f"{field}_ptr"][-1]), *values[0].shape[1:]), values)
    if starts and starts[0][0] == ALL:
        ends = batch[f"{field}_ptr"].tolist()
        for value, start, first, last in zip(values, starts[0][1].tolist()[:-1], ends[:-1], ends[1:], strict=True):
            torch.add(value, start, out=rows[first:last])
        return rows
    torch.cat(list(values), out=rows)
    for column, start in starts:
        raised = start[:-1].repeat_interleave(batch[f"{field}_ptr"].diff())
        part = rows[:, column]
        part += raised.to(rows.dtype) if part.ndim == 1 else raised.to(rows.dtype)[:, None]
    return rows


def _stacked(values: Sequence[Tensor]) -> Tensor:
    return torch.stack(list(values), out=_room((len(values), *values[0].shape), values))


def _room(shape: Sequence[int], values: Sequence[Tensor]) -> Tensor:
    """Where values of one type are put together."""
    like = values[0]
    if like.device.type != "cpu":
        return torch.empty(shape, dtype=like.dtype, device=like.device)
    return torch.from_numpy(room_for(math.prod(shape) * like.itemsize)).view(like.dtype).view(shape)
