"""Stored garments of a batch: views of mapped columns, copied once, into the batch."""

from collections.abc import Iterator, Sequence
from typing import Any, overload

import numpy as np
import torch

from gcd_dataset.errors import ShardError
from gcd_dataset.loaders.base import GarmentItem, tensor_of
from gcd_dataset.shards.codec import SECTIONS, decode_field
from gcd_dataset.shards.columns import value_of
from gcd_dataset.shards.layout import JOINT


class StoredItems(Sequence[GarmentItem]):
    """The items of a batch, made when they are asked for; ``collate_packed`` takes the stored rows themselves.

    ``views``: field to the rows of each garment (``Columns.views``), for fields that join views those of their members.
    Each item is a copy: changing it changes no other.
    """

    def __init__(
        self, fields: Sequence[str], views: dict[str, list[np.ndarray]], dtype: torch.dtype | None, count: int
    ) -> None:
        self.fields, self.dtype, self._views, self._count = fields, dtype, views, count

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> GarmentItem: ...
    @overload
    def __getitem__(self, index: slice) -> list[GarmentItem]: ...
    def __getitem__(self, index: int | slice) -> Any:
        if isinstance(index, slice):
            return [self[row] for row in range(self._count)[index]]
        values = ((field, self._value(field, index)) for field in self.fields)
        return GarmentItem((field, self._tensor(field, value)) for field, value in values)

    def __iter__(self) -> Iterator[GarmentItem]:
        return (self[row] for row in range(self._count))

    def column(self, field: str) -> list[Any]:
        """The value of a field of each garment: stored rows for arrays, tensors for pictures, else what it holds."""
        if field in SECTIONS:
            return self._views[field]
        return [self._tensor(field, self._value(field, row)) for row in range(self._count)]

    def _value(self, field: str, row: int) -> Any:
        if field in JOINT:
            members = {name: rows[row].tobytes() for name, rows in self._views.items() if name.startswith("view_")}
            return decode_field(field, {_member(name): content for name, content in members.items()})
        return value_of(field, self._views[field][row])

    def _tensor(self, field: str, value: Any) -> Any:
        if not isinstance(value, np.ndarray):
            return value
        try:
            return tensor_of(value.copy() if field in SECTIONS else value, self.dtype)
        except ShardError as error:
            raise ShardError(f"field {field}: {error}") from error


def _member(field: str) -> str:
    return f"{field.removesuffix('_json')}.json" if field.endswith("_json") else f"{field}.jpg"
