"""Garments from shards: by number, or as a stream."""

import tarfile
import zlib
from collections.abc import Container, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from torch.utils.data import IterableDataset
from webdataset.shardlists import split_by_node, split_by_worker
from webdataset.tariterators import group_by_keys, tar_file_expander

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.loaders.base import Garments, Transform
from gcd_dataset.shards.access import REMEDY, reading
from gcd_dataset.shards.codec import read_json
from gcd_dataset.shards.index import has_settled
from gcd_dataset.shards.layout import FIELDS, MEMBERS, Bytes
from gcd_dataset.shards.reader import ShardReader, Verify

__all__ = ["GarmentDataset", "StreamedGarments"]


class GarmentDataset(Garments):
    """Garments in a folder of shards, by number.

    >>> ds = GarmentDataset("garments", fields=("verts", "faces"))  # doctest: +SKIP
    >>> ds[0]["verts"].shape  # doctest: +SKIP
    torch.Size([14425, 3])

    ``fields``: what to read; all for ``None``, nothing else is touched. ``transform``: called with each item.
    ``verify``: ``lazy`` checks a member's CRC-32 the first time that a process reads it, ``full`` checks everything at
    once, ``off`` nothing. ``settled_only``: only garments whose drape hangs still. ``streaming``: an iterable data set
    instead, which reads shards from end to end through ``webdataset`` and shares them out over ranks and workers.

    Only folders are read so far, where ``download`` has nothing to do; the other options for remote sources raise
    ``ConfigError``. Raises ``ShardError`` for a folder that holds no such split, or a broken, foreign or newer one.
    """

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
        transform: Transform | None = None,
        verify: Verify = "lazy",
        settled_only: bool = False,
    ) -> None:
        super().__init__(fields, transform)
        remote = {
            "root": root, "revision": revision, "cache_dir": cache_dir, "max_cache_size": max_cache_size,
            "endpoint": endpoint, "token": token,
        }  # fmt: skip
        self._reader = ShardReader(_folder(source, remote), split, verify=verify, settled_only=settled_only)
        self._check_stream, self._settled_only = verify != "off", settled_only

    def __len__(self) -> int:
        return len(self._reader)

    def recipe(self, index: int) -> dict[str, Any]:
        """Seed, index, options and versions that garment ``index`` was made with. Raises ``IndexError``."""
        meta = read_json(self._reader.read(self._position(index), ["meta.json"])["meta.json"])
        return {name: meta[name] for name in ("seed", "index", "recipe", "versions")}

    def verify(self, index: int) -> None:
        """Raise ``ShardError`` with shard, key and member if a byte of garment ``index`` is not as it was written."""
        self._reader.check(self._position(index))

    def _members(self, position: int, members: tuple[str, ...]) -> Mapping[str, Bytes]:
        return self._reader.read(position, members)


class StreamedGarments(GarmentDataset, IterableDataset):
    """The same items in the order of the shards; each rank and worker reads shards of its own."""

    def __iter__(self) -> Iterator[Any]:
        for path in self._own_shards():
            count = 0
            for sample in _samples(path, self._wanted):
                count += 1
                if missing := sorted(self._wanted - sample.keys()):
                    raise ShardError(f"{path}: sample {sample['__key__']} has no {missing[0]}: {REMEDY}")
                if self._check_stream:
                    _check(path, sample)
                if not self._settled_only or has_settled(read_json(sample[MEMBERS[0]])):
                    yield self._item(sample)
            # A damaged header looks like the end of an archive to ``tarfile``, which then leaves out the rest of it.
            if count != self._count[path.name]:
                raise ShardError(f"{path}: {count} samples of {self._count[path.name]} read: {REMEDY}")

    @property
    def _wanted(self) -> set[str]:
        """Members to take out of the archives: the first always, or a sample without fields would not be one."""
        return {MEMBERS[0], *(FIELDS[field] for field in self.fields)}

    @property
    def _count(self) -> dict[str, int]:
        """Samples of each shard."""
        return {name: len(table) for name, table in self._reader.index.tables().items()}

    def _own_shards(self) -> list[Path]:
        """The shards of this rank and worker."""
        paths = (self._reader.folder / name for name in self._reader.index.shards)
        return list(split_by_worker(split_by_node(paths)))


def _samples(path: Path, wanted: Container[str]) -> Iterator[Mapping[str, Any]]:
    """The samples of a shard as ``webdataset`` gives them. Raises ``ShardError`` for a damaged archive."""
    try:
        # Opened here, since WDS_SECURE=1 forbids ``webdataset`` to open files.
        with reading(path), path.open("rb") as stream:
            shard = [{"url": str(path), "stream": stream}]
            files = tar_file_expander(shard, select_files=lambda name: name.partition(".")[2] in wanted)
            yield from group_by_keys(files)
    except tarfile.TarError as error:
        raise ShardError(f"{path}: a damaged archive ({error.args[0]}): {REMEDY}") from error


def _check(path: Path, sample: Mapping[str, Any]) -> None:
    """Raise ``ShardError`` if a member differs from the CRC-32 in the sample's meta.json."""
    written = read_json(sample[MEMBERS[0]])["crc32"]
    for member in written.keys() & sample.keys():
        if zlib.crc32(sample[member]) != written[member]:
            raise ShardError(
                f"{path}: sample {sample['__key__']}, member {member}: bytes differ from those that were written: "
                f"{REMEDY}"
            )


def _folder(source: str | Path, remote: Mapping[str, Any]) -> Path:
    """The folder to read. Raises ``ConfigError`` for another source, or an option that only another source has."""
    with reading(Path(source)):
        is_folder = Path(source).is_dir()
    if not is_folder:
        raise ConfigError(f"{source}: no such folder: only folders are read so far, neither URLs nor the Hub")
    if given := [name for name, value in remote.items() if value is not None]:
        raise ConfigError(
            f"{given[0]}={remote[given[0]]!r} is for URLs and the Hub, and {source} is a folder: leave it out"
        )
    return Path(source)
