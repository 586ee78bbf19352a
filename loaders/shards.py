"""``GarmentDataset``: garments from shards, by index."""

import bisect
import contextlib
import logging
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any, NamedTuple, overload

import numpy as np
import torch

from gcd_dataset.errors import ConfigError, GcdError, ShardError, did_you_mean
from gcd_dataset.files import user_path
from gcd_dataset.hub.remote import Remote, RemoteStore, open_store
from gcd_dataset.loaders.base import (
    GarmentItem,
    Garments,
    Transform,
    UnknownKeyError,
    index_from_key,
    note_items,
    recipe_from_meta,
    require_integer,
    tensor_of,
)
from gcd_dataset.loaders.fields import STAGES, absent_at_stage, absent_when_empty
from gcd_dataset.records import Sample
from gcd_dataset.shards.cache import SIZE, size_in_bytes
from gcd_dataset.shards.codec import NO_PICTURE, SECTIONS, decode_field, decode_fields
from gcd_dataset.shards.columns import Columns, value_of
from gcd_dataset.shards.layout import (
    JOINT,
    META,
    MOTION,
    Bytes,
    fields_of,
    is_picture,
    is_view_field,
    joint_fields,
    member_of,
)
from gcd_dataset.shards.reader import Quality, ShardReader, Verify
from gcd_dataset.shards.store import FolderStore, Store

BOUND = r"-?[0-9]{1,18}%?"  # 18 digits fit an int64
PART = re.compile(rf"\s*(?P<name>\w[\w.-]*)\s*(?:\[\s*(?P<start>{BOUND})?\s*:\s*(?P<stop>{BOUND})?\s*\])?\s*")


@dataclass(frozen=True)
class SplitPart:
    """The samples ``start`` to ``stop`` of a split: integers or per cent, negative ones from the end."""

    name: str
    start: str | None = None
    stop: str | None = None

    def range_of(self, count: int) -> range:
        """Positions in a split of ``count`` samples. Adjacent parts neither overlap nor leave a gap."""
        return range(count)[_bound(self.start, count) : _bound(self.stop, count)]


def parse_splits(text: str) -> tuple[SplitPart, ...]:
    """The parts of a ``split=`` text. Raises ``ConfigError``."""
    matches = [PART.fullmatch(part) for part in text.split("+")] if isinstance(text, str) else [None]
    parts = tuple(SplitPart(match["name"], match["start"], match["stop"]) for match in matches if match)
    if len(parts) < len(matches):
        raise ConfigError(f"split={text!r:.99}: write train, train[:10%], train[100:200] or train+test")
    for bound in (bound for part in parts for bound in (part.start, part.stop) if bound and bound.endswith("%")):
        if abs(int(bound[:-1])) > 100:
            raise ConfigError(f"split={text!r}: {bound} is out of range: give -100% to 100%")
    return parts


def _bound(text: str | None, count: int) -> int | None:
    if text is None:
        return None
    return round(int(text[:-1]) / 100 * count) if text.endswith("%") else int(text)


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
            return decode_field(field, {member_of(name): content for name, content in members.items()})
        return value_of(field, self._views[field][row])

    def _tensor(self, field: str, value: Any) -> Any:
        if not isinstance(value, np.ndarray):
            return value
        try:
            return tensor_of(value.copy() if field in SECTIONS else value, self.dtype)
        except ShardError as error:
            raise ShardError(f"field {field}: {error}") from error


RECIPE = "recipe:"
SERVER = ("revision", "endpoint", "token", "patience")
"""Options of remote sources."""
WINDOW = 32  # shards of a server, or of a set larger than the cache, among which an order moves freely
GROWTH = 5  # columns of all fields take about five times as many bytes as the tars

