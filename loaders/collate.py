"""Batches of garments, which differ in size."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import Item
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
    for field in items[0]:
        values = [item[field] for item in items]
        if field in RAGGED:
            batch[field], batch[f"{field}_ptr"] = torch.cat(values), _pointers(values)
        else:
            batch[field] = torch.stack(values) if _of_one_shape(values) else values
    for field in POINTS_TO.keys() & batch.keys():
        for column, target in POINTS_TO[field]:
            _raise_rows(batch, field, column, _starts(batch, field, target))
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


def _starts(batch: Mapping[str, Any], field: str, target: str) -> Tensor:
    """Row of ``target`` at which each garment begins."""
    if target != "vertices":
        if target not in batch:
            raise ConfigError(f"{field} holds rows of {target}: load the field {target} too")
        return batch[f"{target}_ptr"]
    there = [batch[f"{name}_ptr"] for name in ("verts", "box") if name in batch and len(batch[name])]
    if not there and not len(batch[field]):
        return torch.zeros(batch["batch_size"] + 1, dtype=torch.int64)
    if not there:
        raise ConfigError(f"{field} holds rows of verts and box: load the field verts or box too")
    if not all(torch.equal(pointers, there[0]) for pointers in there):
        raise ConfigError("draped and undraped garments in one batch: load verts or box, not both")
    return there[0]


def _raise_rows(batch: Mapping[str, Any], field: str, column: slice | int, starts: Tensor) -> None:
    """Add to the row numbers of each garment where that garment begins in the batch."""
    rows, ends = batch[field], batch[f"{field}_ptr"].tolist()
    for start, first, last in zip(starts.tolist(), ends[:-1], ends[1:], strict=False):
        block = rows[first:last] if rows.ndim == 1 else rows[first:last, column]
        block += start
