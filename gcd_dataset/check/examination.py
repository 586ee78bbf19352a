"""Reads a data set as a training would, and reports what would stop or spoil it."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gcd_dataset.check import checks
from gcd_dataset.check.checks import Check, Harm
from gcd_dataset.check.files import published_faults, set_faults
from gcd_dataset.check.garments import FIELDS_READ, CheckedGarment, Fault, item_faults
from gcd_dataset.check.report import Report, SplitSummary, Tally
from gcd_dataset.check.sets import Census, SplitCensus, evenly_spaced
from gcd_dataset.errors import ConfigError, GcdError, RemoteError, ShardError
from gcd_dataset.filekinds import is_published
from gcd_dataset.files import user_path
from gcd_dataset.loaders import GarmentDataset, Hdf5Garments, PublishedGarmentCodeData
from gcd_dataset.loaders.base import Garments
from gcd_dataset.making.progress import Progress, ProgressCallback, ignore_progress
from gcd_dataset.release import PublishedBatches, PublishedGarments
from gcd_dataset.shards.layout import ARRAYS, BODIES, FAILED, MAPS, key_of, split_worn
from gcd_dataset.shards.store import FolderStore

QUICK = 200  # garments of each split that are read with ``quick``
BATCH = 16  # garments in one read, in parallel from a server
FEW_FAILED = 0.02  # share of failed drapes that a training bears
FEW_LEAKED = 0.01  # share of patterns known from another split that moves a score less than its confidence interval
HDF5 = (".h5", ".hdf5")
FILES = "files"
SPLITS = ("train", "validation", "test")
LEAKS = {"design": checks.LEAKED_DESIGN, "pattern": checks.LEAKED_PATTERN, "body": checks.LEAKED_BODY}


def examine(
    source: str | Path,
    *,
    quick: bool = False,
    every_byte: bool = False,
    recipe: str | Path | None = None,
    endpoint: str | None = None,
    cache_dir: str | Path | None = None,
    on_progress: ProgressCallback = ignore_progress,
) -> Report:
    """Examine a data set: shards in a folder, at a URL or on the Hub, an HDF5 file, or GarmentCodeData as published.

    Garments are read one after another; hashes of each are kept, to find designs, bodies and patterns of two splits.
    ``quick`` reads at most 200 garments of each split, evenly spaced; file names, tar headers and index are examined in
    full. Of a set of bodies the files alone are examined. ``every_byte`` compares the hashes of all shards and members,
    and ``recipe``, a name or a file, the samples with that recipe: both of a folder of shards. ``endpoint``: server of
    the Hub. ``cache_dir``: folder for data from a server, by default ``~/.cache/gcd_dataset``, and for unpacked
    published archives, by default beside them.

    >>> from gcd_dataset.check import examine
    >>> [finding.check.name for finding in examine("shards").harmful]  # doctest: +SKIP
    ['leaked-design', 'nan']

    Raises ``ShardError`` for a source without garments or that cannot be opened, ``ConfigError`` for a data set of
    another program, an unknown recipe, and options that the source does not take.
    """
    begun = time.perf_counter()
    of_folder = every_byte or recipe is not None
    opened = None if of_folder and _is_remote(str(source)) else _opened(source, endpoint, cache_dir)
    if opened is None or (of_folder and opened.folder is None):
        remedy = f"run gcd download {source} first, then give the folder" if opened is None else "leave them out"
        raise ConfigError(f"{source}: bytes and recipe are checked in a folder of shards: {remedy}")
    told = {split.problem for split in opened.splits}
    found = () if opened.folder is None else set_faults(opened.folder, every_byte=every_byte)
    faults = [fault for fault in found if fault not in told]
    if opened.folder is not None and recipe is not None:
        from gcd_dataset.check.recipes import recipe_faults
        from gcd_dataset.generator.recipes import find_recipe

        faults += recipe_faults(opened.folder, find_recipe(recipe))
    report = _Examination(opened, quick, on_progress).report()
    return replace(report, faults=tuple(faults), seconds=time.perf_counter() - begun)


@dataclass(frozen=True)
class _Split:
    """The garments of one split."""

    name: str
    garments: Garments | None
    """``None`` if the split cannot be opened."""
    problem: str = ""
    name_of: Callable[[int], str] | None = None
    """Position to the garment's name; ``None``: keys."""

    def key(self, position: int) -> str:
        """The name of a garment, for examples."""
        if self.name_of is not None:
            return self.name_of(position)
        assert self.garments is not None
        try:
            return key_of(int(self.garments.recipe(position)["index"]))
        except GcdError:
            return f"number {position}"