log = logging.getLogger("gcd_dataset")


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
      everything on opening, ``off`` nothing; remote data, and shards from which columns are made, are checked in any
      case.
    - ``frames``: of garments in motion (``gcd generate --poses walk``), the number of consecutive frames of an item:
      there is an item for each window of so many frames, see ``MotionWindows``. Without it a garment is one item.
    - ``streaming``: an iterable data set instead, which reads shard after shard and splits the garments over ranks and
      workers; the shards of a remote set are fetched whole, to the cache.

    The cache:

    - ``cache_dir``, ``max_cache_size``: the folder of columns and of remote shards, by default ``$GCD_CACHE`` or
      ``~/.cache/gcd_dataset``, and its limit, by default ``"50 GB"``; ``None`` for no limit. Any number of processes
      may share a cache.
    - ``window``: number of shards among which a loader's random order moves freely, 0 for all; by default 32 for a
      server or a set larger than the cache, else all.

    Remote data:

    - ``root``: download the split, or its selected fields, to this folder first, and read it there. A recipe's data set
      is made in the subfolder NAME of ``root``, by default in the cache.
    - ``download``: ``False`` sends no request and makes nothing: ``root`` or the cache must hold the data.
    - ``patience``: seconds to wait for an unreachable or busy server before a read fails; by default 300, ``math.inf``
      for no limit.
    - ``endpoint``, ``token``: address and token of the Hub; by default from ``HF_ENDPOINT`` and ``hf auth login``.

    Raises ``ShardError`` for a missing split, or a damaged or newer source, ``RemoteError`` for a server that does not
    answer, ``OutputError`` for a cache or a ``root`` that cannot be written, and ``ConfigError`` for options that
    contradict each other and for a field that no garment of the split holds, such as ``verts`` of garments made up to
    stage ``mesh``.
    """

    reads_only = True

    def __new__(cls, *args: Any, streaming: bool = False, **options: Any) -> "GarmentDataset":
        if options.get("frames") is not None:
            from gcd_dataset.loaders.windows import MotionWindows

            return super().__new__(MotionWindows)
        if not streaming:
            return super().__new__(cls)
        from gcd_dataset.loaders.streamed import StreamedGarments

        return super().__new__(StreamedGarments)

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
        max_cache_size: int | str | None = SIZE,
        endpoint: str | None = None,
        token: str | None = None,
        patience: float | None = None,
        transform: Transform | None = None,
        verify: Verify = "lazy",
        partial: bool = False,
        settled_only: bool = False,
        quality: Quality | None = None,
        dtype: torch.dtype | None = torch.float32,
        window: int | None = None,
        frames: int | None = None,
    ) -> None:
        parts = parse_splits(split)
        fields = None if fields is None else [fields] if isinstance(fields, str) else list(fields)
        remote = Remote(revision, cache_dir, max_cache_size, endpoint, token, allowed=download, patience=patience)
        splits = tuple(dict.fromkeys(part.name for part in parts))
        if isinstance(source, str) and source.startswith(RECIPE):
            folder = _recipe_folder(source, remote, root, splits)
            store: Store = FolderStore(folder, cache_dir=cache_dir)
        else:
            store = open_store(source, remote, root=root, splits=splits)
        readers = {
            name: ShardReader(store, name, verify=verify, settled_only=settled_only, quality=quality) for name in splits
        }
        if not partial:
            store.warn_unfinished(splits)
        self._parts = [_SplitPart(readers[part.name], part.range_of(len(readers[part.name]))) for part in parts]
        self._ends = list(accumulate(len(part.positions) for part in self._parts))
        shared = [
            m for m in self._parts[0].reader.layout.members if all(m in r.layout.members for r in readers.values())
        ]
        super().__init__(
            fields,
            transform,
            available=self._available(shared),
            absent=_absent(self._parts, fields, is_remote=isinstance(store, RemoteStore)),
            dtype=dtype,
        )
        self.source = store.source
        """The remote source with its revision; ``None`` for a folder that was not downloaded."""
        limit = size_in_bytes(max_cache_size)
        single = dtype not in (None, torch.float64)
        stored = _stored_fields(self._read_fields, shared)
        self._columns = {name: Columns(reader, stored, limit=limit, single=single) for name, reader in readers.items()}
        self._is_remote, self._told = isinstance(store, RemoteStore), False
        self.window = self._window(window, limit)
        """Number of shards among which a random order moves freely; ``None``: all."""

    @property
    def revision(self) -> str | None:
        """The commit of the repository, or the hash of a URL's manifest."""
        return None if self.source is None else self.source.rpartition("@")[2]

    def _available(self, members: Sequence[str]) -> dict[str, str]:
        return fields_of(member for member in members if member != MOTION)

    @property
    def _read_fields(self) -> tuple[str, ...]:
        """The stored fields that an item is made of."""
        return self.fields

    def __len__(self) -> int:
        return self._ends[-1]

    def fetch_ahead(self, indices: Iterable[int]) -> None:
        """Bring the shards of some garments into the cache; an error is left to the read that needs them."""
        positions: dict[str, list[int]] = {}
        for part, position in map(self._locate, indices):
            positions.setdefault(part.reader.split, []).append(position)
        with contextlib.suppress(GcdError):
            for split, chosen in positions.items():
                self._columns[split].fetch(chosen)

    def shard_lengths(self) -> list[int]:
        """Number of garments in each shard, in order: they are read together."""
        lengths: list[int] = []
        for reader, positions in self._parts:
            shards = np.searchsorted(reader.index.first, reader.rows(positions), "right")
            lengths += np.diff(np.flatnonzero(np.diff(shards, prepend=-1, append=-1))).tolist()
        return lengths

    def _window(self, window: int | None, limit: int | None) -> int | None:
        """The window in shards: the given one, else ``WINDOW`` for a server or a set larger than the cache."""
        if window is not None:
            return require_integer("window", window, least=0) or None
        size = sum(shard.size for part in self._parts for shard in part.reader.record.shards)
        return WINDOW if self._is_remote or (limit is not None and GROWTH * size > limit) else None

    def _load(self, position: int, *, is_of_batch: bool = False) -> Any:
        """The item at a position, from columns; from the shard where none are made, but a batch makes them."""
        part, row = self._locate(position)
        columns = self._columns[part.reader.split]
        if columns.has(row) or (is_of_batch and self._fit(columns)):
            return self._transformed(self._stored(columns, [row])[0], position)
        with part.reader.naming(row):
            return self._item(part.reader.read(row, self._member_names), position)

    def __getitems__(self, indices: Sequence[int]) -> Any:
        """The items of a batch; a ``DataLoader`` calls this. Makes the columns of their shards."""
        positions = list(indices)
        if set(map(type, positions)) != {int} or min(positions) < 0 or max(positions) >= len(self):
            positions = [self._position(index) for index in indices]
        if not positions:
            return []
        number = bisect.bisect_right(self._ends, min(positions))
        part, end = self._parts[number], self._ends[number]
        columns = self._columns[part.reader.split]
        if max(positions) >= end or not self._fit(columns):  # of several splits, or too large for the cache
            alone = list[Any]()
            for index, position in zip(indices, positions, strict=True):
                with note_items(self, index):
                    alone.append(self._load(position, is_of_batch=True))
            return alone
        first = end - len(part.positions) - part.positions.start  # index of the reader's first garment
        items = self._stored(columns, np.array(positions) - first)
        if self.transform is None:
            return items
        return [self._transformed(item, position) for item, position in zip(items, positions, strict=True)]

    def _fit(self, columns: Columns) -> bool:
        """Whether columns serve: in windows always, else if those of the whole split fit into the cache."""
        fits = self.window is not None or columns.fit()
        if not fits and not self._told:
            self._told = True
            log.warning(
                "%s: its columns would exceed the cache, so every garment is decoded from its tar: give window=%d, or "
                "raise max_cache_size",
                self._parts[0].reader.store.location(),
                WINDOW,
            )
        return fits

    def _stored(self, columns: Columns, rows: Sequence[int] | np.ndarray) -> StoredItems:
        return StoredItems(self.fields, columns.views(rows), self.dtype, len(rows))

    def sample(self, index: int | str) -> Sample:
        part, position = self._locate(self._position(index))
        return part.reader.sample(position)

    def recipe(self, index: int) -> dict[str, Any]:
        """Seed, index, options and versions of garment ``index``, and ``source`` if it is remote.

        Raises ``IndexError``.
        """
        recipe = recipe_from_meta(self._members(self._position(index), (META,))[META])
        return recipe if self.source is None else {**recipe, "source": self.source}

    def identity(self) -> dict[str, Any]:
        """Identity of the data set, independent of its path: length, and the recipes of its first and last garment."""
        ends = []
        for position in (0, len(self) - 1):
            part, row = self._locate(position)
            plan = part.reader.record.plan
            ends.append({"seed": plan.seed, "index": part.reader.number(row), "recipe": dict(plan.recipe)})
        return {"length": len(self), "ends": ends}

    def verify(self, index: int) -> None:
        """Raise ``ShardError`` with shard, key and member if the bytes of garment ``index`` are not those written."""
        part, position = self._locate(self._position(index))
        part.reader.check(position)

    def _description(self) -> list[str]:
        splits = dict.fromkeys(part.reader.split for part in self._parts)
        return [f"{' + '.join(splits)} of {self._parts[0].reader.store.location()}"]

    def _find_key(self, key: str) -> int | None:
        number = index_from_key(key)
        if number is None:
            return None
        found: dict[str, int] = {}
        for (reader, positions), end in zip(self._parts, self._ends, strict=True):
            for row in np.flatnonzero(reader.index.number[reader.rows(positions)] == number).tolist():
                found.setdefault(reader.split, end - len(positions) + row)
        if len(found) > 1:
            raise UnknownKeyError(f"garment {key} is in {' and in '.join(found)}: open one split, or give its index")
        return next(iter(found.values()), None)

    def _key(self, position: int) -> str:
        part, position = self._locate(position)
        return part.reader.key(position)

    def _locate(self, position: int) -> tuple["_SplitPart", int]:
        """The part that holds a garment, and its position in the part's reader."""
        number = bisect.bisect_right(self._ends, position)
        part = self._parts[number]
        return part, part.positions[position - (self._ends[number] - len(part.positions))]

    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        part, position = self._locate(position)
        return part.reader.read(position, members)


