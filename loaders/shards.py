"""``GarmentDataset``: garments from shards, by index or as a stream."""

import bisect
import sys
import tarfile
import zlib
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import accumulate
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import numpy as np
import torch
from torch.utils.data import ChainDataset, DataLoader, IterableDataset, get_worker_info
from torch.utils.data._utils.fetch import _IterableDatasetFetcher

from gcd_dataset.errors import ConfigError, ShardError, did_you_mean
from gcd_dataset.files import user_path
from gcd_dataset.hub.opening import open_store
from gcd_dataset.hub.site import Remote
from gcd_dataset.loaders.available import absent_when_empty
from gcd_dataset.loaders.base import GarmentItem, Garments, Transform, note_items, recipe_from_meta, tensor_of
from gcd_dataset.loaders.indexing import UnknownKeyError, index_from_key
from gcd_dataset.loaders.ranks import accelerate_is_active, current_rank, in_process_group, sharding_library
from gcd_dataset.loaders.splits import parse_splits
from gcd_dataset.records import Sample
from gcd_dataset.shards.codec import NO_PICTURE, read_meta
from gcd_dataset.shards.folder import FolderStore
from gcd_dataset.shards.foreign_member import decode_member
from gcd_dataset.shards.layout import FOREIGN, MEMBERS, Bytes, fields_of, key_of, members_of
from gcd_dataset.shards.npy import write_npy
from gcd_dataset.shards.reader import Quality, ShardReader, Verify, naming_sample
from gcd_dataset.shards.store import Store
from gcd_dataset.shards.tar import BLOCK, stream_samples

__all__ = ["GarmentDataset", "StreamedGarments"]

META = MEMBERS[0]
RECIPE = "recipe:"
SERVER = ("revision", "endpoint", "token", "max_cache_size", "patience")
"""Options of remote sources."""
LENGTHS = (DataLoader.__len__.__code__, ChainDataset.__len__.__code__)
EMPTY = {"npy": len(write_npy(np.zeros(0, np.float32))), "jpg": len(NO_PICTURE)}
"""File extension to the size of an empty member [bytes], stored for a stage not made; other members are larger."""


