"""A loopback server for the part of the Hugging Face Hub's API that ``huggingface_hub`` uses; it can inject faults.

Large files are redirected to another address (``localhost`` for ``127.0.0.1``), as the Hub sends them to its storage.
"""

import base64
import contextlib
import hashlib
import json
import re
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote, urlsplit

LARGE = (".tar",)
"""Endings of files in the large-file storage."""


@dataclass(frozen=True)
class Request:
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

    ``drop``: close the connection without an answer. ``status``: answer with it. ``cut``: close the connection after
    so many bytes of the body; ``hold``: keep it open then, and send nothing more. ``flip``: change a bit of this byte
    of the file. ``whole``: ignore ``Range``.
    """

    pattern: str
    times: int = 1
    method: str = "GET"
    drop: bool = False
    status: int = 0
    headers: Mapping[str, str] = field(default_factory=dict)
    cut: int | None = None
    hold: bool = False
    flip: int | None = None
    whole: bool = False


@dataclass
class Repo:
    """A repository. Each commit is a hash and a map from path to content; the newest comes last."""

    commits: list[tuple[str, dict[str, bytes]]] = field(default_factory=list)
    private: bool = False

    def commit(self, files: Mapping[str, bytes]) -> str:
        """Add a commit; return its hash."""
        hashes = {name: _sha256(data) for name, data in files.items()}
        sha = hashlib.sha1(("".join(sha for sha, _ in self.commits) + json.dumps(hashes)).encode()).hexdigest()
        self.commits.append((sha, dict(files)))
        return sha

    def at(self, revision: str) -> tuple[str, dict[str, bytes]] | None:
        """Commit and files of the branch ``main`` or of a commit."""
        if revision == "main":
            return self.commits[-1] if self.commits else None
        return next((commit for commit in self.commits if commit[0] == revision), None)


class Hub:
    """The server, a context manager."""

    def __init__(self) -> None:
        self.repos: dict[str, Repo] = {}
        self.static: dict[str, bytes] = {}
        """Path to content of the files below ``/files/``, served as by a plain web server."""
        self.large: dict[str, bytes] = {}
        self.faults: list[Fault] = []
        self.counting = threading.Lock()
        """Held while a due fault is looked up and counted, since each request has its own thread."""
        self.log: list[Request] = []
        self.token = "hf_right"
        self._server: _Server | None = None
        self._port = 0

    @property
    def endpoint(self) -> str:
        return f"http://127.0.0.1:{self._port}"

    def publish(self, name: str, files: Mapping[str, bytes] | Path, *, private: bool = False) -> str:
        """Commit files, given as a mapping or a folder, to a repository; return the commit's hash."""
        content = read_folder(files) if isinstance(files, Path) else dict(files)
        repo = self.repos.setdefault(name, Repo(private=private))
        return repo.commit(content)

    def asked(self, pattern: str = "", *, method: str = "GET") -> list[Request]:
        """The requests with a matching path."""
        return [request for request in list(self.log) if request.method == method and re.search(pattern, request.path)]

    def start(self) -> None:
        """Listen; after ``stop``, on the same port as before."""
        handler = type("BoundHandler", (_Handler,), {"hub": self})
        self._server = _Server(("127.0.0.1", self._port), handler)
        self._port = self._server.server_address[1]
        threading.Thread(target=self._server.serve_forever, args=(0.01,), daemon=True).start()

    def stop(self) -> None:
        """Stop listening and break open connections."""
        if self._server is not None:
            self._server.shutdown()
            self._server.server_close()
            self._server.hang_up()
            self._server = None

    def __enter__(self) -> "Hub":
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = True
    block_on_close = False

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._lines: list[socket.socket] = []

    def process_request(self, request: Any, client_address: Any) -> None:
        self._lines.append(request)
        super().process_request(request, client_address)

    def hang_up(self) -> None:
        """Break open connections."""
        for line in self._lines:
            with contextlib.suppress(OSError):
                line.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore clients that disconnect."""


def read_folder(folder: Path) -> dict[str, bytes]:
    """Path to content of the files in a folder that are not hidden."""
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file() and not path.name.startswith(".")]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _git_hash(data: bytes) -> str:
    return hashlib.sha1(b"blob %d\0" % len(data) + data).hexdigest()


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    hub: Hub

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        """Log nothing."""

    def do_GET(self) -> None:
        self._serve()

    do_POST = do_PUT = do_GET  # noqa: N815 -- named by http.server

    def _serve(self) -> None:
        self.body = self._read_body()
        self.fault = self._due_fault()
        if self.fault is not None and self.fault.drop:
            self._note(0, 0)
            self.close_connection = True
            return
        if self.fault is not None and self.fault.status:
            self._answer(self.fault.status, b"", self.fault.headers)
            return
        self.route = unquote(urlsplit(self.path).path)
        for pattern, answer in ROUTES:
            if match := re.fullmatch(pattern, self.route):
                answer(self, **{name: value or "" for name, value in match.groupdict().items()})
                return
        self._json({"error": "not found"}, 404)

    def _read_body(self) -> bytes:
        if self.headers.get("Transfer-Encoding", "") != "chunked":
            return self.rfile.read(int(self.headers.get("Content-Length") or 0))
        body = b""
        while size := int(self.rfile.readline(), 16):
            body += self.rfile.read(size)
            self.rfile.readline()
        self.rfile.readline()
        return body

    def _due_fault(self) -> Fault | None:
        with self.hub.counting:
            for fault in self.hub.faults:
                if fault.times > 0 and fault.method == self.command and re.search(fault.pattern, unquote(self.path)):
                    fault.times -= 1
                    return fault
        return None

    def _json(self, value: Any, status: int = 200, headers: Mapping[str, str] | None = None) -> None:
        self._answer(status, json.dumps(value).encode(), {"Content-Type": "application/json", **(headers or {})})

    def _answer(self, status: int, body: bytes, headers: Mapping[str, str]) -> None:
        part = self._cut(body)
        self._note(status, len(part))  # before the answer: a test may read the log as soon as it has the answer
        self.send_response(status)
        for name, value in {"Content-Length": str(len(body)), **headers}.items():
            self.send_header(name, value)
        self.end_headers()
        with contextlib.suppress(OSError):
            self.wfile.write(part)
            if self.fault is not None and self.fault.hold:
                self.rfile.read(1)  # returns when the connection closes

    def _cut(self, body: bytes) -> bytes:
        cut = self.fault.cut if self.fault is not None else None
        if cut is not None and cut < len(body):
            self.close_connection = True
            return body[:cut]
        return body

    def _note(self, status: int, size: int) -> None:
        span, authorization = self.headers.get("Range", ""), self.headers.get("Authorization", "")
        self.hub.log.append(Request(self.command, self.path, span, status, size, authorization))

    def _file(self, data: bytes, headers: Mapping[str, str]) -> None:
        """Send a file, or the requested range."""
        if self.fault is not None and self.fault.flip is not None:
            data = _flipped(data, self.fault.flip)
        whole = self.fault is not None and self.fault.whole
        match = None if whole else re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
        if match is None:
            headers_sent = dict(self.fault.headers) if self.fault is not None else {}
            self._answer(200, data, {"Accept-Ranges": "none" if whole else "bytes", **headers_sent, **headers})
            return
        start, end = int(match[1]), min(int(match[2]) + 1 if match[2] else len(data), len(data))
        if start >= len(data):
            self._answer(416, b"", {"Content-Range": f"bytes */{len(data)}"})
            return
        headers_sent = {"Content-Range": f"bytes {start}-{end - 1}/{len(data)}", "Accept-Ranges": "bytes"}
        self._answer(206, data[start:end], headers_sent | dict(headers))

    def _repo_at(self, name: str, revision: str) -> tuple[str, dict[str, bytes]] | None:
        """Commit and files; ``None`` after an error response, if repository or revision are missing."""
        repo = self.hub.repos.get(name)
        allowed = repo is not None and (
            not repo.private or self.headers.get("Authorization") == f"Bearer {self.hub.token}"
        )
        if repo is None or not allowed:
            self._json({"error": "Repository not found"}, 401, {"X-Error-Code": "RepoNotFound"})
            return None
        found = repo.at(revision)
        if found is None:
            self._json({"error": "Revision not found"}, 404, {"X-Error-Code": "RevisionNotFound"})
        return found

    def static(self, path: str) -> None:
        data = self.hub.static.get(path)
        if data is None:
            self._answer(404, b"", {})
            return
        self._file(data, {"ETag": f'"{len(data):x}-1"'})

    def info(self, repo: str, revision: str) -> None:
        if (found := self._repo_at(repo, revision or "main")) is None:
            return
        siblings = [{"rfilename": name} for name in found[1]]
        facts = {"private": False, "gated": False, "disabled": False, "tags": [], "downloads": 0, "likes": 0}
        self._json({"_id": "1", "id": repo, "sha": found[0], "siblings": siblings, **facts}, headers=_at(found[0]))

    def tree(self, repo: str, revision: str, folder: str) -> None:
        if (found := self._repo_at(repo, revision)) is None:
            return
        names = [name for name in found[1] if not folder or name.startswith(f"{folder}/")]
        self._json([_entry(name, found[1][name]) for name in names])

    def resolve(self, repo: str, revision: str, path: str) -> None:
        if (found := self._repo_at(repo, revision)) is None:
            return
        data = found[1].get(path)
        if data is None:
            self._answer(404, b"", {"X-Error-Code": "EntryNotFound", **_at(found[0])})
        elif not path.endswith(LARGE):
            self._file(data, {"ETag": f'"{_git_hash(data)}"', **_at(found[0])})
        else:
            oid = _sha256(data)
            self.hub.large[oid] = data
            place = f"{self.hub.endpoint.replace('127.0.0.1', 'localhost')}/storage/{oid}/{quote(path)}?signed=yes"
            linked = {"X-Linked-Etag": f'"{oid}"', "X-Linked-Size": str(len(data)), "ETag": f'"{oid}"'}
            self._answer(302, b"", {"Location": place, **linked, **_at(found[0])})

    def storage(self, oid: str, path: str) -> None:
        self._file(self.hub.large[oid], {"ETag": f'"{oid}"'})

    def create(self) -> None:
        asked = json.loads(self.body)
        if self.headers.get("Authorization") != f"Bearer {self.hub.token}":
            self._json({"error": "Invalid credentials"}, 401)
            return
        name = f"{asked['organization']}/{asked['name']}"
        fresh = name not in self.hub.repos
        repo = self.hub.repos.setdefault(name, Repo())
        if fresh:
            repo.private = asked.get("visibility") == "private" or asked.get("private", False)
            repo.commit({})
        self._json({"url": f"{self.hub.endpoint}/datasets/{name}", "name": name}, 200 if fresh else 409)

    def validate(self) -> None:
        self._json({"errors": [], "warnings": []})

    def preupload(self, repo: str, revision: str) -> None:
        files = json.loads(self.body)["files"]
        modes = {file["path"]: "lfs" if file["path"].endswith(LARGE) else "regular" for file in files}
        self._json({"files": [{"path": p, "uploadMode": mode, "shouldIgnore": False} for p, mode in modes.items()]})

    def lfs_batch(self, repo: str) -> None:
        objects = []
        for entry in json.loads(self.body)["objects"]:
            there = entry["oid"] in self.hub.large
            actions = {} if there else {"upload": {"href": f"{self.hub.endpoint}/put/{entry['oid']}"}}
            objects.append({**entry, **({"actions": actions} if actions else {})})
        self._json({"transfer": "basic", "objects": objects})

    def put(self, oid: str) -> None:
        right = _sha256(self.body) == oid
        if right:
            self.hub.large[oid] = self.body
        self._answer(200 if right else 400, b"", {})

    def commit(self, repo: str, revision: str) -> None:
        there = self.hub.repos[repo]
        files = dict(there.commits[-1][1])
        for line in self.body.splitlines():
            key, value = (entry := json.loads(line))["key"], entry["value"]
            if key == "file":
                files[value["path"]] = base64.b64decode(value["content"])
            elif key == "lfsFile":
                files[value["path"]] = self.hub.large[value["oid"]]
            elif key == "deletedFile":
                files.pop(value["path"], None)
        sha = there.commit(files)
        self._json(
            {"success": True, "commitOid": sha, "commitUrl": f"{self.hub.endpoint}/datasets/{repo}/commit/{sha}"}
        )


def _at(commit: str) -> dict[str, str]:
    return {"X-Repo-Commit": commit}


def _entry(name: str, data: bytes) -> dict[str, Any]:
    entry: dict[str, Any] = {"type": "file", "path": name, "size": len(data), "oid": _git_hash(data)}
    if name.endswith(LARGE):
        entry["lfs"] = {"oid": _sha256(data), "size": len(data), "pointerSize": 130}
    return entry


def _flipped(data: bytes, place: int) -> bytes:
    return data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :]


NAME = r"(?P<repo>[^/]+/[^/]+)"
ROUTES: list[tuple[str, Callable[..., None]]] = [
    (r"/files/(?P<path>.+)", _Handler.static),
    (rf"/api/datasets/{NAME}(?:/revision/(?P<revision>.+))?", _Handler.info),
    (rf"/api/datasets/{NAME}/tree/(?P<revision>[^/]+)/?(?P<folder>.*)", _Handler.tree),
    (rf"/datasets/{NAME}/resolve/(?P<revision>[^/]+)/(?P<path>.+)", _Handler.resolve),
    (r"/storage/(?P<oid>[^/]+)/(?P<path>.+)", _Handler.storage),
    (r"/api/repos/create", _Handler.create),
    (r"/api/validate-yaml", _Handler.validate),
    (rf"/api/datasets/{NAME}/preupload/(?P<revision>[^/]+)", _Handler.preupload),
    (rf"/datasets/{NAME}\.git/info/lfs/objects/batch", _Handler.lfs_batch),
    (r"/put/(?P<oid>[^/]+)", _Handler.put),
    (rf"/api/datasets/{NAME}/commit/(?P<revision>[^/]+)", _Handler.commit),
]


@contextlib.contextmanager
def running_hub() -> Iterator[Hub]:
    """A server that runs within a ``with`` block."""
    with Hub() as hub:
        yield hub
