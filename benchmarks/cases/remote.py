"""A data set in an object store (S3 of ``moto`` on loopback): requests, bytes, and CPU time of the reading process.

``open``, ``first``: requests and bytes of opening, and of the first garment after it. ``epoch``: a first pass in random
order with an empty cache, in batches of 16 of geometry, columns made included; ``again``: a second one. ``litdata`` and
``mosaicml streaming`` read copies of the same garments that hold these fields alone, with their own shuffling. The
server counts requests and bytes. A library that is not installed is left out.
"""

import argparse
import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any
from urllib.request import urlopen

from benchmarks.cases import CaseResult, Figure
from benchmarks.loading import (
    BATCH,
    CONFIGS,
    arrays_of,
    packed_items,
    write_litdata,
    write_shards,
    write_streaming,
)
from gcd_dataset.loaders import GarmentDataset, GarmentLoader
from gcd_dataset.shards import ShardReader

FIELDS = CONFIGS["geometry"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--count", type=int, default=192, help="synthetic garments")
    parser.add_argument("--data", type=Path, help="a folder of draped garments to read instead")


def run(options: argparse.Namespace) -> CaseResult:
    """Write shards and copies, put them into a store, read them."""
    with tempfile.TemporaryDirectory() as own, store() as files:
        data, cache = Path(own) / "data", Path(own) / "cache"
        if options.data is None:
            write_shards(data, options.count)
        else:
            shutil.copytree(options.data, data)
        record = ShardReader(data).record
        figures = list(_first(put_folder(files, data, "set"), cache / "first", record.count))
        rows = []
        for name, (module, url_of, read) in READERS.items():
            if find_spec(module) is not None:
                epoch = read(url_of(files, data), cache / name)
                rows += [_pass(name, which, epoch, record.count) for which in ("epoch", "again")]
        figures += [Figure("epoch_requests", rows[0]["requests"] / len(record.shards), "a shard")]
        return CaseResult(figures, rows)


def _first(url: str, cache: Path, count: int) -> Iterator[Figure]:
    counted()
    dataset = GarmentDataset(url, fields=FIELDS, cache_dir=cache)
    requests, size = counted()
    yield from (Figure("open_requests", requests, ""), Figure("open_bytes", size, "bytes"))
    dataset[count // 2]
    requests, size = counted()
    yield from (Figure("first_requests", requests, ""), Figure("first_bytes", size, "bytes"))


def _pass(name: str, which: str, epoch: Callable[[], Iterable[Any]], count: int) -> dict[str, Any]:
    counted()
    begun, batches = time.process_time(), 0
    for _ in epoch():
        batches += 1
    spent, (requests, size) = time.process_time() - begun, counted()
    assert batches == -(-count // BATCH), (name, batches)
    return {
        "reader": name,
        "pass": which,
        "CPU-ms a garment": f"{1e3 * spent / count:.3f}",
        "requests": requests,
        "requests a garment": f"{requests / count:.3f}",
        "bytes a garment": round(size / count),
    }


def _ours(url: str, cache: Path) -> Callable[[], Iterable[Any]]:
    loader = GarmentLoader(GarmentDataset(url, fields=FIELDS, cache_dir=cache), BATCH)
    return lambda: loader


def _litdata(url: str, cache: Path) -> Callable[[], Iterable[Any]]:
    from litdata import StreamingDataset
    from litdata.streaming import downloader

    downloader._OBSTORE_CLIENT_OPTIONS["allow_http"] = True  # no public option
    dataset = StreamingDataset(url, cache_dir=str(cache), shuffle=True)
    return lambda: _batches(map(arrays_of, dataset))


def _streaming(url: str, cache: Path) -> Callable[[], Iterable[Any]]:
    from streaming import StreamingDataset

    dataset = StreamingDataset(remote=url, local=str(cache), shuffle=True, batch_size=BATCH)
    return lambda: _batches(iter(dataset))


def _batches(items: Iterator[Any]) -> Iterator[Any]:
    while found := list(islice(items, BATCH)):
        yield packed_items(found)


Reader = tuple[str, Callable[[Any, Path], str], Callable[[str, Path], Callable[[], Iterable[Any]]]]
READERS: Mapping[str, Reader] = {
    "ours": ("torch", lambda files, data: "s3://bucket/set", _ours),
    "litdata": ("litdata", lambda files, data: put_folder(files, write_litdata(data, FIELDS), "litdata"), _litdata),
    "mosaicml streaming": (
        "streaming",
        lambda files, data: put_folder(files, write_streaming(data, FIELDS), "mosaicml"),
        _streaming,
    ),
}
"""Name to the module that must be installed, the URL of its copy, and its epochs of packed batches."""


PORT = 5017
URL = f"http://127.0.0.1:{PORT}"
SETTINGS = {
    "AWS_ACCESS_KEY_ID": "key",
    "AWS_SECRET_ACCESS_KEY": "secret",
    "AWS_DEFAULT_REGION": "us-east-1",
    "AWS_ENDPOINT_URL": URL,
    "AWS_EC2_METADATA_DISABLED": "true",
    "S3_ENDPOINT_URL": URL,  # of mosaicml-streaming
}


@contextlib.contextmanager
def store() -> Iterator[Any]:
    """A file system of ``fsspec`` with the bucket ``bucket``."""
    import fsspec

    os.environ |= SETTINGS
    command = [sys.executable, "-m", "benchmarks.cases.remote", str(PORT)]
    server = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        files = fsspec.filesystem("s3")
        for _ in range(100):
            with contextlib.suppress(OSError):
                files.mkdir("bucket")
                break
            time.sleep(0.3)
        yield files
    finally:
        server.terminate()
        server.wait()


def put_folder(files: Any, folder: Path, name: str) -> str:
    """Copy the files of a folder into the bucket. Returns their URL."""
    for path in folder.rglob("*"):
        if path.is_file():
            files.put_file(str(path), f"bucket/{name}/{path.relative_to(folder).as_posix()}")
    return f"s3://bucket/{name}"


def counted() -> tuple[int, int]:
    """Requests, and bytes of their answers, since the last call."""
    with urlopen(f"{URL}/counted") as answer:
        requests, size = json.load(answer)
    return requests, size


class _Counting:
    """The server's WSGI application, counting."""

    def __init__(self, answer: Callable[..., Iterable[bytes]]) -> None:
        self._answer, self._requests, self._bytes = answer, 0, 0

    def __call__(self, request: dict[str, Any], start: Callable[..., Any]) -> Iterable[bytes]:
        if request["PATH_INFO"] == "/counted":
            counts, self._requests, self._bytes = [self._requests, self._bytes], 0, 0
            start("200 OK", [("Content-Type", "application/json")])
            return [json.dumps(counts).encode()]

        def begin(status: str, headers: list[tuple[str, str]], *error: Any) -> Any:
            if request["REQUEST_METHOD"] == "GET":
                self._bytes += int(dict(headers).get("Content-Length", 0))
            return start(status, headers, *error)

        self._requests += 1
        return self._answer(request, begin)


if __name__ == "__main__":
    from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app
    from werkzeug.serving import run_simple

    run_simple("127.0.0.1", int(sys.argv[1]), _Counting(DomainDispatcherApplication(create_backend_app)), threaded=True)
