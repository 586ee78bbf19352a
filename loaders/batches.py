"""Items of different sizes collated to one batch: ``PackedBatch`` and ``PaddedBatch``, dicts of tensors."""

import math
import sys
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from itertools import accumulate
from typing import Any, NamedTuple, Self

import numpy as np
import torch
import torch.utils._pytree as pytree
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor
from torch.utils.data._utils.collate import collate, default_collate_fn_map

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import GarmentItem, Item, UnknownKeyError, as_type, require_float_dtype, tensor_of
from gcd_dataset.loaders.shards import StoredItems
from gcd_dataset.loaders.worker import naming_full, sent, unwrap
from gcd_dataset.shards.layout import MOST_GARMENTS, of_each_garment, split_worn, worn_name
from gcd_dataset.tensors import EdgeColumn, LineColumn, StitchColumn

_RAGGED = (
    "panels", "edges", "stitches", "closures", "lines", "faces", "uv", "panel_id", "labels", "seams", "corners",
    "uv_vertex", "box", "verts", "stretch", "gap", "pressure", "panel_corners", "panel_corner_pixels",
    "panel_corner_visible", "garment_id", "panel_garment",
    "motion_verts", "motion_velocities",
)  # fmt: skip
RAGGED = of_each_garment(dict.fromkeys(_RAGGED))
"""Fields with a different number of rows in each garment."""

FRAMES_FIRST = {"motion_verts", "motion_velocities"}
"""Ragged fields whose rows are their second axis, after the frames."""

