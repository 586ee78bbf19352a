"""``gcd show`` in a process of its own, with timed requests."""

import contextlib
import json
import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from http.client import HTTPConnection
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from benchmarks.viewing.workload import KIND, OUTCOME

PAUSE = 0.3  # s between garments: a glance
POLL = 0.5  # s


class Cost(NamedTuple):
    """The time of a request [s]."""

    wall: float
    cpu: float
    """Of the server, with its background work."""


class Shown:
    """A running viewer; times are in seconds."""

    def __init__(self, address: str, started: float, process: "subprocess.Popen[str]") -> None:
        self._port, self._token, self._process = urlsplit(address).port, urlsplit(address).query, process
        self._get("/")
        found = self._find(position=_start_of(self._get("/").decode()))
        self._garment(found["position"])
        self.since_start = time.perf_counter() - started
        """From the command to the first garment's page."""
        self.cpu_since_start = self._cpu_seconds()
        """CPU time of the server until then."""
        self._rank = found["rank"]
        self._shown, self._known = time.perf_counter(), math.nan
        self._watch = threading.Thread(target=self._watch_tags, daemon=True)
        self._watch.start()

    def timed_next(self) -> Cost:
        """The time to the page of the next garment, which was made ahead."""
        self._rank += 1
        return self._timed(rank=self._rank)

    def timed_jump(self, index: int) -> Cost:
        """The time to the page of a garment by its index."""
        return self._timed(text=index)

    def _timed(self, **query: Any) -> Cost:
        time.sleep(PAUSE)
        cpu, began = self._cpu_seconds(), time.perf_counter()
        self._garment(self._find(**query)["position"])
        return Cost(time.perf_counter() - began, self._cpu_seconds() - cpu)

    def timed_filter(self, rank: int) -> float:
        """The time to the answer of a filter."""
        began = time.perf_counter()
        self._find(rank=rank, kind=KIND, outcome=OUTCOME)
        return time.perf_counter() - began

    def wait_for_tags(self) -> float:
        """Wait until all tags are known; the time since the first page."""
        self._watch.join()
        return self._known

    def _watch_tags(self) -> None:
        while (facets := json.loads(self._get("/facets")))["known"] < facets["count"] or facets["reading"]:
            time.sleep(POLL)
        self._known = time.perf_counter() - self._shown

    @property
    def peak_memory(self) -> float:
        """The peak of the process's resident memory [MB]."""
        status = Path(f"/proc/{self._process.pid}/status").read_text()
        (line,) = [line for line in status.splitlines() if line.startswith("VmHWM")]
        return int(line.split()[1]) / 1e3

    def _cpu_seconds(self) -> float:
        fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def _find(self, **query: Any) -> dict[str, Any]:
        words = "&".join(f"{name}={str(value).replace(' ', '+')}" for name, value in query.items())
        found: dict[str, Any] = json.loads(self._get(f"/find?{words}"))
        return found

    def _garment(self, position: int) -> None:
        self._get(f"/garment?position={position}&side=0")

    def _get(self, path: str) -> bytes:
        connection = HTTPConnection("127.0.0.1", self._port, timeout=600)
        connection.request("GET", f"{path}{'&' if '?' in path else '?'}{self._token}")
        answer = connection.getresponse()
        content = answer.read()
        connection.close()
        if answer.status != 200:
            raise RuntimeError(f"{path}: {answer.status}: {content.decode()}")
        return content


@contextlib.contextmanager
def started(folder: Path, index: int, environment: Mapping[str, str]) -> Iterator[tuple[str, float, Any]]:
    """Start ``gcd show``: its address, the time of the command, and its process."""
    command = [sys.executable, "-m", "gcd_dataset", "show", str(folder), "--index", str(index)]
    began = time.perf_counter()
    with subprocess.Popen(command, env=dict(environment), stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield process.stdout.readline().split()[0], began, process
        finally:
            process.terminate()


@contextlib.contextmanager
def shown(folder: Path, index: int, environment: Mapping[str, str]) -> Iterator[Shown]:
    """``gcd show`` with the garment at ``index`` on its page."""
    with started(folder, index, environment) as (address, began, process):
        yield Shown(address, began, process)


def _start_of(page: str) -> int:
    return int(page.partition('"start":')[2].partition(",")[0])
