"""``PackedBatch`` and ``PaddedBatch``: dicts of tensors, with typed attributes for the entries."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Self

import torch
import torch.utils._pytree as pytree
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import GarmentItem, Item, require_float_dtype
from gcd_dataset.loaders.indexing import UnknownKeyError
from gcd_dataset.loaders.one_thread import as_type, pin_tensor
from gcd_dataset.tensors import EdgeColumn, StitchColumn

RAGGED = (
    "panels", "edges", "stitches", "faces", "uv", "panel_id", "labels", "seams", "corners", "uv_vertex", "box", "verts",
    "panel_corners", "panel_corner_pixels", "panel_corner_visible",
)  # fmt: skip
"""Fields with a different number of rows in each garment."""

WHOLE = slice(None)
POINTS_TO: Mapping[str, tuple[tuple[slice, str], ...]] = {
    "faces": ((WHOLE, "vertices"),),
    "uv_vertex": ((WHOLE, "vertices"),),
    "labels": ((slice(0, 1), "vertices"),),
    "seams": ((slice(0, 1), "vertices"), (slice(1, 2), "stitches")),
    "corners": ((WHOLE, "uv"),),
    "panel_id": ((WHOLE, "panels"),),
    "edges": ((slice(EdgeColumn.PANEL, EdgeColumn.PANEL + 1), "panels"),),
    "stitches": ((slice(StitchColumn.LEFT, StitchColumn.RIGHT + 1), "edges"),),
}
"""Field to its columns of row numbers, each with the field that the numbers index."""


class _Entry:
    """Descriptor: an entry of the dict as a typed attribute."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, batch: "_Batch | None", owner: type) -> Any:
        if batch is None:
            return self
        if self._name not in batch:
            raise AttributeError(f"the batch has no {self._name}: load the fields that {self._name} needs")
        return batch[self._name]


def _entry() -> Any:
    return _Entry()


class Varlen(NamedTuple):
    """Concatenated rows with offsets, as variable-length attention takes them."""

    values: Tensor
    """[n, …], the rows of all garments."""
    cu_seqlens: Int[Tensor, " b+1"]
    """int32: start of each garment, and the end of the last."""
    max_seqlen: int
    """Rows of the longest garment."""


class _Batch(dict[str, Any]):
    """A dict of tensors and lists, with its entries as attributes: the fields of ``GarmentFields``.

    Ragged fields have an axis b only where they are padded.

    ``torch.utils._pytree.tree_map`` maps over a batch like over a dict, and returns the same class.
    """

    batch_size: int = _entry()
    """B, the number of garments."""
    panels: Float[Tensor, "*b p 14"] = _entry()
    edges: Float[Tensor, "*b e 13"] = _entry()
    stitches: Int[Tensor, "*b s 3"] = _entry()
    faces: Int[Tensor, "*b f 3"] = _entry()
    panel_id: Int[Tensor, "*b f"] = _entry()
    corners: Int[Tensor, "*b f 3"] = _entry()
    uv: Float[Tensor, "*b c 2"] = _entry()
    uv_vertex: Int[Tensor, "*b c"] = _entry()
    labels: Int[Tensor, "*b l 2"] = _entry()
    seams: Int[Tensor, "*b m 2"] = _entry()
    box: Float[Tensor, "*b v 3"] = _entry()
    verts: Float[Tensor, "*b v 3"] = _entry()
    panel_corners: Int[Tensor, "*b k 2"] = _entry()
    panel_corner_pixels: Float[Tensor, "*b k n 2"] = _entry()
    panel_corner_visible: Bool[Tensor, "*b k n"] = _entry()
    meta: list[dict[str, Any]] = _entry()
    spec: list[dict[str, Any]] = _entry()
    design: list[dict[str, Any]] = _entry()
    measures: list[dict[str, float]] = _entry()
    body: Float[Tensor, "b k"] = _entry()
    points: Float[Tensor, "b n 6"] = _entry()
    front: UInt8[Tensor, "b 3 h w"] = _entry()
    back: UInt8[Tensor, "b 3 h w"] = _entry()
    views: UInt8[Tensor, "b n h w 3"] = _entry()
    camera_k: Float[Tensor, "b n 3 3"] = _entry()
    camera_rt: Float[Tensor, "b n 3 4"] = _entry()
    landmark_pixels: Float[Tensor, "b n l 2"] = _entry()
    landmark_visible: Bool[Tensor, "b n l"] = _entry()
    repeated: Bool[Tensor, " b"] = _entry()
    """True for garments that fill up a batch, from a loader with ``pad="repeat"``."""

    def __missing__(self, field: object) -> Any:
        raise UnknownKeyError(
            f"the batch has no {field!r:.99}: it holds {', '.join(self)}; fields= of its data set chooses"
        )

    def __repr__(self) -> str:
        entries = [f"{name} {_form(value)}" for name, value in self.items() if not name.endswith(("_ptr", "_size"))]
        return f"{type(self).__name__}({self.get('batch_size', '?')} garments: {', '.join(entries)})"

    def _repr_html_(self) -> str:
        from gcd_dataset.viewer.notebook import batch_html

        return batch_html(self)

    def to(
        self,
        device: torch.device | str | int | torch.dtype | None = None,
        dtype: torch.dtype | None = None,
        *,
        non_blocking: bool = False,
    ) -> Self:
        """A batch with its tensors on a device and floating tensors as ``dtype``; integer tensors keep their type.

        ``non_blocking`` copies pinned tensors asynchronously. Like a tensor's, ``batch.to(torch.bfloat16)`` works.
        Raises ``ConfigError`` for a missing device and a type that is not floating.
        """
        if isinstance(device, torch.dtype):
            device, dtype = None, device
        target, float_type = None if device is None else _device(device), require_float_dtype(dtype)

        def moved(tensor: Tensor) -> Tensor:
            if float_type is not None and tensor.is_floating_point():
                tensor = as_type(tensor, float_type)
            return tensor if target is None else tensor.to(target, non_blocking=non_blocking)

        return self._map(moved)

    def pin_memory(self) -> Self:
        """A batch in pinned memory. Raises ``ConfigError`` without a GPU."""
        if not torch.cuda.is_available():
            raise ConfigError("pinned memory needs a GPU, and torch sees none: leave out pin_memory")
        return self._map(pin_tensor)

    def _map(self, function: Callable[[Tensor], Tensor]) -> Self:
        return type(self)({name: _mapped(value, function) for name, value in self.items()})


