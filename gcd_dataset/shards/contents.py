"""The index and the splits of a folder with our shards, or with tars by other programs."""

import logging
import re
from pathlib import Path

from gcd_dataset.errors import ShardError, shown
from gcd_dataset.files import user_path
from gcd_dataset.shards.access import REMEDY, reading
from gcd_dataset.shards.download_file import DOWNLOAD_FILE
from gcd_dataset.shards.foreign import SPLITS, foreign_index, foreign_shards, scan_foreign
from gcd_dataset.shards.index import ShardIndex, first_sample_format, read_stored_index, read_tables, shard_sizes
from gcd_dataset.shards.job_parts import PARTS, require_merged
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
from gcd_dataset.shards.published import is_published

__all__ = [
    "layout_in",
    "no_shards_remedy",
    "read_index",
    "rebuild_index",
    "require_splits",
    "splits_in",
    "warn_of_others",
]

OWN = re.compile(r"\..*|rejects\.jsonl|(?:index|mesh)-.+\.npz|\w+-\d{5,}\.tar(?:\.part)?")
"""Files that a killed run may leave in a folder without a manifest; with one, the data set is continued."""
NAMED = 3  # files named in a message

log = logging.getLogger(__name__)


def read_index(folder: Path | str, split: str = "train", layout: Layout = GARMENTS) -> ShardIndex:
    """The index of a split, brought up to date with the shards in the folder; nothing is written.

    Its layout lists the members present: all of ``layout``; fewer after a download of some fields; any members in tars
    that another program wrote for ``webdataset``. Raises ``ShardError`` for a broken index or shard.
    """
    folder = user_path(folder)
    stored = read_stored_index(folder, split, layout, partial=True)
    found = _first_layout(folder, split, layout) if stored is None else stored.layout
    if found.kind == FOREIGN:
        return _foreign_index(folder, split, stored)
    return _own_index(folder, split, found, stored)


def rebuild_index(folder: Path | str, split: str = "train", layout: Layout = GARMENTS) -> ShardIndex:
    """The index of a split, made from its shards and written to the folder.

    Raises ``ShardError`` for a broken shard and ``OutputError`` where the folder cannot be written.
    """
    folder = user_path(folder)
    found = _first_layout(folder, split, layout)
    if found.kind == FOREIGN:
        index = _scan_archives(folder, _foreign_paths(folder, split))
    else:
        index = _own_index(folder, split, found, ShardIndex.of(folder, {}, found))
    index.write(folder / index_name(split))
    return index


def splits_in(folder: Path | str) -> tuple[str, ...]:
    """The splits that have shards in a folder, sorted. Raises ``ShardError``."""
    folder = user_path(folder)
    own, foreign = _own_and_foreign(folder)
    return tuple(sorted(own | {split for split in SPLITS if foreign_shards(foreign, split)}))


def require_splits(folder: Path | str) -> tuple[str, ...]:
    """As ``splits_in``. Raises ``ShardError`` for a folder without shards, or with parts that are not merged."""
    require_merged(Path(folder))
    splits = splits_in(folder)
    if not splits:
        raise ShardError(f"{folder}: no shards: {no_shards_remedy(Path(folder))}")
    return splits


def warn_of_others(folder: Path) -> None:
    """Log a warning before a new data set is written into a folder with other files. Raises ``ShardError``."""
    with reading(folder):
        names = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
    others = [shown(name) for name in names if not OWN.fullmatch(name)]
    if others and not {MANIFEST, DOWNLOAD_FILE, PARTS}.intersection(names):
        named = ", ".join(others[:NAMED]) + (f" and {len(others) - NAMED} more" if len(others) > NAMED else "")
        log.warning("%s: holds other files (%s), which stay beside the data set: right folder?", folder, named)


