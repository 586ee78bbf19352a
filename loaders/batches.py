"""Batches as dicts whose entries have names, shapes and types: garments one below the other, or padded to one size."""

from collections.abc import Callable, Mapping
from typing import Any, Self

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import Item
from gcd_dataset.loaders.one_thread import pinned
from gcd_dataset.tensors import EdgeColumn, StitchColumn

__all__ = ["POINTS_TO", "RAGGED", "WHOLE", "PackedBatch", "PaddedBatch", "starts_of"]

RAGGED = (
    "panels", "edges", "stitches", "faces", "uv", "panel_id", "labels", "seams", "corners", "uv_vertex", "box", "verts",
)  # fmt: skip
"""Fields whose number of rows differs from garment to garment."""

WHOLE = slice(None)
POINTS_TO: Mapping[str, tuple[tuple[slice | int, str], ...]] = {
    "faces": ((WHOLE, "vertices"),),
    "uv_vertex": ((WHOLE, "vertices"),),
    "labels": ((0, "vertices"),),
    "seams": ((0, "vertices"), (1, "stitches")),
    "corners": ((WHOLE, "uv"),),
    "panel_id": ((WHOLE, "panels"),),
    "edges": ((EdgeColumn.PANEL, "panels"),),
    "stitches": ((slice(StitchColumn.LEFT, StitchColumn.RIGHT + 1), "edges"),),
}
"""Field to those of its columns that hold row numbers, each with the field whose rows they are."""


class _Entry:
    """An entry of a batch as an attribute, so that its type is known."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, batch: "_Batch | None", owner: type) -> Any:
        if batch is None:
            return self
        if self._name not in batch:
            raise AttributeError(f"the batch has no {self._name}: load the fields that it is made of")
        return batch[self._name]


def _entry() -> Any:
    return _Entry()


class _Batch(dict[str, Any]):
    """A dict of tensors and lists; entries are attributes too."""

    batch_size: int = _entry()
    """B, the number of garments."""
    meta: list[dict[str, Any]] = _entry()
    spec: list[dict[str, Any]] = _entry()
    design: list[dict[str, Any]] = _entry()
    measures: list[dict[str, float]] = _entry()
    body: Float[Tensor, "b k"] = _entry()
    """Weights of the bodies' shape components [standard deviations]."""
    points: Float[Tensor, "b n 6"] = _entry()
    """Surface points [cm] and normals."""
    front: UInt8[Tensor, "b 3 h w"] = _entry()
    back: UInt8[Tensor, "b 3 h w"] = _entry()
    repeated: Bool[Tensor, " b"] = _entry()
    """Garments that only fill up a batch, where a loader does that."""

    def to(self, device: torch.device | str, *, non_blocking: bool = False) -> Self:
        """The batch with its tensors on a device; ``non_blocking`` copies pinned ones while the host goes on."""
        return self._each(lambda tensor: tensor.to(device, non_blocking=non_blocking))

    def pin_memory(self) -> Self:
        """The batch with its tensors in memory that a GPU copies from by itself."""
        return self._each(pinned)

    def _each(self, change: Callable[[Tensor], Tensor]) -> Self:
        changed = {name: change(value) if isinstance(value, Tensor) else value for name, value in self.items()}
        return type(self)(changed)


