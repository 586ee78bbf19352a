"""The index of a folder, whoever wrote its archives."""

import logging
from pathlib import Path

from gcd_dataset.errors import ShardError
from gcd_dataset.files import user_path
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.foreign import SPLITS, foreign_index, foreign_shards, scan_foreign
from gcd_dataset.shards.index import ShardIndex, first_sample, known_index, sizes_in, tables_of
from gcd_dataset.shards.job_parts import require_merged
from gcd_dataset.shards.layout import (
    BODIES,
    FOREIGN,
    GARMENTS,
    SCHEMA,
    WAITING,
    Layout,
    foreign_layout,
    index_name,
    layout_of,
    shards_in,
)
from gcd_dataset.shards.manifest import MANIFEST, read_manifest

__all__ = ["layout_in", "read_index", "rebuild_index", "remedy", "require_splits", "splits_in"]

log = logging.getLogger(__name__)


def read_index(folder: Path | str, split: str = "train", layout: Layout = GARMENTS) -> ShardIndex:
    """The index of a split, brought up to date with the shards that are there; nothing is written.

    Its layout holds the members that are there: all of ``layout``'s, some in a folder where only some were downloaded,
    and others where ``webdataset``'s tars by another program are. Raises ``ShardError`` for a broken index or shard.
    """
    folder = user_path(folder)
    known = known_index(folder, split, layout, partial=True)
    found = _layout_in(folder, split, layout) if known is None else known.layout
    if found.kind == FOREIGN:
        return _foreign(folder, split, known)
    return _ours(folder, split, found, known)


def rebuild_index(folder: Path | str, split: str = "train", layout: Layout = GARMENTS) -> ShardIndex:
    """The index of a split, made anew from its shards and kept in the folder.

    Raises ``ShardError`` for a broken shard and ``OutputError`` where the folder cannot be written.
    """
    folder = user_path(folder)
    found = _layout_in(folder, split, layout)
    if found.kind == FOREIGN:
        index = _scanned(folder, _foreign_paths(folder, split))
    else:
        index = _ours(folder, split, found, ShardIndex.of(folder, {}, found))
    index.write(folder / index_name(split))
    return index


def splits_in(folder: Path | str) -> tuple[str, ...]:
    """The splits of which a folder holds shards, by name. Raises ``ShardError``."""
    folder = user_path(folder)
    ours, rest = _by_maker(folder)
    return tuple(sorted(ours | {split for split in SPLITS if foreign_shards(rest, split)}))


def require_splits(folder: Path | str) -> tuple[str, ...]:
    """As ``splits_in``. Raises ``ShardError`` for a folder without any shards, or whose parts are not merged."""
    require_merged(Path(folder))
    splits = splits_in(folder)
    if not splits:
        raise ShardError(f"{folder}: no shards: {remedy(Path(folder))}")
    return splits


def remedy(folder: Path) -> str:
    """What to do about a folder without shards."""
    from gcd_dataset.release.batch_index import is_published  # which stands on this package, and is seldom needed

    if is_published(folder):
        return (
            "this is GarmentCodeData as published: read it with PublishedGarmentCodeData, or make shards of it with "
            "gcd convert"
        )
    if waiting := len(list((folder / WAITING).glob("*/*.tar"))):
        return f"{waiting} samples wait for the rest of their shard: GeneratedGarments.pack() writes what is there"
    return "give a folder that gcd generate has made"


def layout_in(folder: Path | str, split: str) -> Layout:
    """``BODIES`` for a set of bodies, else ``GARMENTS``. Raises ``ShardError``."""
    with reading(Path(folder)):
        shards = shards_in(Path(folder), split)
    first = first_sample(shards[0]) if shards else None
    return BODIES if first is not None and first[1] == BODIES.members else GARMENTS


def _by_maker(folder: Path) -> tuple[set[str], list[str]]:
    """Our splits, and the names of foreign archives. Raises ``ShardError``."""
    with reading(folder):
        names = sorted(path.name for path in folder.iterdir() if path.name.endswith(".tar"))
    begun = {name.rpartition("-")[0] for name in names} - {""}
    whole = {split: shards for split in begun if (shards := shards_in(folder, split))}
    ours = {split for split, shards in whole.items() if first_sample(shards[0]) is not None}
    known = {path.name for split in ours for path in whole[split]}
    return ours, [name for name in names if name not in known]


def _layout_in(folder: Path, split: str, layout: Layout) -> Layout:
    """The layout of the first shard of a split."""
    with reading(folder):
        shards = shards_in(folder, split)
    first = first_sample(shards[0]) if shards else None
    if first is None and layout == GARMENTS and _foreign_paths(folder, split):
        return foreign_layout(())
    schema, members = first or (SCHEMA, ())
    return layout_of(layout, schema, members) or layout


def _ours(folder: Path, split: str, layout: Layout, known: ShardIndex | None) -> ShardIndex:
    """The index of our shards: what ``known`` does not tell is read, and again where a writer was at work meanwhile."""
    while True:
        before = sizes_in(folder, split)
        index = ShardIndex.of(folder, tables_of(folder, split, layout, index=known), layout)
        if dict(zip(index.shards, index.length.tolist(), strict=True)) == before:
            _require_listed(folder, split, index)
            return index


def _require_listed(folder: Path, split: str, index: ShardIndex) -> None:
    """Raise ``ShardError`` for a shard of fewer samples than the manifest lists: a cut archive may look whole."""
    manifest = read_manifest(folder)
    record = None if manifest is None else manifest.splits.get(split)
    counts = {name: len(table) for name, table in index.tables().items()}
    for shard in record.shards if record is not None else ():
        if counts.get(shard.name, shard.count) < shard.count:
            told = f"{counts[shard.name]} samples of the {shard.count} that {MANIFEST} lists"
            raise ShardError(f"{folder / shard.name}: {told}: copy it again, or delete it and run gcd generate again")


def _foreign_paths(folder: Path, split: str) -> list[Path]:
    return [folder / name for name in foreign_shards(_by_maker(folder)[1], split)]


def _foreign(folder: Path, split: str, known: ShardIndex | None) -> ShardIndex:
    """The index of foreign archives: the one kept if they are as long as it says, else made anew."""
    paths = _foreign_paths(folder, split)
    with reading(folder):
        lengths = [path.stat().st_size for path in paths]
    if known is not None and (list(known.shards), known.length.tolist()) == ([path.name for path in paths], lengths):
        return known
    log.info("%s: no index of split %s: all of it is read; gcd index keeps what is found", folder, split)
    return _scanned(folder, paths)


def _scanned(folder: Path, paths: list[Path]) -> ShardIndex:
    with reading(folder):
        lengths = [path.stat().st_size for path in paths]
    index = foreign_index({path.name: scan_foreign(path) for path in paths}, lengths)
    if not len(index):
        raise ShardError(f"{folder}: no sample in {', '.join(path.name for path in paths)}: give archives of samples")
    return index
