"""A loopback S3 store by moto that can inject faults."""

import contextlib
import functools
import hashlib
import re
import socket
import threading
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

KEYS = {"AWS_ACCESS_KEY_ID": "key", "AWS_SECRET_ACCESS_KEY": "secret", "AWS_DEFAULT_REGION": "us-east-1"}
ERROR = "<?xml version='1.0'?><Error><Code>{code}</Code><Message>{code} by this test</Message></Error>"


@dataclass
class Fault:
    """A fault of the next ``times`` requests with a method and path that match ``pattern``."""

    pattern: str
    times: int = 999
    code: str = ""
    """S3 error code to answer with; without a code the connection is closed."""
    status: str = "403 Forbidden"


@dataclass
class Store:
    """A running store."""

    endpoint: str
    log: list[str] = field(default_factory=list)
    """Method, path and ``Range`` header of each request."""
    faults: list[Fault] = field(default_factory=list)

    def asked(self, pattern: str) -> list[str]:
        """The requests that match ``pattern``."""
        return [request for request in self.log if re.search(pattern, request)]

    def objects(self, url: str) -> dict[str, bytes]:
        """Name to content of all objects below a URL."""
        store, path = self._files(url)
        with contextlib.suppress(FileNotFoundError):
            return {name.removeprefix(f"{path}/"): store.cat_file(name) for name in store.find(path)}
        return {}

    def put(self, url: str, files: Mapping[str, bytes] | Path) -> str:
        """Store objects, or the files of a folder, below a URL; return the URL."""
        if isinstance(files, Path):
            files = {path.name: path.read_bytes() for path in files.iterdir() if not path.name.startswith(".")}
        store, path = self._files(url)
        for name, content in files.items():
            store.pipe_file(f"{path}/{name}", content)
        return url

    def remove(self, url: str) -> None:
        """Remove an object."""
        store, path = self._files(url)
        store.rm_file(path)

    def _files(self, url: str) -> tuple[Any, str]:
        from fsspec.core import url_to_fs

        store, path = url_to_fs(url)
        store.invalidate_cache()
        return store, path

    def __call__(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        asked = f"{environ['REQUEST_METHOD']} {environ['PATH_INFO']}"
        self.log.append(f"{asked} {environ.get('HTTP_RANGE', '')}".strip())
        for fault in self.faults:
            if fault.times > 0 and re.search(fault.pattern, asked):
                fault.times -= 1
                environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
                if not fault.code:
                    environ["werkzeug.socket"].shutdown(socket.SHUT_RDWR)
                    raise ConnectionResetError
                start_response(fault.status, [("Content-Type", "application/xml")])
                return [ERROR.format(code=fault.code).encode()] if environ["REQUEST_METHOD"] != "HEAD" else []
        return _application()(environ, start_response)


@contextlib.contextmanager
def running_store() -> Iterator[Store]:
    """A store with one bucket, ``bucket``; within the block, environment variables point to it."""
    from werkzeug.serving import make_server

    store = Store("")
    server = make_server("127.0.0.1", 0, store, threaded=True)
    store.endpoint = f"http://127.0.0.1:{server.server_port}"
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {**KEYS, "AWS_ENDPOINT_URL": store.endpoint, "AWS_EC2_METADATA_DISABLED": "true"}.items():
            patch.setenv(name, value)
        for name in ("AWS_CONFIG_FILE", "AWS_SHARED_CREDENTIALS_FILE"):
            patch.setenv(name, "/nonexistent")
        _make_bucket()
        yield store
    server.shutdown()
    server.server_close()


def _make_bucket() -> None:
    import fsspec

    with contextlib.suppress(FileExistsError):
        fsspec.filesystem("s3").mkdir("bucket")


@functools.cache
def _application() -> Any:
    from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app

    return DomainDispatcherApplication(create_backend_app)


def hashes(files: Mapping[str, bytes]) -> dict[str, str]:
    """Name to SHA-256 of the content."""
    return {name: hashlib.sha256(content).hexdigest() for name, content in sorted(files.items())}