class _SplitPart(NamedTuple):
    """The samples of one part of ``split=``."""

    reader: ShardReader
    positions: range


def _stored_fields(fields: Iterable[str], members: Sequence[str]) -> tuple[str, ...]:
    """The fields to read from columns; fields that join views are joined from those of each view."""
    joint, field_of = joint_fields(members), {member: field for field, member in fields_of(members).items()}
    singles = {field: tuple(field_of[member] for member in joint.get(field, ())) or (field,) for field in fields}
    return tuple(dict.fromkeys(single for field in fields for single in singles[field]))


def _absent(parts: Sequence[_SplitPart], fields: Sequence[str] | None, *, is_remote: bool) -> dict[str, str]:
    """Field to the reason why no garment has it: by the first settled garment, and of a server by the recipe.

    ``fields``: of these pictures alone are looked at, since their tars may be missing.
    """
    views = any(part.reader.index.has_views for part in parts)
    recipes = [part.reader.record.plan.recipe for part in parts]
    if is_remote and all(recipe.get("stage") in STAGES for recipe in recipes):
        stage = max((recipe["stage"] for recipe in recipes), key=STAGES.index)
        empty = [] if any(recipe.get("points", 1) for recipe in recipes) else ["points"]
        return absent_at_stage(stage, empty if views else [*empty, "front", "back"])
    part = next((part for part in parts if len(part.positions)), None)
    if part is None:
        return {}
    settled, first = part.reader.index.settled, part.positions[0]
    if settled.any():  # a garment that cannot be put on has no pictures
        first = next((position for position in part.positions if settled[part.reader.rows([position])[0]]), first)
    held = {
        field: member
        for field, member in fields_of(part.reader.layout.members).items()
        if not is_view_field(field) and member != MOTION
    }
    pictures = [field for field in held if is_picture(held[field])]
    stored = {field: held[field] for field in held if field not in pictures or fields is None or field in fields}
    members = part.reader.read(first, stored.values())
    with part.reader.naming(first):
        found = decode_fields(members, [field for field in stored if field not in pictures])
    missing = {field for field, value in found.items() if isinstance(value, np.ndarray) and not len(value)}
    missing |= {field for field in pictures if field in stored and len(members[stored[field]]) <= len(NO_PICTURE)}
    if any(part.reader.index.outcome.any() for part in parts):  # the first garment may be one without a drape
        missing.discard("verts")
    return absent_when_empty(missing.__contains__, stored)


def _recipe_folder(source: str, remote: Remote, root: str | Path | None, splits: Sequence[str]) -> Path:
    """The folder of the data set of ``recipe:NAME`` or ``recipe:FILE.toml``; makes the data set if it is missing.

    The folder is ``root``/NAME, by default in the cache; no server is asked. Raises ``ConfigError`` for an unknown
    recipe or split, and for options of remote sources; ``ShardError`` for a missing data set with ``download=False``.
    """
    # Imported here: other sources do not need the generator.
    from gcd_dataset.generator.recipes import find_recipe
    from gcd_dataset.making.recipes import ensure_recipe, is_made

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
    if not remote.allowed and not is_made(folder, recipe):
        raise ShardError(f"{folder}: {recipe.name} is not there, and download=False: leave that out to make it")
    ensure_recipe(recipe, folder)
    return folder
