"""Writes shards. Finished samples survive a kill, and several runs give the same shards as one."""

import contextlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from gcd_dataset.errors import ConfigError, OutputError
from gcd_dataset.files import make_folder, user_path
from gcd_dataset.records import Sample
from gcd_dataset.shards.access import locked, reading
from gcd_dataset.shards.codec import encode_sample
from gcd_dataset.shards.growing import GrowingShard, shard_record
from gcd_dataset.shards.index import ShardIndex, empty_table, read_tables
from gcd_dataset.shards.layout import (
    GARMENTS,
    Bytes,
    Layout,
    index_name,
    key_of,
    lock_name,
    shard_name,
    shard_number,
)
from gcd_dataset.shards.manifest import ShardRecord, SplitRecord, keep_split
from gcd_dataset.shards.origin import record_to_resume, require_schema

__all__ = ["ShardWriter"]

SHARD_SIZE = 256  # samples: about 250 MB of draped garments at 1 cm
UNLISTED = 1 / 64  # share of the shards that may be missing from the manifest: each update rewrites all its entries


class ShardWriter:
    """Writes the samples of one split into a folder, continuing the work of an earlier writer.

    Shard k holds the samples from ``k * shard_size`` to ``(k + 1) * shard_size - 1``, sorted by index, independent of
    the order and the number of runs in which they were written. A shard being filled is named ``….tar.part``. At the
    end of the ``with`` block, also after an error, it becomes a finished shard of the samples so far; a later writer
    completes it. After a kill or a power cut the next writer recovers the whole samples of the ``.part`` file.

    A writer holds the lock of its split until ``close``; other splits may be written in parallel.

    ``layout``: the members of a sample; by default a garment without caption and views, see ``garments_layout``.
    Raises ``ConfigError`` for a folder made with another recipe, seed, shard size, schema or version of this package,
    ``ShardError`` for a broken shard, ``OutputError`` for a folder that cannot be written or locked, or is locked by
    another writer.
    """

    def __init__(
        self,
        folder: Path | str,
        *,
        split: str = "train",
        seed: int,
        recipe: Mapping[str, Any],
        shard_size: int = SHARD_SIZE,
        layout: Layout = GARMENTS,
    ) -> None:
        if shard_size < 1:
            raise ConfigError(f"shard_size is {shard_size}: a shard holds 1 sample or more")
        self._folder, self._split, self._layout = make_folder(user_path(folder)), split, layout
        self._open: dict[int, GrowingShard] = {}
        with contextlib.ExitStack() as resources:
            resources.enter_context(locked(self._folder / lock_name(split), f"writing split {split}"))
            resources.callback(_close_all, self._open)
            require_schema(self._folder, split, layout)
            tables = read_tables(self._folder, split, layout)
            requested = SplitRecord(seed, dict(recipe), shard_size, kind=layout.kind)
            self._record = record_to_resume(self._folder, split, tables, requested, layout)
            self._whole = {
                number: table for name, table in tables.items() if (number := shard_number(name, split)) is not None
            }
            self._shards, self._unlisted = self._records(), 0
            self._write_manifest()
            self._resume()
            self._resources = resources.pop_all()
        self._closed = False

    @property
    def done(self) -> frozenset[int]:
        """Indices of the samples on disk."""
        tables = [*self._whole.values(), *(shard.table() for shard in self._open.values())]
        return frozenset(index for table in tables for index in table.sample.tolist())

    def write(self, sample: Sample) -> None:
        """Encode and add a garment. Raises as ``add`` does, and ``ShardError`` where the format cannot hold it."""
        self.add(sample.provenance.index, encode_sample(sample))

    def add(self, index: int, members: Mapping[str, Bytes]) -> None:
        """Add an encoded sample: the members of the writer's layout.

        Raises ``ConfigError`` for a sample that is in the split already, ``OutputError`` where it cannot be written, or
        after ``close``.
        """
        if self._closed:
            raise OutputError(f"{self._folder}: this writer is closed: open another to continue")
        number = index // self._record.shard_size
        if number in self._whole and index in self._whole[number].sample:
            raise ConfigError(
                f"{self._path(number)}: {key_of(index)} is there already: write only indices that are not in .done"
            )
        shard = self._shard(number)
        shard.append(index, members)
        if len(shard.rows) == self._record.shard_size:
            self._finish(number)

    def close(self) -> None:
        """Finish the open shards and write the index. Raises ``OutputError``."""
        if self._closed:
            return
        self._closed = True
        with self._resources:
            for number in sorted(self._open):
                self._finish(number)
            if self._unlisted:
                self._write_manifest()
            tables = {shard_name(self._split, number): self._whole[number] for number in sorted(self._whole)}
            ShardIndex.of(self._folder, tables, self._layout).write(self._folder / index_name(self._split))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except OutputError:
            if kind is None:
                raise
            # Raise the first error; the next writer recovers whole samples from the .part files.

    def _resume(self) -> None:
        """Open the unfinished shards of an earlier writer."""
        names = [path.name.removesuffix(".part") for path in self._folder.glob("*.tar.part")]
        for number in sorted(number for name in names if (number := shard_number(name, self._split)) is not None):
            self._shard(number)

    def _path(self, number: int) -> Path:
        return self._folder / shard_name(self._split, number)

    def _shard(self, number: int) -> GrowingShard:
        if number not in self._open:
            existing = self._whole.get(number, empty_table(self._layout))
            self._open[number] = GrowingShard(self._path(number), existing, self._layout)
        return self._open[number]

    def _finish(self, number: int) -> None:
        shard = self._open[number]
        if shard.rows:
            self._shards[number] = shard.finish()
            self._whole[number] = shard.table()
        else:
            shard.discard()
        self._open.pop(number).close()
        self._unlisted += 1
        if self._unlisted >= UNLISTED * len(self._shards):
            self._write_manifest()

    def _records(self) -> dict[int, ShardRecord]:
        """Number to record of the finished shards: the manifest's where its size matches, else computed."""
        listed = {(shard.name, shard.size): shard for shard in self._record.shards}
        records = {}
        for number, table in self._whole.items():
            path = self._path(number)
            with reading(path):
                records[number] = listed.get((path.name, path.stat().st_size)) or shard_record(path, table)
        return records

    def _write_manifest(self) -> None:
        shards = tuple(self._shards[number] for number in sorted(self._shards))
        keep_split(self._folder, self._split, replace(self._record, shards=shards))
        self._unlisted = 0


def _close_all(shards: dict[int, GrowingShard]) -> None:
    for shard in shards.values():
        shard.close()
    shards.clear()
