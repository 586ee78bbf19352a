"""Reads a data set on a server sample by sample: only the requested members, verified and cached."""

import contextlib
import hashlib
import io
import re
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import BinaryIO, TypeVar

from gcd_dataset.errors import MissingError, RemoteError, ShardError, did_you_mean, shown
from gcd_dataset.hub.cache import Cache, CachedMember
from gcd_dataset.hub.foreign_tars import read_foreign_index
from gcd_dataset.hub.site import Site
from gcd_dataset.shards.index import ShardIndex
from gcd_dataset.shards.layout import GARMENTS, Layout, index_name
from gcd_dataset.shards.limits import LARGEST_MANIFEST
from gcd_dataset.shards.manifest import MANIFEST, Manifest, parse_manifest
from gcd_dataset.shards.store import MemberLocation, Store, runs
from gcd_dataset.shards.unfinished import note_name, unfinished_by

__all__ = ["RemoteStore"]

T = TypeVar("T")

GAP = 1 << 17  # bytes: transferring a gap takes about as long as another request, and servers limit requests
SHA256 = re.compile(r"[0-9a-f]{64}")
REPUBLISH = "ask its publisher to run gcd index and publish it again"
PARALLEL_REQUESTS = 8
LARGEST_MEMBER = 1 << 28  # bytes: a hundred times the largest member of a garment


class RemoteStore(Store):
    """The samples of a site. ``cache`` keeps the members that are read; ``None`` disables caching."""

    remedy = "try again later, or tell its publisher"

    def __init__(self, site: Site, cache: Cache | None) -> None:
        self.site, self._cache, self.source = site, cache, site.source
        self._shards: dict[str, _RemoteShard] = {}

    def location(self, name: str = "") -> str:
        return f"{self.source}/{shown(name)}" if name else str(self.source)

    def manifest(self) -> Manifest | None:
        try:
            return parse_manifest(self.site.small_file(MANIFEST), self.location(MANIFEST), self.remedy)
        except MissingError:
            return None
        except ShardError:
            self.site.forget(MANIFEST)  # the next call asks the server again
            raise

    def index(self, split: str, layout: Layout) -> ShardIndex:
        manifest, name = self.manifest(), index_name(split)
        if manifest is not None and split not in manifest.splits:
            available = f"choose from {', '.join(manifest.splits)}{did_you_mean(split, manifest.splits)}"
            raise ShardError(f"{self.location()}: no samples of split {split}: {available}")
        try:
            content = self.site.small_file(name)
            index = ShardIndex.parse(content, self.location(name), layout, partial=True, remedy=REPUBLISH)
            self._require_listed(index, split, manifest)
        except MissingError as error:
            if manifest is not None or layout != GARMENTS:
                raise RemoteError(f"{error}: {REPUBLISH}") from error
            index = read_foreign_index(self.site, split)
        except ShardError:
            self.site.forget(name)  # its publisher may be replacing files just now
            raise
        first = 0
        for shard, table in index.tables().items():
            self._shards[shard] = _RemoteShard(self._key(shard, split, manifest), len(table), first, index)
            first += len(table)
        return index

    def unfinished(self, split: str) -> str | None:
        name = note_name(split)

        def ask() -> bytes:
            with contextlib.suppress(MissingError):
                return self.site.web.get(name, LARGEST_MANIFEST)
            return b""

        with contextlib.suppress(RemoteError):  # without an answer
            return unfinished_by(self.site.cached(name.removeprefix("."), ask), self.manifest() or Manifest(), split)
        return None

    def read(self, shard: str, number: int, parts: Sequence[MemberLocation]) -> dict[int, memoryview]:
        return self.read_many([(shard, number, parts)])[0]

    def read_many(self, wanted: Sequence[tuple[str, int, Sequence[MemberLocation]]]) -> list[dict[int, memoryview]]:
        content: dict[tuple[str, int], memoryview] = {}
        requested: dict[str, dict[int, MemberLocation]] = {}
        for shard, number, parts in wanted:
            flags = requested.setdefault(shard, {})
            flags |= {self._shards[shard].flag(number, part.column): part for part in parts}
        jobs: list[Callable[[], dict[tuple[str, int], memoryview]]] = []
        for shard, flags in requested.items():
            cached = self._read_cache(shard, flags)
            content |= {(shard, flag): data for flag, data in cached.items()}
            missing = [part._replace(column=flag) for flag, part in flags.items() if flag not in cached]
            missing.sort(key=lambda part: part.offset)
            jobs += [partial(self._fetch, shard, run) for run in runs(missing, GAP)]
        for fetched in _run_parallel(jobs):
            content |= fetched
        returned: set[tuple[str, int]] = set()
        samples = []
        for shard, number, parts in wanted:
            keys = {part.column: (shard, self._shards[shard].flag(number, part.column)) for part in parts}
            # A sample may be requested twice, and the caller owns each buffer.
            samples.append({c: _copy(content[key]) if key in returned else content[key] for c, key in keys.items()})
            returned.update(keys.values())
        return samples

    def refetch(self, shard: str, number: int, part: MemberLocation) -> memoryview | None:
        remote_shard = self._shards[shard]
        flag = remote_shard.flag(number, part.column)
        if self._cache is not None:
            self._cache.drop(remote_shard.key, remote_shard.count, flag, part.size)
        return self._fetch(shard, [part._replace(column=flag)])[shard, flag]

    def stream(self, shard: str) -> BinaryIO:
        self.site.require_allowed(f"a stream of {shard}")
        return io.BufferedReader(_Pieces(self.site.web.pieces(shard)), 1 << 20)

    def _read_cache(self, shard: str, flags: dict[int, MemberLocation]) -> dict[int, memoryview]:
        if self._cache is None:
            return {}
        remote_shard = self._shards[shard]
        wanted = sorted(flags.items(), key=lambda entry: entry[1].offset)
        return self._cache.read(remote_shard.key, remote_shard.count, wanted)

    def _fetch(self, shard: str, run: Sequence[MemberLocation]) -> dict[tuple[str, int], memoryview]:
        """Fetch neighbouring members by one range request and cache them; here ``column`` of a part is its flag.

        Raises ``RemoteError`` with sample and member after two CRC-32 mismatches.
        """
        remote_shard = self._shards[shard]
        self.site.require_allowed(f"{shard}, {remote_shard.name_of(run[0].column)}")
        for part in run:
            if part.size > LARGEST_MEMBER:
                raise RemoteError(
                    f"{self.location(shard)}: {remote_shard.name_of(part.column)}: has {part.size} bytes according to "
                    f"its index, over the limit of {LARGEST_MEMBER} for servers: leave this field out, or tell its "
                    "publisher"
                )
        wrong = None
        for _ in range(2):
            buffer = self.site.web.read(shard, run[0].offset, run[-1].end)
            data = {part: buffer[part.offset - run[0].offset : part.end - run[0].offset] for part in run}
            wrong = next((part for part, content in data.items() if zlib.crc32(content) != part.crc), None)
            if wrong is None:
                break
        else:
            assert wrong is not None
            raise RemoteError(
                f"{self.location(shard)}: {remote_shard.name_of(wrong.column)}: received bytes do not match the "
                f"published CRC-32; none are kept: {self.remedy}"
            )
        if self._cache is not None:
            pieces = [CachedMember(part.column, part.offset, content) for part, content in data.items()]
            self._cache.keep(remote_shard.key, remote_shard.count, pieces)
        return {(shard, part.column): content for part, content in data.items()}

    def _require_listed(self, index: ShardIndex, split: str, manifest: Manifest | None) -> None:
        """Raise ``RemoteError`` unless index and manifest list the same shards."""
        if manifest is None:
            return
        listed = {shard.name: (shard.size, shard.count) for shard in manifest.splits[split].shards}
        counts = [len(table) for table in index.tables().values()]
        found = dict(zip(index.shards, zip(index.length.tolist(), counts, strict=True), strict=True))
        if found != listed:
            odd = sorted(name for name, _ in listed.items() ^ found.items())[0]
            raise RemoteError(f"{self.location()}: {index_name(split)} and {MANIFEST} differ in {odd}: {REPUBLISH}")

    def _key(self, shard: str, split: str, manifest: Manifest | None) -> str:
        """The cache key of a shard: its published hash, so that data sets and revisions share equal shards."""
        records = manifest.splits[split].shards if manifest is not None else ()
        known = {record.name: record.sha256 for record in records if SHA256.fullmatch(record.sha256)}
        return known.get(shard) or hashlib.sha256(self.location(shard).encode()).hexdigest()


