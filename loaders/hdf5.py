"""``Hdf5Garments``: garments from one HDF5 file."""

from bisect import bisect_left
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import torch

from gcd_dataset.errors import ShardError
from gcd_dataset.files import user_path
from gcd_dataset.loaders.available import absent_when_empty
from gcd_dataset.loaders.base import Garments, Transform, recipe_from_meta
from gcd_dataset.loaders.indexing import index_from_key
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.codec import NO_PICTURE, read_meta
from gcd_dataset.shards.layout import FIELDS, Bytes, fields_of, garments_layout, is_view_field, key_of, select_fields

__all__ = ["Hdf5Garments"]


class Hdf5Garments(Garments):
    """Garments in a file made by ``gcd export --hdf5``; items equal those of the exported shards.

    >>> ds = Hdf5Garments("train.h5", fields=("verts", "faces"))  # doctest: +SKIP
    >>> ds[0]["verts"].shape  # doctest: +SKIP
    torch.Size([14475, 3])

    Each process of a ``DataLoader``, forked or spawned, opens the file itself. Shards are several times as fast: train
    from shards. ``fields`` and ``dtype`` as in ``GarmentDataset``. Raises ``ShardError`` for a missing, damaged,
    foreign or newer file, ``ConfigError`` for a field that no garment of the file holds.
    """

    reads_only = True

    def __init__(
        self,
        source: str | Path,
        fields: Iterable[str] | None = None,
        *,
        transform: Transform | None = None,
        dtype: torch.dtype | None = torch.float32,
    ) -> None:
        from gcd_dataset.shards.hdf5 import Hdf5Reader  # imports h5py

        requested = fields if fields is None else {fields} if isinstance(fields, str) else set(fields)
        of_garment = requested and [field for field in requested if not is_view_field(field)]
        select_fields(of_garment, fields_of(garments_layout(caption=True).members))
        _require_file(user_path(source))
        self._reader = Hdf5Reader(source)
        available, absent = fields_of(self._reader.members), absent_when_empty(self._is_empty, FIELDS)
        super().__init__(requested, transform, available=available, absent=absent, dtype=dtype)

    @property
    def split(self) -> str:
        """The split in the file."""
        return self._reader.split

    def __len__(self) -> int:
        return len(self._reader)

    def recipe(self, index: int) -> dict[str, Any]:
        """Seed, index, options and versions that garment ``index`` was made with. Raises ``IndexError``."""
        return recipe_from_meta(self._reader.read(self._position(index), ["meta.json"])["meta.json"])

    def verify(self, index: int) -> None:
        """Raise ``ShardError`` with file and member if the bytes of garment ``index`` are not those written."""
        self._reader.check(self._position(index))

    def _is_empty(self, field: str) -> bool:
        """Whether a field is empty in all garments of the file."""
        return self._reader.largest(field) <= (len(NO_PICTURE) if FIELDS[field].endswith(".jpg") else 0)

    def _description(self) -> list[str]:
        return [f"{self.split} of {self._reader.path}"]

    def _find_key(self, key: str) -> int | None:
        number = index_from_key(key)
        if number is None:
            return None
        # Garments are sorted by number.
        position = bisect_left(range(len(self)), number, key=self._number)
        return position if position < len(self) and self._number(position) == number else None

    def _number(self, position: int) -> int:
        return int(read_meta(self._reader.read(position, ["meta.json"])["meta.json"])["index"])

    def _key(self, position: int) -> str:
        return key_of(self._number(position))

    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        # meta.json holds scale and centre of the points.
        return self._reader.read(position, dict.fromkeys((*members, FIELDS["meta"])))


def _require_file(path: Path) -> None:
    """Raise ``ShardError`` for a folder or a missing file."""
    with reading(path):
        is_folder, exists = path.is_dir(), path.exists()
    if is_folder:
        raise ShardError(
            f"{path}: a folder: give a file from gcd export --hdf5; GarmentDataset reads folders of shards"
        )
    if not exists:
        raise ShardError(f"{path}: no such file: give one that gcd export --hdf5 has made")
