"""Faults of the files of a data set: tar members without index, shards without manifest, garments without split."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from gcd_dataset.doctor import checks
from gcd_dataset.doctor.checks import Check
from gcd_dataset.errors import ShardError
from gcd_dataset.files import open_regular
from gcd_dataset.release.batches import PublishedBatches
from gcd_dataset.release.bodies import FOLDER
from gcd_dataset.release.garment_list import PublishedGarments
from gcd_dataset.release.published_names import DEFAULT_BODY
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.folder import FolderStore
from gcd_dataset.shards.index import index_name
from gcd_dataset.shards.layout import key_of
from gcd_dataset.shards.manifest import MANIFEST, ShardRecord
from gcd_dataset.shards.notes import shards_named
from gcd_dataset.shards.place import FolderPlace
from gcd_dataset.shards.tar import tar_entries

FileFault = tuple[Check, str, str]
"""A check, the file or key, and the fault in words."""
PEOPLE_FILES = ("measurements/{}.yaml", "meta/{}_meta.json", "meshes/{}_straight.obj", "meshes/{}_apart.obj")


def shard_file_faults(folder: Path, split: str) -> Iterator[FileFault]:
    """Faults of the shards of a split in a local folder, from tar headers. Raises ``ShardError`` for a broken index."""
    store, names = FolderStore(folder), FolderPlace(folder).names()
    record = store.manifest().splits[split]
    if MANIFEST not in names or index_name(split) not in names:
        yield checks.ORPHANS, index_name(split), "no manifest or index: run gcd index"
    listed = {shard.number for shard in record.shards}
    for name, number in shards_named(names):
        if name == split and number not in listed:
            path = ShardRecord(number, 0, 0, "").name(split)
            yield checks.ORPHANS, path, f"shards that {MANIFEST} does not list"
    missing = [shard.name(split) for shard in record.shards if shard.name(split) not in names]
    yield from ((checks.INCOMPLETE, name, f"shards of {MANIFEST} that are missing") for name in missing)
    if record.count and not missing:
        keys = set(map(key_of, store.index(split).number.tolist()))
        for shard in record.shards:
            yield from _member_faults(folder / shard.name(split), keys)
    if (problem := store.unfinished(split)) is not None:
        yield checks.INCOMPLETE, split, f"unfinished: {problem}"


def _member_faults(path: Path, keys: set[str]) -> Iterator[FileFault]:
    """Members of a shard whose samples the index does not list."""
    try:
        with reading(path), open_regular(path) as file:
            for entry in tar_entries(file.fileno()):
                if entry.name.partition(".")[0] not in keys:
                    yield checks.ORPHANS, f"{path.name}/{entry.name}", "members that the index does not list"
    except ShardError as error:
        yield checks.UNREADABLE, path.name, f"{error}"


def split_file_faults(folder: Path, splits: Sequence[str]) -> Iterator[FileFault]:
    """Tars of a local folder that belong to no split."""
    names = FolderPlace(folder).names()
    own = {ShardRecord(number, 0, 0, "").name(split) for split, number in shards_named(names) if split in splits}
    for name in sorted(names - own):
        if name.endswith(".tar") and "/" not in name:
            yield checks.ORPHANS, name, "tars of no split"


# ----------------------------------------------------------------------------------------------------------- published


def published_faults(
    batches: PublishedBatches, splits: Sequence[PublishedGarments], wearers: set[str] | None
) -> Iterator[FileFault]:
    """Faults of the files of a published data set.

    ``splits``: the splits that are examined; ``wearers``: names of the bodies of their garments; ``None``
    where not all garments were read: people are not examined.
    """
    listed = {str(entry) for split in splits for entry in split.entries}
    for (batch, folder), files in batches.files.items():
        fails = batches.properties[batch, folder].fails
        for name in files.names:
            place = f"{batch}/{folder}/{name}"
            if name in fails:
                yield checks.ORPHANS, place, "folders of failed garments, which are left out"
            elif place not in listed:
                yield checks.ORPHANS, place, "garments in no split"
    for split in splits:
        yield from (
            (checks.INCOMPLETE, place, "listed in the split, but neither on disk nor failed") for place in split.missing
        )
    if wearers is not None:
        yield from _people_faults(batches.root, wearers)


def _people_faults(root: Path, wearers: set[str]) -> Iterator[FileFault]:
    """People without a garment, and wearers without files, where the release's bodies are on disk."""
    folder = root / FOLDER
    with reading(root):
        if not folder.is_dir():
            return
        people = {path.stem for path in (folder / "measurements").glob("*.yaml")}
        files = {str(path.relative_to(folder)) for sub in ("meta", "meshes") for path in (folder / sub).glob("*")}
    worn = {name.removesuffix("_straight").removesuffix("_apart") for name in wearers} - {DEFAULT_BODY}
    yield from ((checks.ORPHANS, f"{FOLDER}/{name}", "bodies without a garment") for name in sorted(people - worn))
    for name in sorted(people & worn):
        if any(kind.format(name) not in files for kind in PEOPLE_FILES[1:]):
            yield checks.BODILESS, name, "a body without mesh or metadata"
    yield from ((checks.BODILESS, name, "a body that is not on disk") for name in sorted(worn - people))
