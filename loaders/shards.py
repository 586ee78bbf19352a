"""Garments from shards: by number, or as a stream."""

import zlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from torch.utils.data import IterableDataset
from webdataset.shardlists import split_by_node, split_by_worker
from webdataset.tariterators import group_by_keys, tar_file_expander

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.loaders.base import Garments, Transform
from gcd_dataset.shards.codec import read_json
from gcd_dataset.shards.layout import FIELDS, MEMBERS, Bytes, shards_in
from gcd_dataset.shards.reader import ShardReader, Verify

__all__ = ["GarmentDataset", "StreamedGarments"]

REMEDY = "download or make this shard again"


class GarmentDataset(Garments):
    """Garments in a folder of shards, by number.

    >>> ds = GarmentDataset("garments", fields=("verts", "faces"))  # doctest: +SKIP
    >>> ds[0]["verts"].shape  # doctest: +SKIP
    torch.Size([14425, 3])

    ``fields``: what to read; all for ``None``, nothing else is touched. ``transform``: called with each item.
    ``verify``: ``lazy`` checks a member's CRC-32 the first time that a process reads it, ``full`` checks everything at
    once, ``off`` nothing. ``streaming``: an iterable data set instead, which reads shards from end to end through
    ``webdataset`` and shares them out over ranks and workers.

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
    ) -> None:
        super().__init__(fields, transform)
        remote = {
            "root": root, "revision": revision, "cache_dir": cache_dir, "max_cache_size": max_cache_size,
            "endpoint": endpoint, "token": token,
        }  # fmt: skip
        self._reader = ShardReader(_folder(source, remote), split, verify=verify)
        self._check_stream = verify != "off"

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
        wanted = {FIELDS[field] for field in self.fields} | ({MEMBERS[0]} if self._check_stream else set())
        paths = self._own_shards()
        files = tar_file_expander(_opened(paths), select_files=lambda name: name.partition(".")[2] in wanted)
        count = 0
        for sample in group_by_keys(files):
            count += 1
            if missing := sorted(wanted - sample.keys()):
                raise ShardError(f"{sample['__url__']}: sample {sample['__key__']} has no {missing[0]}: {REMEDY}")
            if self._check_stream:
                _check(sample)
            yield self._item(sample)
        # A damaged header looks like the end of an archive to ``tarfile``, which then leaves out the rest of it.
        if count != self._expected(paths):
            raise ShardError(
                f"{paths[0].parent}: {count} samples of {self._expected(paths)} read: run gcd verify on it"
            )

    def _own_shards(self) -> list[Path]:
        """The shards of this rank and worker."""
        return list(split_by_worker(split_by_node(iter(shards_in(self._reader.folder, self._reader.split)))))

    def _expected(self, paths: Iterable[Path]) -> int:
        names, index = {path.name for path in paths}, self._reader.index
        return sum(len(table) for name, table in index.tables().items() if name in names)


def _opened(paths: Iterable[Path]) -> Iterator[dict[str, Any]]:
    """Shards as ``webdataset`` takes them: opened here, since WDS_SECURE=1 forbids it to open files."""
    for path in paths:
        with path.open("rb") as stream:
            yield {"url": str(path), "stream": stream}


def _check(sample: Mapping[str, Any]) -> None:
    """Raise ``ShardError`` if a member differs from the CRC-32 in the sample's meta.json."""
    written = read_json(sample[MEMBERS[0]])["crc32"]
    for member in written.keys() & sample.keys():
        if zlib.crc32(sample[member]) != written[member]:
            raise ShardError(
                f"{sample['__url__']}: sample {sample['__key__']}, member {member}: bytes differ from those that were "
                f"written: {REMEDY}"
            )


def _folder(source: str | Path, remote: Mapping[str, Any]) -> Path:
    """The folder to read. Raises ``ConfigError`` for another source, or an option that only another source has."""
    if not Path(source).is_dir():
        raise ConfigError(f"{source}: no such folder: only folders are read so far, neither URLs nor the Hub")
    if given := [name for name, value in remote.items() if value is not None]:
        raise ConfigError(
            f"{given[0]}={remote[given[0]]!r} is for URLs and the Hub, and {source} is a folder: leave it out"
        )
    return Path(source)
