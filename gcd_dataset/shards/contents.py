"""The index of a folder, whoever wrote its archives."""

import logging
from pathlib import Path

from gcd_dataset.errors import ShardError
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.foreign import foreign_index, foreign_shards, scan_foreign
from gcd_dataset.shards.index import ShardIndex, known_index, layout_of_shard, scan_shard, tables_of
from gcd_dataset.shards.layout import FOREIGN, GARMENTS, Layout, foreign_layout, index_name, shards_in

__all__ = ["read_index", "rebuild_index", "splits_in"]

log = logging.getLogger(__name__)


def read_index(folder: Path | str, split: str = "train", layout: Layout = GARMENTS) -> ShardIndex:
    """The index of a split, brought up to date with the shards that are there; nothing is written.

    Its layout holds the members that are there: all of ``layout``'s, some in a folder where only some were downloaded,
    and others where ``webdataset``'s tars by another program are. Raises ``ShardError`` for a broken index or shard.
    """
    folder = Path(folder)
    known = known_index(folder, split, layout, partial=True)
    found = _layout_in(folder, split, layout) if known is None else known.layout
    if found.kind == FOREIGN:
        return _foreign(folder, split, known)
    return ShardIndex.of(folder, tables_of(folder, split, found, index=known), found)


def rebuild_index(folder: Path | str, split: str = "train", layout: Layout = GARMENTS) -> ShardIndex:
    """The index of a split, made anew from its shards and kept in the folder.

    Raises ``ShardError`` for a broken shard and ``OutputError`` where the folder cannot be written.
    """
    folder = Path(folder)
    found = _layout_in(folder, split, layout)
    if found.kind == FOREIGN:
        index = _scanned(folder, _foreign_paths(folder, split))
    else:
        with reading(folder):
            paths = shards_in(folder, split)
        index = ShardIndex.of(folder, {path.name: scan_shard(path, found) for path in paths}, found)
    index.write(folder / index_name(split))
    return index


def splits_in(folder: Path | str) -> tuple[str, ...]:
    """The splits of which a folder holds shards, by name. Raises ``ShardError``."""
    folder = Path(folder)
    with reading(folder):
        names = sorted(path.name for path in folder.iterdir() if path.name.endswith(".tar"))
    ours = {name.rpartition("-")[0] for name in names}
    ours = {split for split in ours if split and shards_in(folder, split)}
    rest = [name for name in names if name.rpartition("-")[0] not in ours]
    return tuple(sorted(ours | {split for split in ("train", "validation", "test") if foreign_shards(rest, split)}))


def _layout_in(folder: Path, split: str, layout: Layout) -> Layout:
    """The layout of the first shard of a split."""
    with reading(folder):
        shards = shards_in(folder, split)
    if not shards:
        return foreign_layout(()) if _foreign_paths(folder, split) and layout == GARMENTS else layout
    found = layout_of_shard(shards[0], layout)
    return found or (foreign_layout(()) if layout == GARMENTS else layout)


def _foreign_paths(folder: Path, split: str) -> list[Path]:
    with reading(folder):
        names = [path.name for path in folder.iterdir()]
    ours = {name.rpartition("-")[0] for name in names} - {split}
    known = {path.name for other in ours if other for path in shards_in(folder, other)}
    return [folder / name for name in foreign_shards(set(names) - known, split)]


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