class PackedBatch(_Batch):
    """Concatenated garments; garment k has rows ``ptr[k]`` to ``ptr[k + 1]`` of a field; ``ptr`` is ``<field>_ptr``.

    Row numbers index the arrays of the whole batch.
    """

    panels_ptr: Int[Tensor, " b+1"] = _entry()
    edges_ptr: Int[Tensor, " b+1"] = _entry()
    stitches_ptr: Int[Tensor, " b+1"] = _entry()
    faces_ptr: Int[Tensor, " b+1"] = _entry()
    box_ptr: Int[Tensor, " b+1"] = _entry()
    verts_ptr: Int[Tensor, " b+1"] = _entry()

    def garment(self, number: int) -> Item:
        """The item of one garment, as before collation. Raises ``IndexError``."""
        if not 0 <= number < self.batch_size:
            raise IndexError(f"garment {number} of a batch of {self.batch_size}")
        names = [name for name in self if name != "batch_size" and not name.endswith("_ptr")]
        return {name: self._rows(name, number) if name in RAGGED else self[name][number] for name in names}

    def nested(self, field: str) -> Tensor:
        """A ragged field as a nested tensor [B, rows, …] in the jagged layout, without a copy."""
        self._require_ragged(field)
        return torch.nested.nested_tensor_from_jagged(self[field], self[f"{field}_ptr"])

    def varlen(self, field: str) -> Varlen:
        """A ragged field in the form of variable-length attention, without a copy.

        >>> from gcd_dataset.loaders import FakeGarments, collate_packed
        >>> values, cu_seqlens, max_seqlen = collate_packed([FakeGarments(2)[0], FakeGarments(2)[1]]).varlen("panels")
        >>> values.shape, cu_seqlens, max_seqlen
        (torch.Size([4, 14]), tensor([0, 2, 4], dtype=torch.int32), 2)

        With the values embedded to q, k and v [n, heads, width]: ``flash_attn_varlen_func(q, k, v, cu_seqlens,
        cu_seqlens, max_seqlen, max_seqlen)``, or ``torch.nested.nested_tensor_from_jagged(values, cu_seqlens,
        max_seqlen=max_seqlen)``. ``max_seqlen`` of a batch on a GPU synchronises: call this before ``to`` to avoid
        that.
        """
        self._require_ragged(field)
        pointers = self[f"{field}_ptr"]
        longest = int(pointers.diff().max()) if len(pointers) > 1 else 0
        return Varlen(self[field], pointers.to(torch.int32), longest)

    def _require_ragged(self, field: str) -> None:
        if f"{field}_ptr" not in self:
            ragged = ", ".join(name for name in RAGGED if f"{name}_ptr" in self)
            raise ConfigError(f"{field} is not a ragged field of the batch: choose among {ragged}")

    def owners(self, field: str) -> Int[Tensor, " n"]:
        """The garment of each row of a ragged field."""
        pointers = self[f"{field}_ptr"]
        return torch.arange(self.batch_size, device=pointers.device).repeat_interleave(pointers.diff())

    def _rows(self, field: str, number: int) -> Tensor:
        first, last = self[f"{field}_ptr"][number : number + 2].tolist()
        columns = POINTS_TO.get(field, ())
        rows: Tensor = self[field][first:last].clone() if columns else self[field][first:last]
        for column, target in columns:
            entries = rows if rows.ndim == 1 else rows[:, column]
            entries -= starts_of(self, field, target)[number].to(rows.dtype)
        return rows


