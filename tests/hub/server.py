"""A loopback server that logs its requests and injects faults: a Hub with a plain web server.

The Hub has the part of the API that ``huggingface_hub`` uses. It redirects large files to another address
(``localhost`` for ``127.0.0.1``), as the Hub of Hugging Face sends them to its storage.
"""

import base64
import hashlib
import json
import re
import socket
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self
from urllib.parse import quote, unquote

from werkzeug.serving import WSGIRequestHandler, make_server
from werkzeug.wrappers import Request, Response

LARGE = (".tar",)
"""Endings of files in the large-file storage."""


@dataclass(frozen=True)
class Asked:
    """A request, its ``Range`` header, and its answer: status and bytes sent of the body."""

    method: str
    path: str
    span: str
    status: int
    size: int
    authorization: str


@dataclass
class Fault:
    """A fault of the next ``times`` requests with a path that matches ``pattern``.

    ``drop``: close the connection without an answer. ``status``: answer with it and ``body``. ``cut``: close the
    connection after so many bytes of the body; ``hold``: keep it open then, and send nothing more. ``flip``: change a
    bit of this byte of the file. ``whole``: ignore ``Range``. ``chunked``: send no length. ``change``: of the body.
    """

    pattern: str
    times: int = 1
    method: str = "GET"
    drop: bool = False
    status: int = 0
    body: bytes = b""
    headers: Mapping[str, str] = field(default_factory=dict)
    cut: int | None = None
    hold: bool = False
    flip: int | None = None
    whole: bool = False
    chunked: bool = False
    change: Callable[[bytes], bytes] = bytes


