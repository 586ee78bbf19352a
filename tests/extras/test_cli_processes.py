"""``gcd`` as a process: signals, kills and a full disk."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from gcd_dataset.cli import main
from gcd_dataset.generator.maker import make
from gcd_dataset.shards.notes import stored_samples
from gcd_dataset.shards.writer import Draft
from gcd_dataset.spec import write_pattern
from tests.helpers import wait_until
from tests.shards.folders import fill
from tests.test_cli import SKIRT, one_line

REPOSITORY = Path(__file__).resolve().parents[2]
FLAT = ["--stage", "pattern", "--quiet"]


def test_a_signal_keeps_finished_samples(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """``timeout`` sends SIGTERM to the process and to its group; the second may come late."""
    command = [sys.executable, "-m", "gcd_dataset", "generate", str(tmp_path), "--count", "100000", *FLAT]
    process = subprocess.Popen([*command, "--workers", "2"], stderr=subprocess.PIPE, text=True, start_new_session=True)
    wait_for_samples(tmp_path, 3, process)
    os.killpg(process.pid, signal.SIGTERM)
    assert process.stderr is not None
    said = process.stderr.readline()
    process.send_signal(signal.SIGTERM)
    said += process.communicate(timeout=60)[1]
    assert process.returncode == 143, said
    assert "the same command continues from there" in one_line(said)
    wait_until(lambda: not of_session(process.pid))
    assert [path.name for path in tmp_path.iterdir()] == [path.name for path in drafts_in(tmp_path)]
    there = samples_in_work(tmp_path)
    assert there >= 3
    add = Draft.add

    def one_more(draft: Draft, *arguments: Any, **options: Any) -> None:
        add(draft, *arguments, **options)
        raise KeyboardInterrupt

    monkeypatch.setattr(Draft, "add", one_more)
    assert main([*command[3:], "--workers", "0"]) == 130
    assert samples_in_work(tmp_path) == there + 1


def test_workers_end_with_a_run_that_is_killed(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "gcd_dataset", "generate", str(tmp_path), "--count", "100000", "--workers", "2"]
    process = subprocess.Popen([*command, *FLAT], stderr=subprocess.DEVNULL, start_new_session=True)
    wait_for_samples(tmp_path, 3, process)
    assert len(of_session(process.pid)) >= 3
    process.kill()
    process.wait()
    wait_until(lambda: not of_session(process.pid))
    assert main(["generate", str(tmp_path), "--count", "3", *FLAT]) == 0  # keeps the finished samples


def wait_for_samples(folder: Path, count: int, process: subprocess.Popen[Any]) -> None:
    """Wait until a run has stored ``count`` samples in its first shard."""
    while samples_in_work(folder) < count:
        assert process.poll() is None, "it has ended"
        time.sleep(0.05)


def samples_in_work(folder: Path) -> int:
    """Whole samples in the draft of the first shard."""
    return sum(1 for path in drafts_in(folder) for _ in stored_samples(path, damaged=True))


def drafts_in(folder: Path) -> list[Path]:
    return [*folder.glob(".train-00000-of-*.draft")]


def of_session(session: int) -> list[int]:
    """Running processes of a session."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, of = stat.read_text().rpartition(")")[2].split()[:4]
        except OSError:
            continue  # just ended
        if int(of) == session and state != "Z":
            found.append(int(stat.parent.name))
    return found


SIGNALLED = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from gcd_dataset.generator.drape.solver import Solver
frame = Solver.replay_frame
def signalled(solver, *between):
    frame(solver, *between)
    Solver.replay_frame = frame
    os.kill(os.getpid(), signal.SIGINT)
Solver.replay_frame = signalled
from gcd_dataset.cli import main
code = main(sys.argv[1:])
assert Solver.replay_frame is frame
sys.exit(code)
"""


def test_ctrl_c_between_time_steps_ends_a_drape(tmp_path: Path) -> None:
    spec = tmp_path / "garment_specification.json"
    write_pattern(make(1, 0, SKIRT).pattern, spec)
    command = [sys.executable, "-c", SIGNALLED, "drape", str(spec), "--out", str(tmp_path / "out")]
    options = ["--resolution", "5", "--device", "cpu", "--quiet"]
    done = subprocess.run([*command, *options], capture_output=True, text=True, check=False)
    assert done.returncode == 130, done.stderr
    assert "gcd drape: stopped" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr
    assert not list((tmp_path / "out").glob("*"))


def test_a_full_disk_ends_an_export_to_hdf5(tmp_path: Path) -> None:
    """The disk fills up at any byte: in the layout, in the arrays, in the final metadata."""
    data = fill(tmp_path / "data", range(3))
    assert main(["export", str(data), "--hdf5", str(tmp_path / "a.h5"), "--quiet"]) == 0
    size = (tmp_path / "a.h5").stat().st_size
    (tmp_path / "a.h5").unlink()
    program = f"""
import resource, sys
from pathlib import Path
from gcd_dataset.cli import main
for room in ({size // 20}, {size // 2}, {size - 1}):
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))
    assert main(["export", {str(data)!r}, "--hdf5", {str(tmp_path / "a.h5")!r}, "--quiet"]) == 1
"""
    done = subprocess.run([sys.executable, "-c", program], cwd=REPOSITORY, capture_output=True, text=True, check=False)
    message = f"gcd export: {tmp_path / 'a.h5'}: cannot be written (File too large): make room there"
    assert (done.returncode, [line[: len(message)] for line in done.stderr.splitlines()]) == (0, 3 * [message])
    assert [path.name for path in tmp_path.iterdir()] == ["data"]