class PackedBatch(_Batch):
    """Garments one below the other; rows of garment k of a field are ``ptr[k]`` to ``ptr[k + 1]`` of its pointers.

    Row numbers index the arrays of the whole batch.
    """

    panels: Float[Tensor, "p 14"] = _entry()
    """Columns of ``PanelColumn``."""
    edges: Float[Tensor, "e 13"] = _entry()
    """Columns of ``EdgeColumn``."""
    stitches: Int[Tensor, "s 3"] = _entry()
    """Columns of ``StitchColumn``."""
    faces: Int[Tensor, "f 3"] = _entry()
    """Rows of ``verts`` and ``box``."""
    panel_id: Int[Tensor, " f"] = _entry()
    """Rows of ``panels``."""
    corners: Int[Tensor, "f 3"] = _entry()
    """Rows of ``uv``."""
    uv: Float[Tensor, "c 2"] = _entry()
    """Coordinates in the panels' planes [cm]."""
    uv_vertex: Int[Tensor, " c"] = _entry()
    """Rows of ``verts`` and ``box``."""
    labels: Int[Tensor, "l 2"] = _entry()
    """(row of ``verts`` and ``box``, row of the garment's own ``edge_labels``)."""
    seams: Int[Tensor, "n 2"] = _entry()
    """(row of ``verts`` and ``box``, row of ``stitches``)."""
    box: Float[Tensor, "v 3"] = _entry()
    """Positions before sewing [cm]."""
    verts: Float[Tensor, "v 3"] = _entry()
    """Positions at rest [cm]."""
    panels_ptr: Int[Tensor, " b+1"] = _entry()
    edges_ptr: Int[Tensor, " b+1"] = _entry()
    stitches_ptr: Int[Tensor, " b+1"] = _entry()
    faces_ptr: Int[Tensor, " b+1"] = _entry()
    box_ptr: Int[Tensor, " b+1"] = _entry()
    verts_ptr: Int[Tensor, " b+1"] = _entry()

    def garment(self, number: int) -> Item:
        """One garment as it was before it was put into the batch. Raises ``IndexError``."""
        if not 0 <= number < self.batch_size:
            raise IndexError(f"garment {number} of a batch of {self.batch_size}")
        names = [name for name in self if name != "batch_size" and not name.endswith("_ptr")]
        return {name: self._rows(name, number) if name in RAGGED else self[name][number] for name in names}

    def nested(self, field: str) -> Tensor:
        """A ragged field as a nested tensor [B, rows of each, …] in the jagged layout, without a copy."""
        if f"{field}_ptr" not in self:
            raise ConfigError(f"{field} is not a field of the batch whose rows differ in number: {', '.join(self)}")
        return torch.nested.nested_tensor_from_jagged(self[field], self[f"{field}_ptr"])

    def owners(self, field: str) -> Int[Tensor, " n"]:
        """The garment that each row of a ragged field belongs to."""
        pointers = self[f"{field}_ptr"]
        return torch.arange(self.batch_size, device=pointers.device).repeat_interleave(pointers.diff())

    def _rows(self, field: str, number: int) -> Tensor:
        first, last = self[f"{field}_ptr"][number : number + 2].tolist()
        columns = POINTS_TO.get(field, ())
        rows: Tensor = self[field][first:last].clone() if columns else self[field][first:last]
        for column, target in columns:
            part = rows if rows.ndim == 1 else rows[:, column]
            part -= starts_of(self, field, target)[number].to(rows.dtype)
        return rows


class PaddedBatch(_Batch):
    """Garments side by side; behind a garment's own rows, where its mask is false, stand 0, and -1 for row numbers.

    Row numbers count in the garment's own rows.
    """

    panels: Float[Tensor, "b p 14"] = _entry()
    edges: Float[Tensor, "b e 13"] = _entry()
    stitches: Int[Tensor, "b s 3"] = _entry()
    faces: Int[Tensor, "b f 3"] = _entry()
    panel_id: Int[Tensor, "b f"] = _entry()
    corners: Int[Tensor, "b f 3"] = _entry()
    uv: Float[Tensor, "b c 2"] = _entry()
    uv_vertex: Int[Tensor, "b c"] = _entry()
    labels: Int[Tensor, "b l 2"] = _entry()
    seams: Int[Tensor, "b n 2"] = _entry()
    box: Float[Tensor, "b v 3"] = _entry()
    verts: Float[Tensor, "b v 3"] = _entry()
    panels_mask: Bool[Tensor, "b p"] = _entry()
    edges_mask: Bool[Tensor, "b e"] = _entry()
    stitches_mask: Bool[Tensor, "b s"] = _entry()
    faces_mask: Bool[Tensor, "b f"] = _entry()
    box_mask: Bool[Tensor, "b v"] = _entry()
    verts_mask: Bool[Tensor, "b v"] = _entry()


def starts_of(batch: Mapping[str, Any], field: str, target: str) -> Int[Tensor, " b+1"]:
    """Row of ``target`` at which each garment begins, and the end of the last, for the row numbers in ``field``.

    Raises ``ConfigError`` where the target is not in the batch, or differs between draped and undraped garments.
    """
    if target != "vertices":
        if f"{target}_ptr" not in batch:
            raise ConfigError(f"{field} holds rows of {target}: load the field {target} too")
        return batch[f"{target}_ptr"]
    own = batch[f"{field}_ptr"]
    there = [starts for name in ("verts", "box") if (starts := batch.get(f"{name}_ptr")) is not None and starts[-1]]
    if not there and not own[-1]:
        return torch.zeros_like(own)
    if not there:
        raise ConfigError(f"{field} holds rows of verts and box: load the field verts or box too")
    if not all(torch.equal(starts, there[0]) for starts in there):
        raise ConfigError("draped and undraped garments in one batch: load verts or box, not both")
    return there[0]