class GarmentDataset(Garments):
    """Garments by index, read from shards in a folder, at a URL, or in a repository of the Hugging Face Hub.

    >>> ds = GarmentDataset("garments", fields=("verts", "faces"))  # doctest: +SKIP
    >>> ds[0]["verts"].shape  # doctest: +SKIP
    torch.Size([14475, 3])
    >>> GarmentDataset("org/garments", "train[:10%]", fields=["points"], max_cache_size="20GB")  # doctest: +SKIP
    >>> GarmentDataset("recipe:standard-1k", "test")  # doctest: +SKIP

    Selection:

    - ``source``: a folder; a URL, ``http://…``, ``https://…``, ``file://…``, ``s3://BUCKET/PREFIX`` or any other that
      ``fsspec`` supports; a repository of the Hub, ``ORG/NAME``, ``hf://…`` or ``…@REVISION``; or the data set of a
      recipe, ``recipe:NAME`` or ``recipe:FILE.toml``, which is made on first use.
    - ``split``: ``train``, ``train[:10%]``, ``train[100:200]``, ``train+test``.
    - ``revision``: branch, tag or commit of a repository; resolved once, see the attribute ``revision``.
    - ``partial``: ``True`` opens a data set whose run was stopped, or is still running, without a warning.
    - ``settled_only``: only garments with a settled drape.
    - ``quality``: only garments of this grade or a better one: ``"clean"`` garments have no crossing edge and no panel
      that is too tight, ``"paper"`` garments are within the limits of GarmentCodeData; see ``generator.quality``.

    Items:

    - ``fields``: the fields to read, ``None`` for all that the garments hold (garments of stage ``pattern`` or ``mesh``
      lack some); other members are neither read nor downloaded.
    - ``dtype``: the type of floating fields, float32 by default; ``None`` for the stored types.
    - ``transform``: called with each item.
    - ``verify``: ``lazy`` checks a member's CRC-32 when a process reads it for the first time, ``full`` checks
      everything on opening, ``off`` nothing; remote data is checked in any case.
    - ``streaming``: an iterable data set instead, which reads shards sequentially with ``webdataset`` and splits the
      garments over ranks and workers; remote data is not cached.

    Remote data:

    - ``root``: download the split, or its selected fields, to this folder first, and read it there. A recipe's data set
      is made in the subfolder NAME of ``root``, by default in the cache.
    - ``download``: ``False`` sends no request and makes nothing: ``root`` or the cache must hold the data.
    - ``cache_dir``, ``max_cache_size``: the cache and its limit, such as ``"20GB"``; any number of processes may share
      a cache. By default ``~/.cache/gcd_dataset``, without limit.
    - ``patience``: seconds to wait for an unreachable or busy server before a read fails; by default 30, ``math.inf``
      for no limit.
    - ``endpoint``, ``token``: address and token of the Hub; by default from ``HF_ENDPOINT`` and ``hf auth login``.

    Foreign tars for ``webdataset`` are read too. Their fields are the extensions of their files, such as ``seg.png``;
    the last extension decides the decoding. A sample without such a file has ``None``.

    Raises ``ShardError`` for a missing split, or a damaged or newer source, ``RemoteError`` for a server that does not
    answer, and ``ConfigError`` for options that contradict each other and for a field that no garment of the split
    holds, such as ``verts`` of garments made up to stage ``mesh``.
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
        partial: bool = False,
        settled_only: bool = False,
        quality: Quality | None = None,
        dtype: torch.dtype | None = torch.float32,
    ) -> None:
        parts = parse_splits(split)
        fields = None if fields is None else [fields] if isinstance(fields, str) else list(fields)
        remote = Remote(revision, cache_dir, max_cache_size, endpoint, token, allowed=download, patience=patience)
        splits = tuple(dict.fromkeys(part.name for part in parts))
        if isinstance(source, str) and source.startswith(RECIPE):
            store: Store = FolderStore(_recipe_folder(source, remote, root, splits))
        else:
            store = open_store(source, remote, root=root, splits=splits, fields=fields)
        readers = {
            name: ShardReader(store, name, verify=verify, settled_only=settled_only, quality=quality) for name in splits
        }
        if not partial:
            store.warn_unfinished(splits)
        self._parts = [_Part(readers[part.name], part.range_of(len(readers[part.name]))) for part in parts]
        self._ends = list(accumulate(len(part.positions) for part in self._parts))
        self._member_of = _member_of([part.reader for part in self._parts])
        self._foreign = self._parts[0].reader.layout.kind == FOREIGN
        super().__init__(fields, transform, available=self._member_of, absent=self._absent_fields(), dtype=dtype)
        self._check_stream = verify != "off"
        self.source = store.source
        """The remote source with its revision; ``None`` for a folder that was not downloaded."""

    @property
    def revision(self) -> str | None:
        """The commit of the repository, or the hash of a URL's manifest."""
        return None if self.source is None else self.source.rpartition("@")[2]

    def __len__(self) -> int:
        return self._ends[-1]

    def _load(self, position: int) -> Any:
        part, row = self._locate(position)
        with part.reader.naming(row):
            return self._item(part.reader.read(row, self._member_names), position)

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """The items of a batch, in one request to a server; a ``DataLoader`` calls this."""
        requests: dict[ShardReader, list[int]] = {}
        locations = []
        for index in indices:
            part, position = self._locate(self._position(index))
            requests.setdefault(part.reader, []).append(position)
            locations.append((part.reader, position))
        replies = {reader: reader.read_many(positions, self._member_names) for reader, positions in requests.items()}
        items = []
        for index, (reader, position) in zip(indices, locations, strict=True):
            members = next(replies[reader])
            with note_items(self, index), reader.naming(position):
                items.append(self._item(members, self._position(index)))
        return items

    def sample(self, index: int | str) -> Sample:
        part, position = self._locate(self._position(index))
        return part.reader.sample(position)

    def recipe(self, index: int) -> dict[str, Any]:
        """Seed, index, options and versions of garment ``index``, and ``source`` if it is remote.

        Raises ``IndexError``, and ``ConfigError`` for a foreign sample, which has no recipe.
        """
        position = self._position(index)
        if self._foreign:
            raise ConfigError("samples of foreign archives have no recipe: ask the author of the archive")
        recipe = recipe_from_meta(self._members(position, (META,))[META])
        return recipe if self.source is None else {**recipe, "source": self.source}

    def identity(self) -> dict[str, Any]:
        """Identity of the data set, independent of its path: length, and recipe or foreign key of both ends."""
        if not self._foreign:
            return super().identity()
        return {"length": len(self), "ends": [self._key(self._position(index)) for index in (0, -1)]}

    def verify(self, index: int) -> None:
        """Raise ``ShardError`` with shard, key and member if the bytes of garment ``index`` are not those written."""
        part, position = self._locate(self._position(index))
        part.reader.check(position)

    def _description(self) -> list[str]:
        splits = dict.fromkeys(part.reader.split for part in self._parts)
        return [f"{' + '.join(splits)} of {self._parts[0].reader.store.location()}"]

    def _absent_fields(self) -> dict[str, str]:
        """Field to the reason for its absence, judged by the sizes in the index."""
        if self._foreign:
            return {}
        largest = {
            field: max(part.largest(member) for part in self._parts) for field, member in self._member_of.items()
        }
        return absent_when_empty(
            lambda field: largest[field] <= EMPTY[self._member_of[field].rpartition(".")[2]], self._member_of
        )

    def _find_key(self, key: str) -> int | None:
        number = index_from_key(key)
        if number is None and not self._foreign:
            return None
        found: dict[str, int] = {}
        for part, end in zip(self._parts, self._ends, strict=True):
            row = part.row_of_key(key) if number is None or self._foreign else part.row_of_number(number)
            if row is not None:
                found.setdefault(part.reader.split, end - len(part.positions) + row)
        if len(found) > 1:
            raise UnknownKeyError(f"garment {key} is in {' and in '.join(found)}: open one split, or give its index")
        return next(iter(found.values()), None)

    def _key(self, position: int) -> str:
        part, position = self._locate(position)
        return part.reader.index.key(int(part.reader.rows([position])[0]))

    @property
    def _member_names(self) -> tuple[str, ...]:
        if self._foreign:
            return self.fields
        return members_of(self.fields, self._member_of)

    def _locate(self, position: int) -> tuple["_Part", int]:
        """The part that holds a garment, and its position in the part's reader."""
        number = bisect.bisect_right(self._ends, position)
        part = self._parts[number]
        return part, part.positions[position - (self._ends[number] - len(part.positions))]

    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        part, position = self._locate(position)
        return part.reader.read(position, members)

    def _item(self, members: Mapping[str, Bytes], position: int) -> Any:
        if not self._foreign:
            return super()._item(members, position)
        values = {name: decode_member(name, members[name]) if name in members else None for name in self.fields}
        item = GarmentItem(
            (name, tensor_of(value, self.dtype) if isinstance(value, np.ndarray) else value)
            for name, value in values.items()
        )
        return self._transformed(item, position)