class PaddedBatch(_Batch):
    """Garments stacked to equal length; rows where the mask is false hold 0, or false; -1 in integer fields.

    Row numbers count within the garment.
    """

    panels_mask: Bool[Tensor, "b p"] = _entry()
    edges_mask: Bool[Tensor, "b e"] = _entry()
    stitches_mask: Bool[Tensor, "b s"] = _entry()
    faces_mask: Bool[Tensor, "b f"] = _entry()
    box_mask: Bool[Tensor, "b v"] = _entry()
    verts_mask: Bool[Tensor, "b v"] = _entry()


def starts_of(batch: Mapping[str, Any], field: str, target: str) -> Any:
    """For the row numbers in ``field``: start of each garment's rows in ``target``, and the end of the last, [b+1].

    A tensor, or an array where the batch holds arrays. Raises ``ConfigError`` if the target is not in the batch, and
    for draped and undraped garments in one batch.
    """
    if target != "vertices":
        if f"{target}_ptr" not in batch:
            raise ConfigError(f"{field} holds rows of {target}: load the field {target} too")
        return batch[f"{target}_ptr"]
    pointers = batch[f"{field}_ptr"]
    found = [starts for name in ("verts", "box") if (starts := batch.get(f"{name}_ptr")) is not None and starts[-1]]
    if not found and not pointers[-1]:
        return 0 * pointers
    if not found:
        raise ConfigError(f"{field} holds rows of verts and box: load the field verts or box too")
    if not all((starts == found[0]).all() for starts in found[1:]):
        raise ConfigError("draped and undraped garments in one batch: load verts or box, not both")
    return found[0]


def _mapped(value: Any, function: Callable[[Tensor], Tensor]) -> Any:
    """A function applied to a tensor, or to each tensor of a list; any other value unchanged."""
    if isinstance(value, Tensor):
        return function(value)
    if isinstance(value, list) and value and all(isinstance(entry, Tensor) for entry in value):
        return [function(entry) for entry in value]
    return value


def _device(device: torch.device | str | int) -> torch.device:
    """The device. Raises ``ConfigError`` for an unknown or missing one."""
    try:
        parsed = torch.device(device)
    except (RuntimeError, TypeError) as error:
        raise ConfigError(f"device {device!r:.99}: give cpu, or a GPU as cuda:0") from error
    if parsed.type == "cuda" and (parsed.index or 0) >= (count := torch.cuda.device_count()):
        seen = f"torch sees {count} GPUs" if count else "torch sees no GPU"
        raise ConfigError(
            f"device {parsed}: {seen}: give another, such as 'cuda' if torch.cuda.is_available() else 'cpu'"
        )
    return parsed


def _form(value: Any) -> str:
    """Shape and type of a value, for ``repr``."""
    if isinstance(value, Tensor):
        device = "" if value.device.type == "cpu" else f" on {value.device}"
        return f"{list(value.shape)} {str(value.dtype).removeprefix('torch.')}{device}"
    return f"list of {len(value)}" if isinstance(value, list) else type(value).__name__


def _register(kind: type[dict[str, Any]]) -> None:
    """Register a dict class with torch's pytree, so that ``tree_map`` maps over it and returns its class."""
    if kind in pytree.SUPPORTED_NODES:  # the module is reloaded
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