@dataclass(frozen=True)
class _Examined:
    name: str
    splits: tuple[_Split, ...]
    folder: Path | None = None
    """The folder of shards on this machine; ``None`` for others."""
    published: PublishedBatches | None = None
    garment_lists: tuple[PublishedGarments, ...] = ()


def _opened(source: str | Path, endpoint: str | None, cache_dir: str | Path | None) -> _Examined:
    path = user_path(source) if "://" not in str(source) else None
    if path is not None and path.suffix in HDF5 and path.is_file():
        split, known = Hdf5Garments(path, ("meta",)).split, Hdf5Garments(path).fields
        return _Examined(str(path), (_Split(split, Hdf5Garments(path, _examined(known), dtype=None)),))
    if path is not None and path.is_dir() and is_published(path):
        return _published(path, cache_dir)
    return _shards(str(source), endpoint, cache_dir)


def _is_remote(source: str) -> bool:
    from gcd_dataset.hub.source import Folder, parse_source

    try:
        return not isinstance(parse_source(source), Folder)
    except ConfigError:  # ``_opened`` tells what is wrong
        return False


def _shards(source: str, endpoint: str | None, cache_dir: str | Path | None) -> _Examined:
    from gcd_dataset.hub.remote import Remote, open_store
    from gcd_dataset.hub.source import Folder, Repo, parse_source

    try:
        parsed = parse_source(source)
    except ConfigError as error:  # a missing folder is bad input, not wrong usage
        raise ShardError(str(error)) from error
    options: dict[str, Any] = {} if isinstance(parsed, Folder) else {"cache_dir": cache_dir}
    if isinstance(parsed, Repo):
        options["endpoint"] = endpoint
    store = open_store(source, Remote(**options))
    options["partial"] = True  # an unfinished run is among the findings
    folder = store.folder if isinstance(store, FolderStore) else None
    manifest = store.manifest()
    if any(record.plan.kind == BODIES.kind for record in manifest.splits.values()):
        if folder is None:
            raise ConfigError(f"{source}: a data set of bodies: run gcd download {source} first, then give the folder")
        return _Examined(store.location(), (), folder)
    made = {name for name, record in manifest.splits.items() if record.count}
    # In this order: each garment is compared with those of the splits before.
    names = [*(name for name in SPLITS if name in made), *sorted(made - {*SPLITS})]
    splits = tuple(_shard_split(source, name, options) for name in names)
    return _Examined(store.location(), splits, folder)


def _shard_split(source: str, split: str, options: Mapping[str, Any]) -> _Split:
    try:
        known = GarmentDataset(source, split, **options)
        garments = GarmentDataset(source, split, _examined(known.fields), dtype=None, **options)
        return _Split(split, garments, name_of=garments._key)
    except RemoteError:
        raise
    except ShardError as error:
        return _Split(split, None, str(error))


def _published(path: Path, cache_dir: str | Path | None) -> _Examined:
    batches = PublishedBatches(path, cache_dir=cache_dir)
    names = SPLITS if batches.split_file is not None else ("all",)
    lists = tuple(PublishedGarments(batches, name) for name in names)
    splits = []
    for garments in lists:
        if len(garments):
            data = PublishedGarmentCodeData(batches, garments.split, fields=_examined(None), dtype=None)
            splits.append(_Split(garments.split, data, name_of=data.name))
    if not splits:
        lists[0].require_any()
    return _Examined(str(path), tuple(splits), published=batches, garment_lists=lists)


def _examined(known: Sequence[str] | None) -> tuple[str, ...]:
    """The fields to read, maps for their length. Published garments have no shape weights; points are sampled."""
    if known is None:
        return tuple(name for name in FIELDS_READ if name not in ("body", "points"))
    return tuple(name for name in known if split_worn(name)[1] in (*FIELDS_READ, *ARRAYS[MAPS]))


