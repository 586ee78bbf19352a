"""Garments from shards: by number, or as a stream."""

import bisect
import tarfile
import zlib
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import accumulate
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch.utils.data import IterableDataset, get_worker_info
from webdataset.tariterators import group_by_keys, tar_file_expander

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.hub.opening import open_store
from gcd_dataset.hub.site import Remote
from gcd_dataset.loaders.available import lacking_where
from gcd_dataset.loaders.base import GarmentItem, Garments, Transform, made_with, naming, tensor_of
from gcd_dataset.loaders.indexing import UnknownKeyError, number_in
from gcd_dataset.loaders.ranks import is_in_group, present_rank, runs_beside_accelerate, shared_out_by
from gcd_dataset.loaders.recipe_source import RECIPE, recipe_folder
from gcd_dataset.loaders.splits import parse_splits
from gcd_dataset.shards.codec import NO_PICTURE, read_meta
from gcd_dataset.shards.folder import FolderStore
from gcd_dataset.shards.foreign_member import decode_member
from gcd_dataset.shards.layout import FOREIGN, MEMBERS, Bytes, fields_of, key_of, members_of
from gcd_dataset.shards.npy import write_npy
from gcd_dataset.shards.reader import ShardReader, Verify, naming_sample
from gcd_dataset.shards.store import Store
from gcd_dataset.shards.tar import BLOCK, stream_samples

__all__ = ["GarmentDataset", "StreamedGarments"]

META = MEMBERS[0]
EMPTY = {"npy": len(write_npy(np.zeros(0, np.float32))), "jpg": len(NO_PICTURE)}
"""Bytes of a member that a step not taken leaves: fewer than of any other."""


