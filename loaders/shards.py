"""``GarmentDataset``: garments from shards, by index or as a stream."""

import bisect
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import numpy as np
import torch

from gcd_dataset.errors import ConfigError, ShardError, did_you_mean
from gcd_dataset.files import open_regular, user_path
from gcd_dataset.hub.remote import Remote, open_store
from gcd_dataset.loaders.available import absent_when_empty
from gcd_dataset.loaders.base import Garments, Transform, note_items, recipe_from_meta
from gcd_dataset.loaders.indexing import UnknownKeyError, index_from_key
from gcd_dataset.loaders.splits import parse_splits
from gcd_dataset.records import Sample
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.codec import NO_PICTURE, decode_field
from gcd_dataset.shards.folder import FolderStore
from gcd_dataset.shards.layout import FIELDS, MEMBERS, Bytes, fields_of, members_of
from gcd_dataset.shards.manifest import ShardRecord
from gcd_dataset.shards.reader import Quality, ShardReader, Verify
from gcd_dataset.shards.store import Store

if TYPE_CHECKING:
    from gcd_dataset.loaders.streamed import StreamedTar

__all__ = ["GarmentDataset"]

META = MEMBERS[0]
RECIPE = "recipe:"
SERVER = ("revision", "endpoint", "token", "max_cache_size", "patience")
"""Options of remote sources."""


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
      garments over ranks and workers.

    Remote data:

    - ``root``: download the split, or its selected fields, to this folder first, and read it there. A recipe's data set
      is made in the subfolder NAME of ``root``, by default in the cache.
    - ``download``: ``False`` sends no request and makes nothing: ``root`` or the cache must hold the data.
    - ``cache_dir``, ``max_cache_size``: the cache and its limit, such as ``"20GB"``; any number of processes may share
      a cache. By default ``~/.cache/gcd_dataset``, without limit.
    - ``patience``: seconds to wait for an unreachable or busy server before a read fails; by default 30, ``math.inf``
      for no limit.
    - ``endpoint``, ``token``: address and token of the Hub; by default from ``HF_ENDPOINT`` and ``hf auth login``.

    Raises ``ShardError`` for a missing split, or a damaged or newer source, ``RemoteError`` for a server that does not
    answer, and ``ConfigError`` for options that contradict each other and for a field that no garment of the split
    holds, such as ``verts`` of garments made up to stage ``mesh``.
    """

    reads_only = True

    def __new__(cls, *args: Any, streaming: bool = False, **options: Any) -> "GarmentDataset":
        if streaming:
            from gcd_dataset.loaders.streamed import StreamedGarments

            cls = StreamedGarments
        return super().__new__(cls)

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
            store = open_store(source, remote, root=root, splits=splits)
        readers = {
            name: ShardReader(store, name, verify=verify, settled_only=settled_only, quality=quality) for name in splits
        }
        if not partial:
            store.warn_unfinished(splits)
        self._parts = [_Part(readers[part.name], part.range_of(len(readers[part.name]))) for part in parts]
        self._ends = list(accumulate(len(part.positions) for part in self._parts))
        self._member_of = _member_of([part.reader for part in self._parts])
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

        Raises ``IndexError``.
        """
        recipe = recipe_from_meta(self._members(self._position(index), (META,))[META])
        return recipe if self.source is None else {**recipe, "source": self.source}

    def verify(self, index: int) -> None:
        """Raise ``ShardError`` with shard, key and member if the bytes of garment ``index`` are not those written."""
        part, position = self._locate(self._position(index))
        part.reader.check(position)

    def _description(self) -> list[str]:
        splits = dict.fromkeys(part.reader.split for part in self._parts)
        return [f"{' + '.join(splits)} of {self._parts[0].reader.store.location()}"]

    def _absent_fields(self) -> dict[str, str]:
        """Field to the reason for its absence, judged by the first garment."""
        part = self._parts[0]
        members = part.reader.read(part.positions[0], part.reader.layout.members)
        return absent_when_empty(
            lambda field: members[FIELDS[field]] == NO_PICTURE or not len(decode_field(field, members)),
            self._member_of,
        )

    def _find_key(self, key: str) -> int | None:
        number = index_from_key(key)
        if number is None:
            return None
        found: dict[str, int] = {}
        for part, end in zip(self._parts, self._ends, strict=True):
            row = part.row_of_number(number)
            if row is not None:
                found.setdefault(part.reader.split, end - len(part.positions) + row)
        if len(found) > 1:
            raise UnknownKeyError(f"garment {key} is in {' and in '.join(found)}: open one split, or give its index")
        return next(iter(found.values()), None)

    def _key(self, position: int) -> str:
        part, position = self._locate(position)
        return part.reader.key(position)

    @property
    def _member_names(self) -> tuple[str, ...]:
        return members_of(self.fields, self._member_of)

    def _tars(self) -> "Iterator[StreamedTar]":
        """The garments by shard, in order, to be streamed."""
        from gcd_dataset.loaders.streamed import StreamedTar

        for part in self._parts:
            reader, index = part.reader, part.reader.index
            rows = reader.rows(part.positions)
            for place in np.unique(index.shard[rows]).tolist():
                shard, own = reader.record.shards[place], rows[index.shard[rows] == place]

                def tar(views: bool, shard: ShardRecord = shard, own: np.ndarray = own) -> StreamedTar:
                    return StreamedTar(
                        reader.store.location(shard.name(reader.split, views=views)),
                        partial(_opened, reader.store, reader.split, shard, views),
                        index.number[own],
                        (index.views_start if views else index.start)[own],
                        remedy=reader.store.remedy,
                    )

                yield replace(tar(False), views=tar(True) if shard.views_size else None)

    def _locate(self, position: int) -> tuple["_Part", int]:
        """The part that holds a garment, and its position in the part's reader."""
        number = bisect.bisect_right(self._ends, position)
        part = self._parts[number]
        return part, part.positions[position - (self._ends[number] - len(part.positions))]

    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        part, position = self._locate(position)
        return part.reader.read(position, members)


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

    def row_of_number(self, number: int) -> int | None:
        """Row, within this part, of the sample with a number; ``None`` if there is none."""
        numbers = self.reader.index.number[self.reader.rows(self.positions)]
        return next(iter(np.flatnonzero(numbers == number).tolist()), None)


def _opened(store: Store, split: str, shard: ShardRecord, views: bool) -> BinaryIO:
    path = store.path(split, shard, views=views)
    with reading(path):
        return open_regular(path)


def _member_of(readers: Iterable[ShardReader]) -> dict[str, str]:
    """Field to member, for members that all splits have."""
    layouts = [reader.layout for reader in readers]
    return fields_of(member for member in layouts[0].members if all(member in layout.members for layout in layouts))
