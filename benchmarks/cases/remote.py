"""A data set in an object store (S3 of ``moto`` on loopback): requests, bytes, and CPU time of the reading process.

``open``, ``first``: requests and bytes of opening, and of the first garment after it. ``epoch``: requests a shard and
CPU time a garment of a first pass in random order with an empty cache, columns made included; ``again``: of a second.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.cases.figures import Figure, Measured
from benchmarks.loading.workload import CONFIGS, write_shards
from gcd_dataset.hub import fetch
from gcd_dataset.loaders import GarmentDataset, GarmentLoader

__all__ = ["add_arguments", "run"]

PORT = 5017
KEYS = {"AWS_ACCESS_KEY_ID": "key", "AWS_SECRET_ACCESS_KEY": "secret", "AWS_DEFAULT_REGION": "us-east-1"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=192, help="garments")


def run(options: argparse.Namespace) -> Measured:
    """Write shards, copy them into a store, read them."""
    with tempfile.TemporaryDirectory() as own, _store() as store:
        folder = write_shards(Path(own) / "data", options.count)
        for path in folder.rglob("*"):
            if path.is_file():
                store.put_file(str(path), f"bucket/set/{path.relative_to(folder).as_posix()}")
        return Measured(list(_figures(Path(own) / "cache", options.count)))


def _figures(cache: Path, count: int) -> Iterator[Figure]:
    requests: list[int] = []
    with _counted(requests):
        data = GarmentDataset("s3://bucket/set", fields=CONFIGS["geometry"], cache_dir=cache)
        yield from (Figure("open_requests", len(requests), ""), Figure("open_bytes", sum(requests), "bytes"))
        requests.clear()
        data[count // 2]
        yield from (Figure("first_requests", len(requests), ""), Figure("first_bytes", sum(requests), "bytes"))
        for name in ("epoch", "again"):
            requests.clear()
            begun = time.process_time()
            for _ in GarmentLoader(data, 16, shuffle=True):
                pass
            yield Figure(f"{name}_cpu_ms", 1e3 * (time.process_time() - begun) / count, "ms a garment")
            shards = len(data._parts[0].reader.record.shards)
            yield Figure(f"{name}_requests", len(requests) / shards, "a shard")
            yield Figure(f"{name}_bytes", sum(requests) / count, "bytes a garment")


@contextmanager
def _counted(requests: list[int]) -> Iterator[None]:
    """Append the bytes of each request to ``requests``."""
    asked = fetch._from_store

    def counting(span: fetch.Span, take: fetch.Take) -> fetch.Headers:
        sizes: list[int] = []

        def counted(piece: bytes) -> None:
            sizes.append(len(piece))
            take(piece)

        headers = asked(span, counted)
        requests.extend(sizes)
        return headers

    fetch._from_store = counting
    try:
        yield
    finally:
        fetch._from_store = asked


@contextmanager
def _store() -> Iterator[Any]:
    """A store with the bucket ``bucket`` in a process of its own."""
    os.environ |= {**KEYS, "AWS_ENDPOINT_URL": f"http://127.0.0.1:{PORT}", "AWS_EC2_METADATA_DISABLED": "true"}
    command = [sys.executable, "-m", "moto.server", "-p", str(PORT)]
    server = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        import fsspec

        store = fsspec.filesystem("s3")
        for _ in range(100):
            try:
                store.mkdir("bucket")
                break
            except OSError:
                time.sleep(0.3)
        yield store
    finally:
        server.terminate()
        server.wait()