class GarmentDataset(Garments):
    """Garments in a folder of shards, at a URL, or in a repository of the Hugging Face Hub, by number.

    >>> ds = GarmentDataset("garments", fields=("verts", "faces"))  # doctest: +SKIP
    >>> ds[0]["verts"].shape  # doctest: +SKIP
    torch.Size([14425, 3])
    >>> GarmentDataset("org/garments", "train[:10%]", fields=["points"], max_cache_size="20GB")  # doctest: +SKIP
    >>> GarmentDataset("recipe:standard-1k", "test")  # doctest: +SKIP

    ``source``: a folder, ``http://…``, ``https://…``, ``file://…``, ``s3://BUCKET/PREFIX`` or any other URL of
    ``fsspec``, or ``ORG/NAME`` (also ``hf://…``, ``…@REVISION``); or ``recipe:NAME``, or ``recipe:FILE.toml``: a data
    set that is made by its recipe, here and now if it is not there.
    ``split``: ``train``, ``train[:10%]``, ``train[100:200]``, ``train+test``.
    ``fields``: what to read; for ``None`` all that the garments hold, which those made up to the stage ``pattern`` or
    ``mesh`` do not have all; nothing else is touched, nor asked of a server. ``dtype``: of floating fields, float32 by
    default, ``None`` for what is stored.
    ``root``: download the split, or the fields of it, into this folder first, and read it there. Of a recipe, make all
    of its data set in the folder NAME there, by default in that of the cache.
    ``download``: without it no server is asked, and nothing made: what is in ``root`` or the cache has to do.
    ``revision``: branch, tag or commit of a repository; looked up once, see the attribute ``revision``.
    ``cache_dir``, ``max_cache_size``: where what was read of a server is kept, and how much of it, such as ``"20GB"``;
    may be shared by any number of processes. By default ``~/.cache/gcd_dataset``, without limit.
    ``patience``: seconds to wait for a server that is gone or busy, before reading fails; by default 30, ``math.inf``
    for as long as it takes.
    ``endpoint``, ``token``: of the Hub; by default what ``HF_ENDPOINT`` and ``hf auth login`` have set.
    ``transform``: called with each item. ``verify``: ``lazy`` checks a member's CRC-32 the first time that a process
    reads it, ``full`` checks everything at once, ``off`` nothing; what comes from a server is checked in any case.
    ``settled_only``: only garments whose drape hangs still. ``streaming``: an iterable data set instead, which reads
    shards from end to end through ``webdataset`` and shares garments out over ranks and workers; of a server too, where
    it keeps nothing.

    Tars that others have made for ``webdataset`` are read too: their fields are the endings of their names, such as
    ``seg.png``, decoded by the last of these, and ``None`` where a sample has no such file.

    Raises ``ShardError`` for a source that holds no such split, or a broken or newer one, ``RemoteError`` for a server
    that does not answer, ``ConfigError`` for options that do not fit together, and for a field that no garment of the
    split holds, since they were not made up to that stage.
    """

    reads_only = True

    def __new__(cls, *args: Any, streaming: bool = False, **options: Any) -> "GarmentDataset":
        return super().__new__(StreamedGarments if streaming else cls)

    def __init__(
        self,
        source: str | Path,
        split: str = "train",
        fields: Iterable[str] | None = None,
        *,
        root: str | Path | None = None,
        download: bool = True,
        streaming: bool = False,
        revision: str | None = None,
        cache_dir: str | Path | None = None,
        max_cache_size: int | str | None = None,
        endpoint: str | None = None,
        token: str | None = None,
        patience: float | None = None,
        transform: Transform | None = None,
        verify: Verify = "lazy",
        settled_only: bool = False,
        dtype: torch.dtype | None = torch.float32,
    ) -> None:
        parts = parse_splits(split)
        fields = None if fields is None else [fields] if isinstance(fields, str) else list(fields)
        remote = Remote(revision, cache_dir, max_cache_size, endpoint, token, allowed=download, patience=patience)
        splits = tuple(dict.fromkeys(part.name for part in parts))
        if isinstance(source, str) and source.startswith(RECIPE):
            store: Store = FolderStore(recipe_folder(source, remote, root, splits))
        else:
            store = open_store(source, remote, root=root, splits=splits, fields=fields)
        readers = {name: ShardReader(store, name, verify=verify, settled_only=settled_only) for name in splits}
        self._parts = [_Part(readers[part.name], part.range_of(len(readers[part.name]))) for part in parts]
        self._ends = list(accumulate(len(part.positions) for part in self._parts))
        self._member_of = _member_of([part.reader for part in self._parts])
        self._foreign = self._parts[0].reader.layout.kind == FOREIGN
        super().__init__(fields, transform, there=self._member_of, lacking=self._lacking(), dtype=dtype)
        self._check_stream = verify != "off"
        self.source = store.source
        """Where the garments come from, with the revision: ``None`` for a folder that was not downloaded."""

    @property
    def revision(self) -> str | None:
        """The commit of the Hub that is read, or the hash of a URL's manifest."""
        return None if self.source is None else self.source.rpartition("@")[2]

    def __len__(self) -> int:
        return self._ends[-1]

    def _one(self, position: int) -> Any:
        part, place = self._place(position)
        with part.reader.naming(place):
            return self._item(part.reader.read(place, self._wanted), position)

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """Several garments, as a ``DataLoader`` asks for a batch of them: of a server all at once."""
        asked: dict[ShardReader, list[int]] = {}
        places = []
        for index in indices:
            part, position = self._place(self._position(index))
            asked.setdefault(part.reader, []).append(position)
            places.append((part.reader, position))
        content = {reader: reader.read_many(positions, self._wanted) for reader, positions in asked.items()}
        items = []
        for index, (reader, position) in zip(indices, places, strict=True):
            members = next(content[reader])
            with naming(self, index), reader.naming(position):
                items.append(self._item(members, self._position(index)))
        return items

    def recipe(self, index: int) -> dict[str, Any]:
        """Seed, index, options and versions that garment ``index`` was made with, and ``source`` if it was published.

        Raises ``IndexError``, and ``ConfigError`` for a foreign sample, which does not tell.
        """
        position = self._position(index)
        if self._foreign:
            raise ConfigError("samples of foreign archives do not tell how they were made: ask their maker")
        made = made_with(self._members(position, (META,))[META])
        return made if self.source is None else {**made, "source": self.source}

    def identity(self) -> dict[str, Any]:
        """What tells these garments from others, wherever they lie; of foreign ones, who tell nothing, their names."""
        if not self._foreign:
            return super().identity()
        places = [self._place(self._position(index)) for index in (0, -1)]
        keys = [part.reader.index.key(int(part.reader.rows([place])[0])) for part, place in places]
        return {"length": len(self), "ends": keys}

    def verify(self, index: int) -> None:
        """Raise ``ShardError`` with shard, key and member if a byte of garment ``index`` is not as it was written."""
        part, position = self._place(self._position(index))
        part.reader.check(position)

    def _described(self) -> list[str]:
        splits = dict.fromkeys(part.reader.split for part in self._parts)
        return [f"{' + '.join(splits)} of {self._parts[0].reader.store.location()}"]

    def _lacking(self) -> dict[str, str]:
        """Field to the reason why no garment holds it, by the sizes in the index."""
        if self._foreign:
            return {}
        largest = {
            field: max(part.largest(member) for part in self._parts) for field, member in self._member_of.items()
        }
        return lacking_where(
            lambda field: largest[field] <= EMPTY[self._member_of[field].rpartition(".")[2]], self._member_of
        )

    def _of_key(self, key: str) -> int | None:
        number = number_in(key)
        if number is None and not self._foreign:
            return None
        found: dict[str, int] = {}
        for part, end in zip(self._parts, self._ends, strict=True):
            place = part.place_of(key) if number is None or self._foreign else part.place_of_number(number)
            if place is not None:
                found.setdefault(part.reader.split, end - len(part.positions) + place)
        if len(found) > 1:
            raise UnknownKeyError(f"garment {key} is in {' and in '.join(found)}: open one split, or give its number")
        return next(iter(found.values()), None)

    def _key(self, position: int) -> str:
        part, place = self._place(position)
        return part.reader.index.key(int(part.reader.rows([place])[0]))

    @property
    def _wanted(self) -> tuple[str, ...]:
        if self._foreign:
            return self.fields
        return members_of(self.fields, self._member_of)

    def _place(self, position: int) -> tuple["_Part", int]:
        """The part that holds a garment, and its position in the part's reader."""
        number = bisect.bisect_right(self._ends, position)
        part = self._parts[number]
        return part, part.positions[position - (self._ends[number] - len(part.positions))]

    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        part, place = self._place(position)
        return part.reader.read(place, members)

    def _item(self, members: Mapping[str, Bytes], position: int) -> Any:
        if not self._foreign:
            return super()._item(members, position)
        values = {name: decode_member(name, members[name]) if name in members else None for name in self.fields}
        item = GarmentItem(
            (name, tensor_of(value, self.dtype) if isinstance(value, np.ndarray) else value)
            for name, value in values.items()
        )
        return self._transformed(item, position)


