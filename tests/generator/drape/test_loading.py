"""The kernel cache, log lines about waiting, and cancelled drapes."""

import os
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
import warp as wp
from warp._src import context

from gcd_dataset.generator.drape import (
    DrapeJob,
    drape_all,
    kernels_compiled,
    log_drape_time,
    seconds_per_garment,
    seconds_to_drape,
)
from gcd_dataset.generator.drape import device as devices
from gcd_dataset.generator.drape.kernels import carry
from gcd_dataset.generator.drape.solver import Solver
from tests.helpers import SIZE, far_ball, patch


def started(home: Path | str, code: str) -> subprocess.CompletedProcess[str]:
    """Run ``code`` in a new interpreter with another home folder."""
    bare = {key: value for key, value in os.environ.items() if key not in ("WARP_CACHE_PATH", "XDG_CACHE_HOME")}
    environment = {**bare, "HOME": str(home), "TMPDIR": str(home) if Path(home).is_dir() else "/tmp"}
    return subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)


START = "from gcd_dataset.generator.drape import resolve_device; print(resolve_device('cpu'), resolve_device('cpu'))"


def test_kernels_go_to_a_temporary_folder_if_the_home_cannot_be_written(tmp_path: Path) -> None:
    """A single warning names the folder and ``WARP_CACHE_PATH``."""
    home = tmp_path / "home"
    home.mkdir()
    (home / ".cache").write_text("no folder")
    done = started(home, START)
    assert (done.returncode, done.stdout) == (0, "cpu cpu\n"), done.stderr
    [line] = done.stderr.splitlines()
    kept = home / f"gcd_dataset-kernels-{os.getuid()}"
    assert line.startswith(f"compiled kernels are kept in {kept}")
    assert "WARP_CACHE_PATH" in line
    assert stat.S_IMODE(kept.stat().st_mode) == 0o700


def test_no_kernels_in_a_folder_that_others_may_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled kernels are executed: other users must not replace them."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    own = devices._private_folder()
    assert devices._private_folder() == own
    own.chmod(0o777)
    assert devices._private_folder() != own


def test_compiling_is_logged_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    assert devices.resolve_device("cpu") == "cpu"
    monkeypatch.setattr(devices, "_loaded", set())
    devices.load_kernels("test", carry, device="cpu")
    caplog.clear()
    monkeypatch.setattr(devices, "_loaded", set())
    devices.load_kernels("test", carry, device="cpu")
    assert not caplog.records
    monkeypatch.setattr(devices, "_loaded", set())
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    assert not kernels_compiled("cpu")
    devices.load_kernels("test", carry, device="cpu")
    assert [record.getMessage().split(",")[0] for record in caplog.records] == [
        "compiling the kernels of the test for cpu"
    ]
    assert caplog.records[0].levelname == "WARNING"  # shown by a program without logging setup


def test_estimates_grow_with_garments_and_finer_meshes(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("gcd_dataset.generator.drape.loading.cores", lambda: 2)
    assert seconds_to_drape(5, "cpu", 1.0) == 3 * seconds_per_garment("cpu", 1.0)
    assert seconds_per_garment("cpu", 2.0) < seconds_per_garment("cpu", 1.0) / 2.5
    with caplog.at_level("INFO", logger="gcd_dataset"):
        log_drape_time(1, "cpu", 5.0)
        assert not caplog.records
        log_drape_time(40, "cpu", 1.0)
    assert "40 garments at 1 cm on this CPU takes about 2 min" in caplog.text


def test_closing_the_iterator_stops_running_drapes(monkeypatch: pytest.MonkeyPatch) -> None:
    """The garments after the first would fall for hundreds of frames."""
    frames: list[float] = []
    frame = Solver.frame

    def counted(solver: Solver, *between: Any) -> None:
        frames.append(time.perf_counter())
        frame(solver, *between)

    monkeypatch.setattr(Solver, "frame", counted)
    mesh = patch(40, 40, origin=(0.0, 1e5, 0.0))

    def jobs() -> Iterator[DrapeJob]:
        yield DrapeJob(patch(2, 2, origin=(0.0, -50.0, 0.0)), far_ball(), SIZE)
        yield from [DrapeJob(mesh, far_ball(), SIZE)] * 3

    before = set(threading.enumerate())
    drapes = drape_all(jobs(), device="cpu", at_once=2)
    assert isinstance(drapes, Generator)
    next(drapes)
    closed = time.perf_counter()
    drapes.close()
    assert set(threading.enumerate()) <= before
    assert sum(moment > closed for moment in frames) < 50  # one for each thread, more if this thread has to wait


def test_a_copy_to_the_host_does_not_depend_on_captures_of_other_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Warp keeps one capture for all threads of a CPU; another thread may end it between two looks."""
    devices.resolve_device("cpu")
    ones = wp.full(3, 1, dtype=int, device="cpu")
    monkeypatch.setattr(context.runtime, "_apic_capture", object())
    found = devices.to_host(ones)
    monkeypatch.undo()
    ones.fill_(2)
    assert found.tolist() == [1, 1, 1]