class _RemoteShard:
    """One shard. Its members are numbered sample by sample; the number is the flag in the cache."""

    def __init__(self, key: str, samples: int, first: int, index: ShardIndex) -> None:
        self.key, self._first, self._index = key, first, index
        self._members = len(index.layout.members)
        self.count = samples * self._members

    def flag(self, number: int, column: int) -> int:
        return number * self._members + column

    def name_of(self, flag: int) -> str:
        """Sample and member of a flag, for messages."""
        number, column = divmod(flag, self._members)
        return f"sample {self._index.key(self._first + number)}, member {self._index.layout.members[column]}"


class _Pieces(io.RawIOBase):
    """A readable file over an iterator of bytes."""

    def __init__(self, pieces: Iterator[bytes]) -> None:
        self._pieces, self._rest = pieces, memoryview(b"")

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        if not self._rest:
            self._rest = memoryview(next(self._pieces, b""))
        count = min(len(buffer), len(self._rest))
        buffer[:count] = self._rest[:count]
        self._rest = self._rest[count:]
        return count


def _copy(data: memoryview) -> memoryview:
    return memoryview(bytearray(data))


def _run_parallel(jobs: Sequence[Callable[[], T]]) -> Iterator[T]:
    """The results of jobs in order; up to ``PARALLEL_REQUESTS`` run at a time."""
    if len(jobs) < 2:
        yield from (job() for job in jobs)
        return
    with ThreadPoolExecutor(min(PARALLEL_REQUESTS, len(jobs))) as pool:
        yield from pool.map(lambda job: job(), jobs)