class _Part(NamedTuple):
    """Some samples of a split."""

    reader: ShardReader
    positions: range

    def largest(self, member: str) -> int:
        """Bytes of the largest member of that name."""
        index = self.reader.index
        size = index.table.size[self.reader.rows(self.positions), index.layout.members.index(member)]
        return int(size.max(initial=0))

    def place_of_number(self, number: int) -> int | None:
        """Where among its samples the one that was written under a number stands."""
        there = self.reader.index.table.sample[self.reader.rows(self.positions)]
        return next(iter(np.flatnonzero(there == number).tolist()), None)

    def place_of(self, key: str) -> int | None:
        """Where among its samples the one of that key stands."""
        keys = map(self.reader.index.key, self.reader.rows(self.positions).tolist())
        return next((place for place, other in enumerate(keys) if other == key), None)


class _Stretch(NamedTuple):
    """Some samples of a part that are in one shard, in the order of the file."""

    part: _Part
    shard: int
    rows: np.ndarray
    """Of the index."""
    places: np.ndarray
    """Their numbers in the data set."""

    @property
    def name(self) -> str:
        """The shard's file."""
        return self.part.reader.index.shards[self.shard]

    def within(self, first: int, count: int) -> "_Stretch":
        """Those from sample ``first`` on, which may be before this stretch, ``count`` of them at most."""
        own = slice(max(first, 0), max(first + count, 0))
        return self._replace(rows=self.rows[own], places=self.places[own])

    def by_key(self) -> dict[str, list[int]]:
        """Key to numbers in the data set: of a foreign archive, samples may share one."""
        numbers: dict[str, list[int]] = {}
        for row, place in zip(self.rows.tolist(), self.places.tolist(), strict=True):
            numbers.setdefault(self.part.reader.index.key(row), []).append(place)
        return numbers

    def begin(self) -> int:
        """First byte of the first sample in an archive of ours, which begins with this member."""
        index = self.part.reader.index
        return int(index.table.offset[self.rows[0], index.layout.members.index(META)]) - BLOCK