def _recipe_folder(source: str, remote: Remote, root: str | Path | None, splits: Sequence[str]) -> Path:
    """The folder of the data set of ``recipe:NAME`` or ``recipe:FILE.toml``; makes the data set if it is missing.

    The folder is ``root``/NAME, by default in the cache; no server is asked. Raises ``ConfigError`` for an unknown
    recipe or split, and for options of remote sources; ``ShardError`` for a missing data set with ``download=False``.
    """
    # Imported here: other sources do not need the generator.
    from gcd_dataset.generator.recipes import find_recipe
    from gcd_dataset.verbs.recipes import ensure_recipe
    from gcd_dataset.verbs.seal import is_sealed

    if given := [name for name in SERVER if getattr(remote, name) is not None]:
        raise ConfigError(f"{given[0]} is for URLs and the Hub, but {source} is made here: leave it out")
    recipe = find_recipe(source.removeprefix(RECIPE))
    for split in splits:
        if split not in recipe.splits:
            known = list(recipe.splits)
            raise ConfigError(
                f"{recipe.name} has no split {split}: there are {', '.join(known)}{did_you_mean(split, known)}"
            )
    base = remote.folder / "recipes" if root is None else user_path(root)
    folder = base / recipe.name
    if not remote.allowed and not is_sealed(folder, recipe):
        raise ShardError(f"{folder}: {recipe.name} is not there, and download=False: leave that out to make it")
    ensure_recipe(recipe, folder)
    return folder


class _Part(NamedTuple):
    """The samples of one part of ``split=``."""

    reader: ShardReader
    positions: range

    def largest(self, member: str) -> int:
        """Largest size of a member [bytes]."""
        index = self.reader.index
        size = index.table.size[self.reader.rows(self.positions), index.layout.members.index(member)]
        return int(size.max(initial=0))

    def row_of_number(self, number: int) -> int | None:
        """Row, within this part, of the sample with a number; ``None`` if there is none."""
        numbers = self.reader.index.table.sample[self.reader.rows(self.positions)]
        return next(iter(np.flatnonzero(numbers == number).tolist()), None)

    def row_of_key(self, key: str) -> int | None:
        """Row, within this part, of the sample with a key; ``None`` if there is none."""
        keys = map(self.reader.index.key, self.reader.rows(self.positions).tolist())
        return next((row for row, other in enumerate(keys) if other == key), None)


