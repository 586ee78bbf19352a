"""Faults of the files of a data set: tar members without index, shards without manifest, garments without split."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from gcd_dataset.doctor import checks
from gcd_dataset.doctor.checks import Check
from gcd_dataset.errors import ShardError
from gcd_dataset.files import open_regular
from gcd_dataset.release.batch_index import PublishedBatches
from gcd_dataset.release.body_folder import FOLDER
from gcd_dataset.release.garment_list import PublishedGarments
from gcd_dataset.release.published_names import DEFAULT_BODY
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.index import read_stored_index
from gcd_dataset.shards.layout import GARMENTS, WAITING, index_name, shards_in
from gcd_dataset.shards.manifest import MANIFEST, read_manifest
from gcd_dataset.shards.tar import TarMember, tar_entries
from gcd_dataset.shards.unfinished import unfinished

__all__ = ["published_faults", "shard_file_faults", "split_file_faults"]

FileFault = tuple[Check, str, str]
"""A check, the file or key, and the fault in words."""
PEOPLE_FILES = ("measurements/{}.yaml", "meta/{}_meta.json", "meshes/{}_straight.obj", "meshes/{}_apart.obj")


def shard_file_faults(folder: Path, split: str) -> Iterator[FileFault]:
    """Faults of the shards of a split in a local folder, from tar headers. Raises ``ShardError`` for a broken index."""
    index = read_stored_index(folder, split, GARMENTS, partial=True)
    tables = {} if index is None else index.tables()
    with reading(folder):
        paths = shards_in(folder, split)
    if index is None:
        yield checks.ORPHANS, index_name(split), "no index: run gcd index"
    for path in paths:
        if index is not None and path.name not in tables:
            yield checks.ORPHANS, path.name, "shards that the index does not list"
        elif path.name in tables:
            offsets = set(tables[path.name].offset.ravel().tolist())
            yield from _member_faults(path, offsets)
    names = {path.name for path in paths}
    yield from (
        (checks.INCOMPLETE, name, "shards of the index that are missing") for name in tables if name not in names
    )
    yield from _manifest_faults(folder, split, names)
    if (problem := unfinished(folder, split)) is not None:
        yield checks.INCOMPLETE, split, f"unfinished: {problem}"


def _member_faults(path: Path, offsets: set[int]) -> Iterator[FileFault]:
    """Members of a shard that its index does not list."""
    try:
        with reading(path), open_regular(path) as file:
            for entry in tar_entries(file.fileno()):
                if entry.offset not in offsets:
                    yield checks.ORPHANS, _place(path, entry), "members that the index does not list"
    except ShardError as error:
        yield checks.UNREADABLE, path.name, f"{error}"


def _place(path: Path, entry: TarMember) -> str:
    return f"{path.name}/{entry.name}"


def _manifest_faults(folder: Path, split: str, shards: set[str]) -> Iterator[FileFault]:
    manifest = read_manifest(folder)
    record = None if manifest is None else manifest.splits.get(split)
    if manifest is None or record is None:
        yield checks.ORPHANS, split, f"a split without an entry in {MANIFEST}"
        return
    listed = {shard.name for shard in record.shards}
    yield from ((checks.ORPHANS, name, f"shards that {MANIFEST} does not list") for name in sorted(shards - listed))
    yield from ((checks.INCOMPLETE, name, f"shards of {MANIFEST} that are missing") for name in sorted(listed - shards))


def split_file_faults(folder: Path, splits: Sequence[str]) -> Iterator[FileFault]:
    """Files of a local folder that belong to no split, and splits of the manifest without shards."""
    with reading(folder):
        names = sorted(path.name for path in folder.iterdir())
        waiting = sorted(path.name for path in (folder / WAITING).glob("*/*.tar"))
    known = {index_name(split) for split in splits}
    for name in names:
        split = name.rpartition("-")[0]
        if name.endswith(".tar") and split not in splits:
            yield checks.ORPHANS, name, "tars of no split"
        elif name.startswith("index-") and name.endswith(".npz") and name not in known:
            yield checks.ORPHANS, name, "indices of splits without shards"
    yield from ((checks.ORPHANS, name, "samples that wait for the rest of their shard") for name in waiting)
    manifest = read_manifest(folder)
    for split in sorted(set(manifest.splits) - set(splits)) if manifest is not None else ():
        if manifest is not None and manifest.splits[split].shards:
            yield checks.INCOMPLETE, split, f"splits of {MANIFEST} without shards"


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
