"""``GarmentDataset(..., frames=8)``: windows of consecutive frames of garments in motion."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders.base import GarmentItem, decode_item, require_integer, tensor_of
from gcd_dataset.loaders.shards import GarmentDataset, StoredItems
from gcd_dataset.records import BONES
from gcd_dataset.shards.codec import decode_field, decode_fields
from gcd_dataset.shards.layout import ARRAYS, META, MOTION, fields_of

VERTS, POSE = ARRAYS[MOTION]
VELOCITIES, FIRST = "motion_velocities", "motion_first"


class MotionWindows(GarmentDataset):
    """Every window of ``frames`` consecutive frames, by garment and first frame; also by index, in any order.

    Beside the fields of its garment an item holds ``motion_verts``, ``motion_pose``, ``motion_first`` and
    ``motion_velocities``: see ``GarmentFields``. ``ds[key]`` is the first window of a garment. A garment with fewer
    frames has none. Opening reads ``meta.json`` of every garment, and the first window of a shard its motions, which
    are kept in the cache as columns. Raises ``ConfigError`` for garments that do not move, or move for less.
    """

    def __init__(self, source: str | Path, *args: Any, frames: int | None = None, **options: Any) -> None:
        self.frames = require_integer("frames", frames or 0, least=1)
        if options.get("streaming"):
            raise ConfigError("streaming=True reads whole garments: leave it out, or frames")
        super().__init__(source, *args, **options)
        found: list[Mapping[str, Any]] = []
        for reader, positions in self._parts:
            found += [decode_field("meta", each)["motion"] for each in reader.read_many(positions, [META])]
        self._fps = np.array([motion["fps"] for motion in found])
        self._counts = np.array([motion["frames"] for motion in found], int)
        """Frames of each garment."""
        self._starts = np.cumsum([0, *np.maximum(self._counts - self.frames + 1, 0)])
        """First window of each garment, and the number of windows."""
        if not len(self):
            longest = self._counts.max(initial=0)
            raise ConfigError(f"frames={self.frames}: the longest motion of {source} has {longest} frames: give fewer")

    def _available(self, members: Sequence[str]) -> dict[str, str]:
        if MOTION not in members:
            raise ConfigError("frames is for garments in motion: leave it out, or make some: gcd generate --poses walk")
        return fields_of(members) | dict.fromkeys((VELOCITIES, FIRST), MOTION)

    @property
    def _read_fields(self) -> tuple[str, ...]:
        moving = [VERTS] if {VERTS, VELOCITIES} & {*self.fields} else []
        return (*self._still_fields, *moving, *([POSE] if POSE in self.fields else []))

    @property
    def _still_fields(self) -> tuple[str, ...]:
        return tuple(field for field in self.fields if not field.startswith("motion_"))

    def __len__(self) -> int:
        return int(self._starts[-1])

    def _garment(self, position: int) -> int:
        return int(np.searchsorted(self._starts, position, "right")) - 1

    def _locate(self, position: int) -> Any:
        return super()._locate(self._garment(position))

    def _find_key(self, key: str) -> int | None:
        garment = super()._find_key(key)
        return None if garment is None or not np.diff(self._starts)[garment] else int(self._starts[garment])

    def shard_lengths(self) -> list[int]:
        """Number of windows in each shard that has some, in order."""
        lengths = np.diff(self._starts[[0, *np.cumsum(super().shard_lengths())]])
        return [count for count in lengths.tolist() if count]

    def identity(self) -> dict[str, Any]:
        return super().identity() | {"frames": self.frames}

    def __getitems__(self, indices: Iterable[int]) -> list[Any]:
        return [self._load(self._position(index), is_of_batch=True) for index in indices]

    def _load(self, position: int, *, is_of_batch: bool = False) -> Any:
        """The item at a position, from columns if they fit into the cache: decoding a motion takes long."""
        part, row = self._locate(position)
        columns, still = self._columns[part.reader.split], self._still_fields
        if columns.has(row) or self._fit(columns):
            views = columns.views([row])
            rows: Mapping[str, Any] = {field: views[field][0] for field in ARRAYS[MOTION] if field in views}
            item = StoredItems(still, views, self.dtype, 1)[0]
        else:
            with part.reader.naming(row):
                members = part.reader.read(row, self._member_names)
                rows = decode_fields(members, [field for field in self._read_fields if field not in still])
                item = decode_item(members, still, self.dtype)
        return self._transformed(GarmentItem(item | self._window_of(position, rows)), position)

    def _window_of(self, position: int, rows: Mapping[str, Float32[np.ndarray, "n 3"]]) -> dict[str, torch.Tensor]:
        garment = self._garment(position)
        first, count = position - int(self._starts[garment]), int(self._counts[garment])
        chosen, found = slice(first, first + self.frames), dict[str, Any]()
        if VERTS in rows:
            verts = rows[VERTS].reshape(count, -1, 3)
            found[VERTS] = verts[chosen].copy()
            before = verts[max(first - 1, 0) : first or 1]
            found[VELOCITIES] = np.diff(found[VERTS], axis=0, prepend=before) * np.float32(self._fps[garment])
        if POSE in rows:
            found[POSE] = rows[POSE].reshape(count, len(BONES), 3)[chosen].copy()
        tensors = {field: tensor_of(found[field], self.dtype) for field in found if field in self.fields}
        return tensors | ({FIRST: torch.tensor(first)} if FIRST in self.fields else {})