class _ShardRun(NamedTuple):
    """Samples of a part that lie in one shard, in the order of the file."""

    part: _Part
    shard: int
    rows: np.ndarray
    """Rows of the shard index."""
    indices: np.ndarray
    """Indices in the data set."""

    @property
    def name(self) -> str:
        """File name of the shard."""
        return self.part.reader.index.shards[self.shard]

    def within(self, first: int, count: int) -> "_ShardRun":
        """Samples ``first`` to ``first + count`` of this run; the range may extend beyond the run on both sides."""
        part = slice(max(first, 0), max(first + count, 0))
        return self._replace(rows=self.rows[part], indices=self.indices[part])

    def by_key(self) -> dict[str, list[int]]:
        """Key to indices in the data set; samples of a foreign archive may share a key."""
        indices: dict[str, list[int]] = {}
        for row, index in zip(self.rows.tolist(), self.indices.tolist(), strict=True):
            indices.setdefault(self.part.reader.index.key(row), []).append(index)
        return indices

    def begin(self) -> int:
        """Byte offset of the first sample in an archive of this package; a sample starts with ``meta.json``."""
        index = self.part.reader.index
        return int(index.table.offset[self.rows[0], index.layout.members.index(META)]) - BLOCK


def _member_of(readers: Iterable[ShardReader]) -> dict[str, str]:
    """Field to member, for members that all splits have. Raises ``ConfigError`` for splits of different kinds."""
    layouts = [reader.layout for reader in readers]
    if len({layout.kind for layout in layouts}) > 1:
        raise ConfigError(
            "samples of this package in one split and foreign ones in another: open them as two data sets"
        )
    shared = [member for member in layouts[0].members if all(member in layout.members for layout in layouts)]
    if layouts[0].kind == FOREIGN:
        return {member: member for member in shared}
    return fields_of(shared)