WHOLE = slice(None)
_POINTS_TO: Mapping[str, tuple[tuple[slice, str], ...]] = {
    "faces": ((WHOLE, "vertices"),),
    "uv_vertex": ((WHOLE, "vertices"),),
    "labels": ((slice(0, 1), "vertices"),),
    "seams": ((slice(0, 1), "vertices"), (slice(1, 2), "stitches")),
    "corners": ((WHOLE, "uv"),),
    "panel_id": ((WHOLE, "panels"),),
    "lines": ((slice(LineColumn.PANEL, LineColumn.PANEL + 1), "panels"),),
    "edges": ((slice(EdgeColumn.PANEL, EdgeColumn.PANEL + 1), "panels"),),
    "stitches": ((slice(StitchColumn.LEFT, StitchColumn.RIGHT + 1), "edges"),),
}
POINTS_TO: Mapping[str, tuple[tuple[slice, str], ...]] = {
    worn_name(number, field): tuple((columns, worn_name(number, target)) for columns, target in of_field)
    for number in range(MOST_GARMENTS)
    for field, of_field in _POINTS_TO.items()
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
    closures: Float[Tensor, "*b s 3"] = _entry()
    lines: Float[Tensor, "*b n 17"] = _entry()
    faces: Int[Tensor, "*b f 3"] = _entry()
    panel_id: Int[Tensor, "*b f"] = _entry()
    corners: Int[Tensor, "*b f 3"] = _entry()
    uv: Float[Tensor, "*b c 2"] = _entry()
    uv_vertex: Int[Tensor, "*b c"] = _entry()
    labels: Int[Tensor, "*b l 2"] = _entry()
    seams: Int[Tensor, "*b m 2"] = _entry()
    box: Float[Tensor, "*b v 3"] = _entry()
    verts: Float[Tensor, "*b v 3"] = _entry()
    garment_id: Int[Tensor, "*b v"] = _entry()
    panel_garment: Int[Tensor, "*b p"] = _entry()
    panel_corners: Int[Tensor, "*b k 2"] = _entry()
    panel_corner_pixels: Float[Tensor, "*b k n 2"] = _entry()
    panel_corner_visible: Bool[Tensor, "*b k n"] = _entry()
    meta: list[dict[str, Any]] = _entry()
    spec: list[dict[str, Any]] = _entry()
    design: list[dict[str, Any]] = _entry()
    measures: list[dict[str, float]] = _entry()
    body: Float[Tensor, "b k"] = _entry()
    pose: Float[Tensor, "b 21 3"] = _entry()
    motion_verts: Float[Tensor, "*b t v 3"] = _entry()
    motion_velocities: Float[Tensor, "*b t v 3"] = _entry()
    motion_pose: Float[Tensor, "b t 21 3"] = _entry()
    motion_first: Int[Tensor, " b"] = _entry()
    points: Float[Tensor, "b n 6"] = _entry()
    front: UInt8[Tensor, "b 3 h w"] = _entry()
    back: UInt8[Tensor, "b 3 h w"] = _entry()
    views: UInt8[Tensor, "b n h w 3"] = _entry()
    camera_k: Float[Tensor, "b n 3 3"] = _entry()
    camera_rt: Float[Tensor, "b n 3 4"] = _entry()
    landmark_pixels: Float[Tensor, "b n l 2"] = _entry()
    landmark_visible: Bool[Tensor, "b n l"] = _entry()
    keypoints: Float[Tensor, "b n 17 3"] = _entry()
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
        return torch.nested.nested_tensor_from_jagged(_rows_first(self[field], field), self[f"{field}_ptr"])

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
        return Varlen(_rows_first(self[field], field), pointers.to(torch.int32), longest)

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
        rows: Tensor = _rows_first(self[field], field)[first:last]
        rows = rows.clone() if columns else _rows_first(rows, field)
        worn, plain = split_worn(field)
        if plain == "stitches" and (lines := f"{worn_name(worn, 'lines')}_ptr") in self:
            sides, edges = rows[:, : StitchColumn.RIGHT + 1], self[f"{worn_name(worn, 'edges')}_ptr"]
            on_line = sides >= edges[-1]
            sides[on_line] -= (edges[-1] - edges[number + 1] + self[lines][number]).to(rows.dtype)
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
    worn, plain = split_worn(target)
    if plain != "vertices":
        if f"{target}_ptr" not in batch:
            raise ConfigError(f"{field} holds rows of {target}: load the field {target} too")
        return batch[f"{target}_ptr"]
    pointers = batch[f"{field}_ptr"]
    vertices = (worn_name(worn, name) for name in ("verts", "box", "motion_verts"))
    found = [starts for name in vertices if (starts := batch.get(f"{name}_ptr")) is not None and starts[-1]]
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


def collate_list(items: Sequence[Any]) -> list[Any]:
    """The items in a list, unchanged."""
    return unwrap(sent(list(items)))


def collate_packed(items: Sequence[Item]) -> PackedBatch:
    """Concatenate ragged arrays, as PyTorch Geometric batches graphs; stack the others.

    - A ragged field (``RAGGED``: meshes and patterns) is concatenated along its rows. ``<field>_ptr``, int64 [B+1],
      holds the start of each garment: garment k is ``batch["verts"][ptr[k]:ptr[k + 1]]``. Of ``motion_verts`` and
      ``motion_velocities`` rows are the second axis, [frames, rows, 3]; in ``varlen`` and ``nested`` the first.
    - Row numbers are offset to index the concatenated arrays: ``batch["verts"][batch["faces"]]`` are the triangles of
      the whole batch. ``faces``, ``uv_vertex`` and the first column of ``labels`` and ``seams`` refer to ``verts`` and
      ``box``; ``corners`` to ``uv``; ``panel_id`` and ``edges[:, EdgeColumn.PANEL]`` to ``panels``; ``stitches[:, :2]``
      to ``edges``, and from the number of edges on to ``lines``; ``seams[:, 1]`` to ``stitches``. Data types stay. The
      field referred to must be in the items. The second column of ``labels`` stays a row of each garment's
      ``edge_labels``.
    - Tensors of equal shape, such as ``body``, ``points``, ``front`` and ``back``, are stacked to [B, …]. A picture
      without pixels, of a garment that was not draped, becomes black if another of the batch has pixels.
    - Any other value, such as parsed JSON or the entries a ``transform`` adds, becomes a list of length B.
    - ``batch_size`` is B.

    Raises ``ConfigError`` for an empty batch, items with different fields, different types of one field, row numbers
    without the field that they refer to, and a batch of draped and undraped garments.

    >>> item = {"verts": torch.zeros(3, 3), "faces": torch.tensor([[0, 1, 2]])}
    >>> batch = collate_packed([item, item])
    >>> batch["faces"].tolist(), batch["verts_ptr"].tolist()
    ([[0, 1, 2], [3, 4, 5]], [0, 3, 6])
    """
    return unwrap(sent(pack_items(items)))


def pack_items(items: Sequence[Item]) -> PackedBatch:
    """``collate_packed``, in the memory of this process."""
    columns, dtype = _columns(items)
    counts = {field: list(map(len, values)) for field, values in columns.items() if field in RAGGED}
    # Arrays until the end: a call of torch takes several times as long as one of NumPy.
    starts = {f"{field}_ptr": np.array([0, *accumulate(lengths)]) for field, lengths in counts.items()}
    batch = PackedBatch(batch_size=len(items))
    batch |= {name: torch.from_numpy(pointers) for name, pointers in starts.items()}
    for field, values in columns.items():
        if field in counts:
            batch[field] = _rows_first(_concatenated(values, counts[field], dtype, starts, field), field)
        else:
            batch[field] = _stacked(values, dtype, field, isinstance(items, StoredItems))
    for worn in [split_worn(field)[0] for field in counts if split_worn(field)[1] == "stitches"]:
        if any(counts.get(worn_name(worn, "lines"), [1])):
            _refer_to_lines(batch, worn, counts[worn_name(worn, "stitches")])
    return batch


def _refer_to_lines(batch: PackedBatch, worn: int, counts: Sequence[int]) -> None:
    """Let sides of ``stitches`` beyond a garment's edges refer to ``lines``: beyond the edges of the whole batch.

    ``worn``: number of the garment in each outfit.
    """
    stitches, edges_ptr, lines_ptr = (worn_name(worn, name) for name in ("stitches", "edges_ptr", "lines_ptr"))
    edges, sides = batch[edges_ptr], batch[stitches][:, : StitchColumn.RIGHT + 1]
    owner = torch.arange(len(counts)).repeat_interleave(torch.tensor(counts))
    on_line = sides >= edges[1:][owner].to(sides)[:, None]
    if not on_line.any():
        return
    if lines_ptr not in batch:
        raise ConfigError(f"{stitches} holds rows of lines: load the field {lines_ptr.removesuffix('_ptr')} too")
    shift = edges[-1] - edges[1:] + batch[lines_ptr][:-1]
    sides += on_line * shift[owner].to(sides)[:, None]


def collate_padded(items: Sequence[Item], *, rows: Mapping[str, int] | None = None) -> PaddedBatch:
    """Pad ragged arrays to equal length and stack everything, for networks with inputs of fixed shape.

    - A ragged field becomes [B, n, …], n the rows of the longest garment of the batch; ``<field>_mask``, bool [B, n],
      is true on real rows; ``motion_verts`` becomes [B, frames, n, 3]. Padding is 0 in floating arrays, false in
      boolean ones, and -1 in integer arrays: a row number that refers to nothing.
    - Row numbers count within the garment: ``faces[k]`` are rows of ``verts[k]``.
    - ``rows``: field to a fixed n for all batches: ``functools.partial(collate_padded, rows={"panels": 40})``.
    - All other fields as in ``collate_packed``.

    Raises ``ConfigError`` for an empty batch, items with different fields, and a garment with more rows than ``rows``.

    >>> items = [{"panels": torch.ones(2, 14)}, {"panels": torch.ones(3, 14)}]
    >>> batch = collate_padded(items)
    >>> tuple(batch.panels.shape), batch["panels_mask"].tolist()
    ((2, 3, 14), [[True, True, False], [True, True, True]])
    """
    batch = PaddedBatch(batch_size=len(items))
    columns, dtype = _columns(items)
    for field, values in columns.items():
        if field in RAGGED:
            padded, batch[f"{field}_mask"] = _pad(values, dtype, field, (rows or {}).get(field))
            batch[field] = padded.swapaxes(1, 2) if field in FRAMES_FIRST else padded
        else:
            batch[field] = _stacked(values, dtype, field, isinstance(items, StoredItems))
    return unwrap(sent(batch))


def _columns(items: Sequence[Item]) -> tuple[dict[str, list[Any]], torch.dtype | None]:
    """Field to the value of each garment, and the floating type that they are cast to.

    Of stored garments the mapped rows, which collation copies once.
    """
    if isinstance(items, StoredItems):
        return {field: items.column(field) for field in items.fields}, items.dtype
    _require_same_fields(items)
    return {field: [_rows_first(item[field], field) for item in items] for field in items[0]}, None


def _rows_first(values: Any, field: str) -> Any:
    """The values of a ragged field with the rows as their first axis; and such values as the batch holds them."""
    return values.swapaxes(0, 1) if field in FRAMES_FIRST else values


def _concatenated(
    values: list[Any], counts: Sequence[int], dtype: torch.dtype | None, starts: Mapping[str, Any], field: str
) -> Tensor:
    """The rows of all garments; row numbers in them are offset by each garment's start."""
    rows = _in_one_thread(values, dtype, field)
    pointing = POINTS_TO.get(field, ())
    if isinstance(rows[0], Tensor):
        joined = torch.cat(rows)
        for columns, target in pointing:
            offsets = torch.from_numpy(starts_of(starts, field, target)[:-1].repeat(counts))
            joined.T[columns] += offsets.to(joined)
        return joined
    out = _empty((sum(counts), *rows[0].shape[1:]), rows[0], dtype)
    if pointing and pointing[0][0] == WHOLE:  # copy and offset in one pass: the largest arrays
        begin, offsets = 0, starts_of(starts, field, pointing[0][1]).tolist()
        for value, count, offset in zip(rows, counts, offsets, strict=False):
            np.add(value, offset, out=out[begin : begin + count], casting="unsafe")
            begin += count
        return torch.from_numpy(out)
    np.concatenate(rows, out=out, casting="unsafe")
    for columns, target in pointing:
        offsets = starts_of(starts, field, target)[:-1].astype(out.dtype).repeat(counts)
        for column in out.T[columns]:  # one by one: broadcasting over short rows takes ten times as long
            column += offsets
    return torch.from_numpy(out)


def _pad(values: list[Any], dtype: torch.dtype | None, field: str, count: int | None) -> tuple[Tensor, Tensor]:
    """The padded values [B, n, …] and their mask [B, n]."""
    rows, lengths = _in_one_thread(values, dtype, field), list(map(len, values))
    longest = max(lengths) if count is None else count
    if max(lengths) > longest:
        raise ConfigError(
            f"a garment has {max(lengths)} rows of {field}, more than rows={longest}: give more, or leave rows out"
        )
    out = _empty((len(rows), longest, *rows[0].shape[1:]), rows[0], dtype)
    padded = torch.as_tensor(out)
    padding = 0 if padded.is_floating_point() or padded.dtype == torch.bool else -1
    for own, value in zip(out, rows, strict=True):
        own[: len(value)] = value
        own[len(value) :] = padding
    mask = np.arange(longest) < np.array(lengths)[:, None]
    return padded, torch.from_numpy(mask).to(padded.device)


def _stacked(values: list[Any], dtype: torch.dtype | None, field: str, is_stored: bool) -> Any:
    """Tensors of equal shape stacked, and ``is_stored`` arrays; anything else as a list."""
    first = values[0]
    kinds = (Tensor, np.ndarray) if is_stored else Tensor
    if all(isinstance(value, Tensor) and value.dtype == torch.uint8 for value in values):  # pictures
        first = next((value for value in values if value.numel()), first)
        values = [value if value.numel() else torch.zeros_like(first) for value in values]
    if all(isinstance(value, kinds) and value.shape == first.shape for value in values):
        return _concatenated([value[None] for value in values], [1] * len(values), dtype, {}, field)
    if is_stored and isinstance(first, np.ndarray):
        return [tensor_of(value.copy(), dtype) for value in values]
    return values


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
            raise ConfigError(f"only some garments of the batch have {odd}: choose the same fields, or OutfitCloth")


def _require_same_type(values: Sequence[Tensor], field: str) -> None:
    """Raise ``ConfigError`` for different types of one field: in one array some would lose digits."""
    if any(value.dtype != values[0].dtype for value in values):
        types = ", ".join(dict.fromkeys(str(value.dtype) for value in values))
        raise ConfigError(
            f"{field} has types {types} in one batch: give the data set one type, such as dtype=torch.float32"
        )


# torch's threads spin after each call and take cores from workers that make garments: with 14 workers on 16 cores, a
# loop that copied box meshes with torch received half as many garments. NumPy copies in one thread.


def _in_one_thread(values: list[Any], dtype: torch.dtype | None, field: str) -> list[Any]:
    """The values as arrays; as tensors those on a GPU, and types that NumPy lacks, such as bfloat16."""
    first = values[0]
    if isinstance(first, Tensor):
        _require_same_type(values, field)
        if all(map(_numpy_can_view, values)):
            return [value.detach().numpy() for value in values]
        return [value.detach() for value in values]
    if first.dtype.kind == "f" and dtype is not None and dtype not in NUMPY_TYPES:
        return [torch.from_numpy(value).to(dtype) for value in values]
    return values


def _empty(shape: Sequence[int], like: Any, dtype: torch.dtype | None) -> Any:
    """Memory for a batch; an array from a pool of buffers that are reused, floating as ``dtype``."""
    if isinstance(like, Tensor):
        return torch.empty(shape, dtype=like.dtype, device=like.device)
    kind = like.dtype if like.dtype.kind != "f" or dtype is None else NUMPY_TYPES[dtype]
    return np.ndarray(shape, kind, buffer_of(math.prod(shape) * kind.itemsize))


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


def copy_tensor(value: Tensor) -> Tensor:
    """A copy of the tensor, in memory of its own."""
    return torch.from_numpy(value.detach().numpy().copy()) if _numpy_can_view(value) else value.clone()


def pin_tensor(value: Tensor) -> Tensor:
    """A copy in pinned memory. Raises ``RuntimeError`` without a GPU."""
    if not _numpy_can_view(value):
        return value.pin_memory()
    copy = torch.empty_like(value, pin_memory=True)
    np.copyto(copy.numpy(), value.detach().numpy())
    return copy


def _numpy_can_view(value: Tensor) -> bool:
    is_plain = value.device.type == "cpu" and value.layout is torch.strided and not (value.is_conj() or value.is_neg())
    return is_plain and _numpy_has(value.dtype)


@cache
def _numpy_has(dtype: torch.dtype) -> bool:
    """Whether NumPy has the type; it lacks bfloat16 and the 8-bit floats."""
    try:
        torch.empty(0, dtype=dtype).numpy()
    except TypeError:
        return False
    return True


SMALL = 1 << 16  # bytes: smaller allocations usually reuse touched pages anyway
MOST_KEPT = 1 << 26  # bytes of buffers kept, of each size
MOST_TRIED = 16  # buffers of a size that are looked at

_kept: dict[int, list[np.ndarray]] = defaultdict(list)
"""Buffers by size, the one lent last at the end. Views of an array refer to the array that owns the memory."""


def _references(kept: list[np.ndarray]) -> int:
    """References to the last buffer, taken out as in ``_unused``; their number differs between versions of Python."""
    memory = kept.pop()
    return sys.getrefcount(memory)


UNUSED = _references([np.empty(0, np.uint8)])
"""References to a buffer that no array views."""


def buffer_of(size: int) -> UInt8[np.ndarray, " size"]:
    """An uninitialised array of ``size`` bytes, from the pool unless it is small. Safe for threads and forks.

    The system clears each page of fresh memory at its first use. Measured for 800 kB: clearing takes 0.8 ms, copying a
    garment into it 0.2 ms.

    >>> first = buffer_of(100_000)
    >>> address = first.ctypes.data
    >>> del first
    >>> buffer_of(100_000).ctypes.data == address
    True
    """
    if size < SMALL:
        return np.empty(size, np.uint8)
    room = 1 << (size - 1).bit_length()
    kept = _kept[room]
    memory = _unused(kept)
    if memory is None:
        memory = np.empty(room, np.uint8)
    if (len(kept) + 1) * room <= MOST_KEPT:
        kept.append(memory)
    return memory[:size]


def _unused(kept: list[np.ndarray]) -> np.ndarray | None:
    """Take out the buffer lent last among those that no array views."""
    used: list[np.ndarray] = []
    try:
        while len(used) < MOST_TRIED:
            memory = kept.pop()  # no other thread sees it meanwhile
            if sys.getrefcount(memory) == UNUSED:
                return memory
            used.append(memory)
    except IndexError:
        pass
    finally:
        kept.extend(reversed(used))
    return None