class _Examination:
    """Reads every garment once, then compares them."""

    def __init__(self, source: _Examined, quick: bool, on_progress: ProgressCallback) -> None:
        self.source, self.quick, self._on_progress = source, quick, on_progress
        self.tally, self.census = Tally(), Census()
        self.harms: dict[tuple[Check, str], Harm] = {}
        self.wearers: set[str] = set()

    def report(self) -> Report:
        """Run all checks."""
        for split in self.source.splits:
            self._read(split)
        self._compare_splits()
        for name, census in self.census.splits.items():
            self._summarise(name, census)
        if self.source.published is not None:
            wearers = None if self.quick else self.wearers
            for check, name, text in published_faults(self.source.published, self.source.garment_lists, wearers):
                self.tally.add(check, FILES, name, [text])
        totals = {name: len(census) for name, census in self.census.splits.items()}
        summaries = tuple(self._summary(split) for split in self.source.splits)
        return Report(self.source.name, summaries, self.tally.findings(totals, self.harms))

    def _read(self, split: _Split) -> None:
        census = self.census.splits[split.name] = SplitCensus()
        if split.garments is None:
            self.tally.add(checks.UNREADABLE, split.name, "", [split.problem])
            return
        count = len(split.garments)
        positions = evenly_spaced(count, QUICK) if self.quick else range(count)
        progress = Progress(len(positions), 0, split=split.name)
        self._on_progress(progress)
        for position, item in _items(split.garments, positions):
            progress = progress.with_made()
            self._on_progress(progress)
            if isinstance(item, GcdError):
                self.tally.add(checks.UNREADABLE, split.name, split.key(position), [str(item)])
                continue
            garment = CheckedGarment.joined(item)
            census.add(position, garment)
            self.wearers.add(str(garment.meta.get("body") or ""))
            self._count(split, position, item_faults(item))

    def _count(self, split: _Split, position: int, faults: Iterator[Fault]) -> None:
        found: dict[Check, list[str]] = {}
        for check, text in faults:
            found.setdefault(check, []).append(text)
        if split.name == FAILED:  # its garments are not trained on, and may have any shape
            found = {check: texts for check, texts in found.items() if check is checks.REFERENCES}
        for check, texts in found.items():
            key = split.key(position) if self.tally.wants_example(check, split.name) else ""
            self.tally.add(check, split.name, key, list(dict.fromkeys(texts)))

    def _compare_splits(self) -> None:
        """Designs, patterns and bodies that splits share, and shares that differ."""
        for name, check in LEAKS.items():
            for first, second, rows in self.census.shared(name):
                for row in rows.tolist():
                    key = self._key(second, row) if self.tally.wants_example(check, second) else ""
                    self.tally.add(check, second, key, [f"also in {first}"])
                if name == "body" and self.source.published is not None:
                    # The official split is by design; its random bodies are drawn from the same 5,000 people.
                    self.harms[check, second] = Harm.WARNING
        for name, census in self.census.splits.items():
            if self.tally.count(checks.LEAKED_PATTERN, name) <= FEW_LEAKED * len(census):
                self.harms[checks.LEAKED_PATTERN, name] = Harm.WARNING
        for split, text in self.census.unlike():
            self.tally.add(checks.SKEWED, split, "", [text])

    def _summarise(self, split: str, census: SplitCensus) -> None:
        """Faults that show in counts: arrays that some garments lack, failed drapes, one kind for all."""
        count = len(census)
        for names, lacking, first in census.lacking():
            self.tally.add(checks.MISSING, split, self._split(split).key(first), [", ".join(names)], lacking)
        garments = self._split(split).garments
        absent = [name for name in FIELDS_READ if garments is not None and name not in garments.fields]
        if count and absent and self.source.published is None:
            self.tally.add(checks.FEW_FIELDS, split, "", [", ".join(absent)], len(absent))
        for text in census.dominant():
            self.tally.add(checks.SKEWED, split, "", [text])
        if self.tally.count(checks.FAILED_DRAPE, split) <= FEW_FAILED * count:
            self.harms[checks.FAILED_DRAPE, split] = Harm.WARNING

    def _summary(self, split: _Split) -> SplitSummary:
        census = self.census.splits[split.name]
        shares = {name: dict(amounts.most_common()) for name, amounts in census.shares.items() if amounts}
        whole = 0 if split.garments is None else len(split.garments)
        return SplitSummary(split.name, whole, len(census), shares, census.medians())

    def _split(self, name: str) -> _Split:
        return next(split for split in self.source.splits if split.name == name)

    def _key(self, split: str, row: int) -> str:
        return self._split(split).key(self.census.splits[split].position[row])


def _items(garments: Garments, positions: Sequence[int]) -> Iterator[tuple[int, Mapping[str, Any] | GcdError]]:
    """Position and item, or the error for a damaged one. Raises ``RemoteError`` for a server that fails."""
    for first in range(0, len(positions), BATCH):
        batch = list(positions[first : first + BATCH])
        try:
            items: list[Mapping[str, Any] | GcdError] = list(garments[batch])
        except RemoteError:
            raise
        except GcdError:
            items = [_item(garments, position) for position in batch]
        yield from zip(batch, items, strict=True)


def _item(garments: Garments, position: int) -> Mapping[str, Any] | GcdError:
    try:
        item: Mapping[str, Any] = garments[position]
    except RemoteError:
        raise
    except GcdError as error:
        return error
    return item
