"""S3 on loopback (``moto``) in a process of its own, which counts: ``python -m benchmarks.loading.store PORT``."""

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any
from urllib.request import urlopen

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
    command = [sys.executable, "-m", "benchmarks.loading.store", str(PORT)]
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