def _member_of(readers: Iterable[ShardReader]) -> dict[str, str]:
    """Field to member, of those that all splits have. Raises ``ConfigError`` for splits of different kinds."""
    layouts = [reader.layout for reader in readers]
    if len({layout.kind for layout in layouts}) > 1:
        raise ConfigError("our samples in one split and foreign ones in another: open them as two data sets")
    shared = [member for member in layouts[0].members if all(member in layout.members for layout in layouts)]
    if layouts[0].kind == FOREIGN:
        return {member: member for member in shared}
    return fields_of(shared)


class StreamedGarments(GarmentDataset, IterableDataset):
    """The same items in the order of the shards; ranks and workers share them out as neighbouring stretches.

    Every garment comes once, and no rank or worker gets more than one garment more than another. A shard that several
    have a part of is read by each of them, in a folder from where its part begins, of a server from the shard's
    beginning.
    """

    _ranks: tuple[int, int] | None = None
    """Rank and number of ranks of the process that has spawned this one as a worker."""

    def select(self, indices: Iterable[int]) -> Garments:
        raise ConfigError("a stream has no numbers to choose by: leave out streaming=True, or slice the split")

    def __getitem__(self, index: Any) -> Any:
        raise ConfigError("a stream has no numbers to choose by: leave out streaming=True")

    def __iter__(self) -> Iterator[Any]:
        first, count = self._share()
        for stretch in self._stretches():
            own = stretch.within(first, count)
            if len(own.places):
                yield from self._from_shard(own)
            first -= len(stretch.places)

    def __getstate__(self) -> dict[str, Any]:
        # A spawned worker is in no group of processes, and may not have the environment of its rank either.
        return {**self.__dict__, "_ranks": present_rank() if is_in_group() else self._ranks}

    def _share(self) -> tuple[int, int]:
        """Where this process begins, in the order of the shards, and how many garments it gets."""
        worker = get_worker_info()
        rank, ranks = (0, 1) if shared_out_by() else self._ranks or present_rank()
        if worker is not None and ranks > 1 and runs_beside_accelerate():
            raise ConfigError(
                "streaming=True in workers beside accelerate, which may share out garments too: give num_workers=0, or "
                "leave out streaming=True and load with a GarmentLoader"
            )
        number, of = (0, 1) if worker is None else (worker.id, worker.num_workers)
        begin, end = (edge * len(self) // ranks for edge in (rank, rank + 1))
        first, last = (begin + edge * (end - begin) // of for edge in (number, number + 1))
        return first, last - first

    def _stretches(self) -> Iterator["_Stretch"]:
        """All garments, shard by shard, as they lie in the files."""
        for part, end in zip(self._parts, self._ends, strict=True):
            index, rows = part.reader.index, part.reader.rows(part.positions)
            for shard in np.unique(index.shard[rows]).tolist():
                places = np.flatnonzero(index.shard[rows] == shard)
                places = places[np.argsort(rows[places], kind="stable")]
                yield _Stretch(part, shard, rows[places], end - len(part.positions) + places)

    def _from_shard(self, stretch: "_Stretch") -> Iterator[Any]:
        """The samples of a stretch."""
        reader = stretch.part.reader
        store, members, left = reader.store, self._streamed, stretch.by_key()
        place, count = store.location(stretch.name), len(stretch.places)
        begin = 0 if self._foreign else stretch.begin()
        samples = _foreign_samples if self._foreign else partial(_samples, wanted=members)
        for sample in samples(reader, stretch.name, begin=begin):
            if not (positions := left.get(sample["__key__"])):
                continue  # a part of others, or the shard has grown since
            if not self._foreign:
                if missing := sorted(members - sample.keys()):
                    raise ShardError(f"{place}: sample {sample['__key__']} has no {missing[0]}: {store.remedy}")
                if self._check_stream:
                    _check(place, sample, store.remedy)
            count -= 1
            with naming_sample(partial(_named, place, sample)):
                item = self._item(sample, positions.pop(0))
            yield item
            if not count:
                return
        # A damaged header looks like the end of an archive to ``tarfile``, which then leaves out the rest of it.
        there = len(stretch.places)
        raise ShardError(f"{place}: {there - count} samples of {there} read: {store.remedy}")

    @property
    def _streamed(self) -> set[str]:
        """Members to take out of our archives: the first always, or a sample without fields would not be one."""
        return {META, *self._wanted}


def _samples(reader: ShardReader, shard: str, wanted: Container[str], begin: int) -> Iterator[Mapping[str, Any]]:
    """The samples of a shard of ours, from a byte on where the shard can be begun there.

    Raises ``ShardError`` for a damaged archive.
    """
    try:
        with reader.store.stream(shard) as stream:
            start = stream.seek(begin) if stream.seekable() else 0
            for key, members in stream_samples(stream, wanted, begin=start):
                yield {"__key__": key, **members}
    except ShardError as error:
        place = reader.store.location(shard)
        if str(error).startswith(place):
            raise
        raise ShardError(f"{place}: a damaged archive ({error}): {reader.store.remedy}") from error


def _foreign_samples(reader: ShardReader, shard: str, begin: int) -> Iterator[Mapping[str, Any]]:
    """The samples of a shard as ``webdataset`` gives them. Raises ``ShardError`` for a damaged archive."""
    place = reader.store.location(shard)
    try:
        # Opened here, since WDS_SECURE=1 forbids ``webdataset`` to open files.
        with reader.store.stream(shard) as stream:
            yield from group_by_keys(tar_file_expander([{"url": place, "stream": stream}]))
    except (tarfile.TarError, ValueError) as error:  # the latter for a name that comes twice
        told = " ".join(str(error.args[0] if error.args else error).split())
        raise ShardError(f"{place}: a damaged archive ({told}): {reader.store.remedy}") from error


def _named(place: str, sample: Mapping[str, Any]) -> str:
    return f"{place}: sample {sample['__key__']}"


def _check(place: str, sample: Mapping[str, Any], remedy: str) -> None:
    """Raise ``ShardError`` if a member differs from the CRC-32 in the sample's meta.json."""
    try:
        meta = read_meta(sample[META])
    except ShardError as error:
        raise ShardError(f"{place}: sample {sample['__key__']}, member {META}: {error}: {remedy}") from error
    if key_of(meta["index"]) != sample["__key__"]:
        raise ShardError(f"{place}: sample {sample['__key__']} says that it is {key_of(meta['index'])}: {remedy}")
    written = meta.get("crc32")
    if not isinstance(written, Mapping):
        raise ShardError(f"{place}: sample {sample['__key__']}, member {META}: no checksums of its members: {remedy}")
    for member in sample.keys() - {META, "__key__", "__url__"}:
        if zlib.crc32(sample[member]) != written.get(member):
            raise ShardError(
                f"{place}: sample {sample['__key__']}, member {member}: bytes differ from those that were written: "
                f"{remedy}"
            )