class StreamedGarments(GarmentDataset, IterableDataset):
    """The items in the order of the shards; each rank and worker reads one contiguous part.

    Every garment comes once. The parts of ranks differ by one garment at most. The workers of a ``DataLoader`` get
    whole batches, all but the last one: ``len(loader)`` is the number of batches on this rank, and ``drop_last`` leaves
    out less than one batch. A process reads a shard in a folder from the start of its part, and a shard on a server
    from the start of the shard.
    """

    _ranks: tuple[int, int] | None = None
    """Rank and world size of the process that spawned this worker."""

    def select(self, indices: Iterable[int]) -> Garments:
        raise ConfigError("a stream has no indices: leave out streaming=True, or slice the split")

    def __getitem__(self, index: Any) -> Any:
        raise ConfigError("a stream has no indices: leave out streaming=True")

    def __len__(self) -> int:
        # A DataLoader counts the batches of this rank; all others ask for the whole data set.
        return len(self._rank_share()) if sys._getframe(1).f_code in LENGTHS else super().__len__()

    def __iter__(self) -> Iterator[Any]:
        share = self._share()
        first, count = share.start, len(share)
        for run in self._shard_runs():
            part = run.within(first, count)
            if len(part.indices):
                yield from self._from_shard(part)
            first -= len(run.indices)

    def __getstate__(self) -> dict[str, Any]:
        # A spawned worker has no process group, and may lack the rank's environment variables.
        return {**self.__dict__, "_ranks": current_rank() if in_process_group() else self._ranks}

    def _share(self) -> range:
        """The garments of this process, counted in the order of the shards."""
        worker, share = get_worker_info(), self._rank_share()
        if worker is None:
            return share
        if len(share) < len(self) and accelerate_is_active():
            raise ConfigError(
                "streaming=True in workers with accelerate, which may split the garments too: give num_workers=0, or "
                "leave out streaming=True and load with a GarmentLoader"
            )
        size = _requested_batch()
        batches = -(-len(share) // size)
        begin, end = (edge * batches // worker.num_workers * size for edge in (worker.id, worker.id + 1))
        return share[begin:end]

    def _rank_share(self) -> range:
        """The garments of this rank, counted in the order of the shards."""
        rank, ranks = (0, 1) if sharding_library() else self._ranks or current_rank()
        return range(*(edge * len(self) // ranks for edge in (rank, rank + 1)))

    def _shard_runs(self) -> Iterator["_ShardRun"]:
        """All garments, shard by shard, in the order of the files."""
        for part, end in zip(self._parts, self._ends, strict=True):
            index, rows = part.reader.index, part.reader.rows(part.positions)
            for shard in np.unique(index.shard[rows]).tolist():
                in_shard = np.flatnonzero(index.shard[rows] == shard)
                in_shard = in_shard[np.argsort(rows[in_shard], kind="stable")]
                yield _ShardRun(part, shard, rows[in_shard], end - len(part.positions) + in_shard)

    def _from_shard(self, run: "_ShardRun") -> Iterator[Any]:
        """The items of a run."""
        reader = run.part.reader
        store, members, remaining = reader.store, self._streamed_members, run.by_key()
        shard, count = store.location(run.name), len(run.indices)
        begin = 0 if self._foreign else run.begin()
        samples = _foreign_samples if self._foreign else partial(_samples, wanted=members)
        for sample in samples(reader, run.name, begin=begin):
            if not (indices := remaining.get(sample["__key__"])):
                continue  # in another process's part, or written since the index was read
            if not self._foreign:
                if missing := sorted(members - sample.keys()):
                    raise ShardError(f"{shard}: sample {sample['__key__']} has no {missing[0]}: {store.remedy}")
                if self._check_stream:
                    _check(shard, sample, store.remedy)
            count -= 1
            with naming_sample(partial(_label, shard, sample)):
                item = self._item(sample, indices.pop(0))
            yield item
            if not count:
                return
        # tarfile takes a damaged header for the end of the archive.
        total = len(run.indices)
        raise ShardError(f"{shard}: {total - count} samples of {total} read: {store.remedy}")

    @property
    def _streamed_members(self) -> set[str]:
        """Members to extract; always ``meta.json``, which marks the start of a sample."""
        return {META, *self._member_names}


def _requested_batch() -> int:
    """Size of the batch that a ``DataLoader`` is reading from a stream in this thread; 1 for single items."""
    # torch tells a stream neither the batch size nor drop_last.
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        if frame.f_code is _IterableDatasetFetcher.fetch.__code__:
            return len(frame.f_locals["possibly_batched_index"] or [None])
        frame = frame.f_back
    return 1


def _samples(reader: ShardReader, shard: str, wanted: Container[str], begin: int) -> Iterator[Mapping[str, Any]]:
    """The samples of a shard of this package, from byte ``begin`` on if the stream can seek.

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
    """The samples of a foreign shard, read by ``webdataset``. Raises ``ShardError`` for a damaged archive."""
    from webdataset.tariterators import group_by_keys, tar_file_expander

    place = reader.store.location(shard)
    try:
        # Opened here: with WDS_SECURE=1 webdataset refuses to open files.
        with reader.store.stream(shard) as stream:
            yield from group_by_keys(tar_file_expander([{"url": place, "stream": stream}]))
    except (tarfile.TarError, ValueError) as error:  # ValueError: a duplicate name
        message = " ".join(str(error.args[0] if error.args else error).split())
        raise ShardError(f"{place}: a damaged archive ({message}): {reader.store.remedy}") from error


def _label(shard: str, sample: Mapping[str, Any]) -> str:
    return f"{shard}: sample {sample['__key__']}"


def _check(shard: str, sample: Mapping[str, Any], remedy: str) -> None:
    """Raise ``ShardError`` if a member's CRC-32 differs from the one in the sample's ``meta.json``."""
    try:
        meta = read_meta(sample[META])
    except ShardError as error:
        raise ShardError(f"{shard}: sample {sample['__key__']}, member {META}: {error}: {remedy}") from error
    if key_of(meta["index"]) != sample["__key__"]:
        raise ShardError(f"{shard}: sample {sample['__key__']} holds the number of {key_of(meta['index'])}: {remedy}")
    written = meta.get("crc32")
    if not isinstance(written, Mapping):
        raise ShardError(f"{shard}: sample {sample['__key__']}, member {META}: no checksums of its members: {remedy}")
    for member in sample.keys() - {META, "__key__", "__url__"}:
        if zlib.crc32(sample[member]) != written.get(member):
            raise ShardError(
                f"{shard}: sample {sample['__key__']}, member {member}: bytes differ from those written: {remedy}"
            )
