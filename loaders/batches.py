"""Batches as dicts whose entries have names, shapes and types: garments one below the other, or padded to one size."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Self

import torch
import torch.utils._pytree as pytree
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import GarmentItem, Item, floating
from gcd_dataset.loaders.indexing import UnknownKeyError
from gcd_dataset.loaders.one_thread import as_type, pinned
from gcd_dataset.tensors import EdgeColumn, StitchColumn

__all__ = ["POINTS_TO", "RAGGED", "WHOLE", "PackedBatch", "PaddedBatch", "Varlen", "starts_of"]

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


class Varlen(NamedTuple):
    """Rows of all garments one below the other, as attention over sequences of unequal lengths takes them."""

    values: Tensor
    """[n, …], row after row."""
    cu_seqlens: Int[Tensor, " b+1"]
    """int32: where each garment begins, and the end of the last."""
    max_seqlen: int
    """Rows of the garment that has most of them."""


class _Batch(dict[str, Any]):
    """A dict of tensors and lists; entries are attributes too.

    ``torch.utils._pytree.tree_map`` goes through a batch as through a dict, and gives one of its type.
    """

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

    def __missing__(self, field: object) -> Any:
        raise UnknownKeyError(
            f"the batch has no {field!r:.99}: it holds {', '.join(self)}; fields= of its data set chooses"
        )

    def __repr__(self) -> str:
        told = [f"{name} {_form(value)}" for name, value in self.items() if not name.endswith(("_ptr", "_size"))]
        return f"{type(self).__name__}({self.get('batch_size', '?')} garments: {', '.join(told)})"

    def to(
        self,
        device: torch.device | str | int | torch.dtype | None = None,
        dtype: torch.dtype | None = None,
        *,
        non_blocking: bool = False,
    ) -> Self:
        """The batch with its tensors on a device, and the floating ones as ``dtype``; row numbers stay whole.

        ``non_blocking`` copies pinned ones while the host goes on. As with a tensor, ``batch.to(torch.bfloat16)`` will
        do. Raises ``ConfigError`` for a device that is not there, and for a type that is not of floating numbers.
        """
        if isinstance(device, torch.dtype):
            device, dtype = None, device
        place, kind = None if device is None else _device(device), floating(dtype)

        def moved(tensor: Tensor) -> Tensor:
            if kind is not None and tensor.is_floating_point():
                tensor = as_type(tensor, kind)
            return tensor if place is None else tensor.to(place, non_blocking=non_blocking)

        return self._each(moved)

    def pin_memory(self) -> Self:
        """The batch with its tensors in memory that a GPU copies from by itself. Raises ``ConfigError`` without one."""
        if not torch.cuda.is_available():
            raise ConfigError("pinned memory is for a GPU, and torch sees none: leave out pin_memory")
        return self._each(pinned)

    def _each(self, change: Callable[[Tensor], Tensor]) -> Self:
        return type(self)({name: _changed(value, change) for name, value in self.items()})


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
        self._require_ragged(field)
        return torch.nested.nested_tensor_from_jagged(self[field], self[f"{field}_ptr"])

    def varlen(self, field: str) -> Varlen:
        """A ragged field as attention over sequences of unequal lengths takes it, without a copy.

        >>> from gcd_dataset.loaders import FakeGarments, collate_packed
        >>> values, cu_seqlens, max_seqlen = collate_packed([FakeGarments(2)[0], FakeGarments(2)[1]]).varlen("panels")
        >>> values.shape, cu_seqlens, max_seqlen
        (torch.Size([4, 14]), tensor([0, 2, 4], dtype=torch.int32), 2)

        Embedded to q, k and v [n, heads, width] that is ``flash_attn_varlen_func(q, k, v, cu_seqlens, cu_seqlens,
        max_seqlen, max_seqlen)``, or ``torch.nested.nested_tensor_from_jagged(values, cu_seqlens,
        max_seqlen=max_seqlen)``. Of a batch on a GPU the longest is waited for: ask before ``to`` to spare that.
        """
        self._require_ragged(field)
        pointers = self[f"{field}_ptr"]
        longest = int(pointers.diff().max()) if len(pointers) > 1 else 0
        return Varlen(self[field], pointers.to(torch.int32), longest)

    def _require_ragged(self, field: str) -> None:
        if f"{field}_ptr" not in self:
            ragged = ", ".join(name for name in RAGGED if f"{name}_ptr" in self)
            raise ConfigError(f"{field} is not a field of the batch whose rows differ in number: there are {ragged}")

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


def _changed(value: Any, change: Callable[[Tensor], Tensor]) -> Any:
    """A tensor, or each of a list of them, changed; anything else as it is."""
    if isinstance(value, Tensor):
        return change(value)
    if isinstance(value, list) and value and all(isinstance(entry, Tensor) for entry in value):
        return [change(entry) for entry in value]
    return value


def _device(device: torch.device | str | int) -> torch.device:
    """The device. Raises ``ConfigError`` for one that is not there."""
    try:
        place = torch.device(device)
    except (RuntimeError, TypeError) as error:
        raise ConfigError(f"device {device!r:.99}: give cpu, or a GPU as cuda:0") from error
    if place.type == "cuda" and (place.index or 0) >= (count := torch.cuda.device_count()):
        there = f"torch sees {count} GPUs" if count else "torch sees no GPU"
        raise ConfigError(
            f"device {place}: {there}: give another, such as 'cuda' if torch.cuda.is_available() else 'cpu'"
        )
    return place


def _form(value: Any) -> str:
    """Shape and type of a value, for people."""
    if isinstance(value, Tensor):
        where = "" if value.device.type == "cpu" else f" on {value.device}"
        return f"{list(value.shape)} {str(value.dtype).removeprefix('torch.')}{where}"
    return f"list of {len(value)}" if isinstance(value, list) else type(value).__name__


def _register(kind: type[dict[str, Any]]) -> None:
    """Have torch's ``tree_map`` go through a kind of dict, and give one of its kind."""
    if kind in pytree.SUPPORTED_NODES:  # this module is loaded again
        return
    pytree.register_pytree_node(
        kind,
        lambda entries: (list(entries.values()), list(entries)),
        lambda values, names: kind(zip(names, values, strict=True)),
        serialized_type_name=f"{kind.__module__}.{kind.__qualname__}",
        flatten_with_keys_fn=lambda entries: (
            [(pytree.MappingKey(name), value) for name, value in entries.items()],
            list(entries),
        ),
    )


for _kind in (GarmentItem, PackedBatch, PaddedBatch):
    _register(_kind)