class Server:
    """A WSGI application on a port, in threads; a context manager."""

    def __init__(self) -> None:
        self.faults: list[Fault] = []
        self.log: list[Asked] = []
        self._counting = threading.Lock()
        self._server: Any = None
        self._port = 0

    @property
    def endpoint(self) -> str:
        return f"http://127.0.0.1:{self._port}"

    def asked(self, pattern: str = "", *, method: str = "GET") -> list[Asked]:
        """The requests with a matching path."""
        return [request for request in list(self.log) if request.method == method and re.search(pattern, request.path)]

    def application(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        """What is served where there is no fault."""
        raise NotImplementedError

    def __call__(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        fault, line = self._due_fault(environ) or Fault("", times=0), environ["werkzeug.socket"]
        if fault.drop or fault.status:
            environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
        if fault.whole:
            environ.pop("HTTP_RANGE", None)
        if fault.drop:
            self._note(environ, 0, 0)
            line.shutdown(socket.SHUT_RDWR)
            raise ConnectionResetError
        if fault.status:
            response = Response(fault.body, fault.status)
        else:
            response = Response.from_app(self.application, environ, buffered=True)
        body = fault.change(_flipped(response, fault.flip))
        part = body[: fault.cut]
        self._note(environ, response.status_code, len(part))  # before the answer: a test may read the log at once
        response.response = _sent(part, line if fault.hold else None)  # an iterator: its length is not set by werkzeug
        if environ["REQUEST_METHOD"] != "HEAD":  # whose answer has the length of a body that is not sent
            response.headers["Content-Length"] = str(len(body))
        if fault.chunked:
            del response.headers["Content-Length"]
        response.headers.update(fault.headers)
        return response(environ, start_response)

    def _due_fault(self, environ: dict[str, Any]) -> Fault | None:
        with self._counting:
            for fault in self.faults:
                is_meant = fault.method == environ["REQUEST_METHOD"] and re.search(fault.pattern, _path(environ))
                if fault.times > 0 and is_meant:
                    fault.times -= 1
                    return fault
        return None

    def _note(self, environ: dict[str, Any], status: int, size: int) -> None:
        span, authorization = environ.get("HTTP_RANGE", ""), environ.get("HTTP_AUTHORIZATION", "")
        self.log.append(Asked(environ["REQUEST_METHOD"], _path(environ), span, status, size, authorization))

    def start(self) -> None:
        """Listen; after ``stop``, on the same port as before."""
        self._server = make_server("127.0.0.1", self._port, self, threaded=True, request_handler=_Silent)
        self._port = self._server.server_port
        threading.Thread(target=self._server.serve_forever, args=(0.01,), daemon=True).start()

    def stop(self) -> None:
        """Stop listening."""
        if self._server is not None:
            self._server.shutdown()
            self._server.server_close()
            self._server = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()


class _Silent(WSGIRequestHandler):
    def log(self, *arguments: Any) -> None:
        """Log nothing."""


def _path(environ: dict[str, Any]) -> str:
    return unquote(environ["RAW_URI"])


def _sent(part: bytes, line: socket.socket | None) -> Iterator[bytes]:
    yield part
    if line is not None:
        line.recv(1)  # returns when the connection closes


def _flipped(response: Response, place: int | None) -> bytes:
    """The body, with a bit of a byte changed: byte ``place`` of the whole file."""
    body, sent = response.get_data(), response.content_range
    place = -1 if place is None else place - (sent.start or 0 if sent else 0)
    return body[:place] + bytes([body[place] ^ 1]) + body[place + 1 :] if 0 <= place < len(body) else body


@dataclass
class Repo:
    """A repository. Each commit is a hash and a map from path to content; the newest comes last."""

    commits: list[tuple[str, dict[str, bytes]]] = field(default_factory=list)
    private: bool = False

    def commit(self, files: Mapping[str, bytes]) -> str:
        """Add a commit; return its hash."""
        hashes = {name: _git_hash(data) for name, data in files.items()}
        sha = hashlib.sha1(("".join(sha for sha, _ in self.commits) + json.dumps(hashes)).encode()).hexdigest()
        self.commits.append((sha, dict(files)))
        return sha

    def at(self, revision: str) -> tuple[str, dict[str, bytes]] | None:
        """Commit and files of the branch ``main`` or of a commit."""
        if revision == "main":
            return self.commits[-1] if self.commits else None
        return next((commit for commit in self.commits if commit[0] == revision), None)


class Hub(Server):
    """A Hub; below ``/files/`` a plain web server."""

    def __init__(self) -> None:
        super().__init__()
        self.repos: dict[str, Repo] = {}
        self.static: dict[str, bytes] = {}
        """Path to content of the files below ``/files/``."""
        self.large: dict[str, bytes] = {}
        self.token = "hf_right"

    def publish(self, name: str, files: Mapping[str, bytes] | Path, *, private: bool = False) -> str:
        """Commit files, given as a mapping or a folder, to a repository; return the commit's hash."""
        content = read_folder(files) if isinstance(files, Path) else dict(files)
        return self.repos.setdefault(name, Repo(private=private)).commit(content)

    def application(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        request = Request(environ)
        for pattern, answer in ROUTES:
            if match := re.fullmatch(pattern, request.path):
                response = answer(self, request, **{name: value or "" for name, value in match.groupdict().items()})
                return response(environ, start_response)
        return _json({"error": "not found"}, 404)(environ, start_response)

    def found(self, request: Request, name: str, revision: str) -> tuple[str, dict[str, bytes]] | Response:
        """Commit and files, or the answer that they are missing."""
        repo = self.repos.get(name)
        if repo is None or (repo.private and not self.is_allowed(request)):
            return _json({"error": "Repository not found"}, 401, {"X-Error-Code": "RepoNotFound"})
        return repo.at(revision) or _json({"error": "Revision not found"}, 404, {"X-Error-Code": "RevisionNotFound"})

    def is_allowed(self, request: Request) -> bool:
        return request.headers.get("Authorization") == f"Bearer {self.token}"

    def answer_static(self, request: Request, path: str) -> Response:
        data = self.static.get(path)
        return Response(status=404) if data is None else _file(request, data, {"ETag": f'"{len(data):x}-1"'})

    def answer_info(self, request: Request, repo: str, revision: str) -> Response:
        if isinstance(found := self.found(request, repo, revision or "main"), Response):
            return found
        return _json({"_id": "1", "id": repo, "sha": found[0], "siblings": [{"rfilename": name} for name in found[1]]})

    def answer_tree(self, request: Request, repo: str, revision: str) -> Response:
        if isinstance(found := self.found(request, repo, revision), Response):
            return found
        files = found[1].items()
        return _json([{"type": "file", "path": p, "size": len(data), "oid": _git_hash(data)} for p, data in files])

    def answer_resolve(self, request: Request, repo: str, revision: str, path: str) -> Response:
        if isinstance(found := self.found(request, repo, revision), Response):
            return found
        commit, data = {"X-Repo-Commit": found[0]}, found[1].get(path)
        if data is None:
            return Response(status=404, headers={"X-Error-Code": "EntryNotFound", **commit})
        if not path.endswith(LARGE):
            return _file(request, data, {"ETag": f'"{_git_hash(data)}"', **commit})
        oid = hashlib.sha256(data).hexdigest()
        self.large[oid] = data
        place = f"{self.endpoint.replace('127.0.0.1', 'localhost')}/storage/{oid}/{quote(path)}?signed=yes"
        linked = {"X-Linked-Etag": f'"{oid}"', "X-Linked-Size": str(len(data)), "ETag": f'"{oid}"'}
        return Response(status=302, headers={"Location": place, **linked, **commit})

    def answer_create(self, request: Request) -> Response:
        if not self.is_allowed(request):
            return _json({"error": "Invalid credentials"}, 401)
        asked = json.loads(request.data)
        name = f"{asked['organization']}/{asked['name']}"
        is_new = name not in self.repos
        if is_new:
            self.publish(name, {})
        return _json({"url": f"{self.endpoint}/datasets/{name}", "name": name}, 200 if is_new else 409)

    def answer_preupload(self, request: Request, repo: str, revision: str) -> Response:
        paths = [file["path"] for file in json.loads(request.data)["files"]]
        modes = {path: "lfs" if path.endswith(LARGE) else "regular" for path in paths}
        return _json({"files": [{"path": p, "uploadMode": mode, "shouldIgnore": False} for p, mode in modes.items()]})

    def answer_lfs_batch(self, request: Request, repo: str) -> Response:
        def actions(oid: str) -> dict[str, Any]:
            return {} if oid in self.large else {"actions": {"upload": {"href": f"{self.endpoint}/put/{oid}"}}}

        objects = json.loads(request.data)["objects"]
        return _json({"transfer": "basic", "objects": [{**entry, **actions(entry["oid"])} for entry in objects]})

    def answer_put(self, request: Request, oid: str) -> Response:
        self.large[oid] = request.data
        return Response()

    def answer_commit(self, request: Request, repo: str, revision: str) -> Response:
        files = dict(self.repos[repo].commits[-1][1])
        for line in request.data.splitlines():
            key, value = (entry := json.loads(line))["key"], entry["value"]
            if key == "file":
                files[value["path"]] = base64.b64decode(value["content"])
            elif key == "lfsFile":
                files[value["path"]] = self.large[value["oid"]]
            elif key == "deletedFile":
                files.pop(value["path"], None)
        sha = self.repos[repo].commit(files)
        url = f"{self.endpoint}/datasets/{repo}/commit/{sha}"
        return _json({"success": True, "commitOid": sha, "commitUrl": url})


def _json(value: Any, status: int = 200, headers: Mapping[str, str] | None = None) -> Response:
    return Response(json.dumps(value), status, headers, content_type="application/json")


def _file(request: Request, data: bytes, headers: Mapping[str, str]) -> Response:
    """A file, or the requested range."""
    response = Response(data, headers=headers, content_type="application/octet-stream")
    match = re.fullmatch(r"bytes=(\d+)-(\d*)", request.headers.get("Range", ""))
    if match is None:
        return response
    start, end = int(match[1]), min(int(match[2]) + 1 if match[2] else len(data), len(data))
    if start >= len(data):
        return Response(status=416, headers={"Content-Range": f"bytes */{len(data)}"})
    response.data, response.status_code = data[start:end], 206
    response.headers["Content-Range"] = f"bytes {start}-{end - 1}/{len(data)}"
    return response


def _git_hash(data: bytes) -> str:
    return hashlib.sha1(b"blob %d\0" % len(data) + data).hexdigest()


NAME = r"(?P<repo>[^/]+/[^/]+)"
ROUTES: list[tuple[str, Callable[..., Response]]] = [
    (r"/files/(?P<path>.+)", Hub.answer_static),
    (rf"/api/datasets/{NAME}(?:/revision/(?P<revision>.+))?", Hub.answer_info),
    (rf"/api/datasets/{NAME}/tree/(?P<revision>[^/]+)/?", Hub.answer_tree),
    (rf"/datasets/{NAME}/resolve/(?P<revision>[^/]+)/(?P<path>.+)", Hub.answer_resolve),
    (r"/storage/(?P<oid>[^/]+)/.+", lambda hub, request, oid: _file(request, hub.large[oid], {"ETag": f'"{oid}"'})),
    (r"/api/repos/create", Hub.answer_create),
    (r"/api/validate-yaml", lambda hub, request: _json({"errors": [], "warnings": []})),
    (rf"/api/datasets/{NAME}/preupload/(?P<revision>[^/]+)", Hub.answer_preupload),
    (rf"/datasets/{NAME}\.git/info/lfs/objects/batch", Hub.answer_lfs_batch),
    (r"/put/(?P<oid>[^/]+)", Hub.answer_put),
    (rf"/api/datasets/{NAME}/commit/(?P<revision>[^/]+)", Hub.answer_commit),
]


running_hub = Hub
"""A Hub that runs within a ``with`` block."""


def read_folder(folder: Path) -> dict[str, bytes]:
    """Path to content of the files in a folder that are not hidden."""
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file() and not path.name.startswith(".")]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}