def no_shards_remedy(folder: Path) -> str:
    """The remedy in the message about a folder without shards."""
    if is_published(folder):
        return (
            "this is GarmentCodeData as published: read it with PublishedGarmentCodeData, or make shards of it with "
            "gcd convert"
        )
    if waiting := len(list((folder / WAITING).glob("*/*.tar"))):
        return f"{waiting} samples wait for the rest of their shard: GeneratedGarments.pack() writes them now"
    return "give a folder made by gcd generate"


def layout_in(folder: Path | str, split: str) -> Layout:
    """The layout of a split: ``BODIES`` or ``GARMENTS``. Raises ``ShardError``."""
    with reading(Path(folder)):
        shards = shards_in(Path(folder), split)
    first = first_sample_format(shards[0]) if shards else None
    return BODIES if first is not None and first[1] == BODIES.members else GARMENTS


def _own_and_foreign(folder: Path) -> tuple[set[str], list[str]]:
    """Splits written by this package, and the names of foreign archives. Raises ``ShardError``."""
    with reading(folder):
        names = sorted(path.name for path in folder.iterdir() if path.name.endswith(".tar"))
    prefixes = {name.rpartition("-")[0] for name in names} - {""}
    splits = {split: shards for split in prefixes if (shards := shards_in(folder, split))}
    own = {split for split, shards in splits.items() if first_sample_format(shards[0]) is not None}
    own_names = {path.name for split in own for path in splits[split]}
    return own, [name for name in names if name not in own_names]


def _first_layout(folder: Path, split: str, layout: Layout) -> Layout:
    """The layout of the first shard of a split; ``layout`` for a split without shards or of an unknown schema."""
    with reading(folder):
        shards = shards_in(folder, split)
    first = first_sample_format(shards[0]) if shards else None
    if first is None and layout == GARMENTS and _foreign_paths(folder, split):
        return foreign_layout(())
    schema, members = first or (SCHEMA, ())
    return layout_of(layout, schema, members) or layout


def _own_index(folder: Path, split: str, layout: Layout, stored: ShardIndex | None) -> ShardIndex:
    """The index of our shards. Scans shards missing in ``stored``; repeats if a writer has changed any meanwhile."""
    while True:
        before = shard_sizes(folder, split)
        index = ShardIndex.of(folder, read_tables(folder, split, layout, index=stored), layout)
        if dict(zip(index.shards, index.length.tolist(), strict=True)) == before:
            _require_listed(folder, split, index)
            return index


def _require_listed(folder: Path, split: str, index: ShardIndex) -> None:
    """Raise ``ShardError`` for a shard with fewer samples than the manifest lists: a truncated tar may look whole."""
    manifest = read_manifest(folder)
    record = None if manifest is None else manifest.splits.get(split)
    counts = {name: len(table) for name, table in index.tables().items()}
    for shard in record.shards if record is not None else ():
        if counts.get(shard.name, shard.count) < shard.count:
            found = f"{counts[shard.name]} samples of the {shard.count} that {MANIFEST} lists"
            raise ShardError(f"{folder / shard.name}: {found}: {REMEDY}")


def _foreign_paths(folder: Path, split: str) -> list[Path]:
    return [folder / name for name in foreign_shards(_own_and_foreign(folder)[1], split)]


def _foreign_index(folder: Path, split: str, stored: ShardIndex | None) -> ShardIndex:
    """The index of foreign archives: ``stored`` if names and lengths still match, else made by a scan."""
    paths = _foreign_paths(folder, split)
    with reading(folder):
        lengths = [path.stat().st_size for path in paths]
    if stored is not None and (list(stored.shards), stored.length.tolist()) == ([path.name for path in paths], lengths):
        return stored
    log.info("%s: no index of split %s: scanning all its tars; gcd index writes the index", folder, split)
    return _scan_archives(folder, paths)


def _scan_archives(folder: Path, paths: list[Path]) -> ShardIndex:
    with reading(folder):
        lengths = [path.stat().st_size for path in paths]
    index = foreign_index({path.name: scan_foreign(path) for path in paths}, lengths)
    if not len(index):
        raise ShardError(f"{folder}: no sample in {', '.join(path.name for path in paths)}: give archives of samples")
    return index
