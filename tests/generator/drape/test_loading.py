"""The kernel cache, log lines about waiting, cancelled drapes, and the signatures of kernels."""

import ast
import os
import re
import stat
import threading
import time
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
import warp as wp
from warp._src import context

from gcd_dataset.generator import device as devices
from gcd_dataset.generator.drape import DrapeJob, drape_all
from gcd_dataset.generator.drape.kernels import place
from gcd_dataset.generator.drape.solver import Solver
from tests.helpers import SIZE, far_ball, patch


def test_kernels_go_to_a_temporary_folder_if_the_home_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A single warning names the folder and ``WARP_CACHE_PATH``."""
    (tmp_path / ".cache").write_text("no folder")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path / ".cache"))
    monkeypatch.setattr(wp, "init", lambda: None)
    devices._init_warp.__wrapped__()
    kept = tmp_path / f"gcd_dataset-kernels-{os.getuid()}"
    [line] = [record.getMessage() for record in caplog.records]
    assert line.startswith(f"compiled kernels are kept in {kept}")
    assert "WARP_CACHE_PATH" in line
    assert wp.config.kernel_cache_dir == str(kept)
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
    devices.load_kernels("test", place, device="cpu")
    caplog.clear()
    monkeypatch.setattr(devices, "_loaded", set())
    devices.load_kernels("test", place, device="cpu")
    assert not caplog.records
    monkeypatch.setattr(devices, "_loaded", set())
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    devices.load_kernels("test", place, device="cpu")
    [record] = caplog.records
    assert record.getMessage().startswith("compiling the kernels of the test for cpu,")
    assert record.levelname == "WARNING"  # shown by a program without logging setup


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


KERNELS = Path(__file__).resolve().parents[3] / "generator" / "drape" / "kernels"
WRITERS = ("atomic_add", "atomic_max", "atomic_min", "atomic_cas", "atomic_exch")
MOST_ARGUMENTS = 14
PASSES = {"add_push": 0, "add_weight": 0, "take_push": 0, "take_contact_weight": 0, "mark": 1, "take_slot": 0}
"""Device function to the index of the argument that it writes."""


def kernels() -> list[tuple[str, ast.FunctionDef, list[str]]]:
    """Name, syntax tree and source lines of every kernel."""
    return [
        (f"{path.stem}.{node.name}", node, path.read_text().splitlines())
        for path in sorted(KERNELS.glob("*.py"))
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.FunctionDef) and any(ast.unparse(d) == "wp.kernel" for d in node.decorator_list)
    ]


def groups_of(kernel: ast.FunctionDef, lines: list[str]) -> dict[str, str]:
    """The comment above each argument."""
    groups, group, argument_lines = {}, "", {arg.lineno: arg.arg for arg in kernel.args.args}
    for number in range(kernel.lineno, kernel.body[0].lineno):
        if comment := re.fullmatch(r"\s*# (.*)", lines[number - 1]):
            group = comment[1]
        if number in argument_lines:
            groups[argument_lines[number]] = group
    return groups


def root_of(node: ast.expr) -> str:
    """The variable of an expression like ``a.b[i]``."""
    while isinstance(node, ast.Subscript | ast.Attribute):
        node = node.value
    return node.id if isinstance(node, ast.Name) else ""


def written_by(kernel: ast.FunctionDef) -> set[str]:
    """Variables with elements that a kernel writes, directly or by ``atomic_…`` and the functions of ``PASSES``."""
    found = set()
    for node in ast.walk(kernel):
        targets: list[ast.expr] = []
        if isinstance(node, ast.Assign):
            targets = [target for target in node.targets if isinstance(target, ast.Subscript)]
        elif isinstance(node, ast.AugAssign):
            targets = [node.target] if isinstance(node.target, ast.Subscript | ast.Attribute) else []
        elif isinstance(node, ast.Call):
            name = ast.unparse(node.func).rpartition(".")[2]
            written = 0 if name in WRITERS else PASSES.get(name)
            targets = [] if written is None else [node.args[written]]
        found |= {root_of(target) for target in targets}
    return found


@pytest.mark.parametrize(("name", "kernel", "lines"), kernels(), ids=[name for name, *_ in kernels()])
def test_kernels_have_few_arguments_and_written_ones_stand_under_out(
    name: str, kernel: ast.FunctionDef, lines: list[str]
) -> None:
    assert len(kernel.args.args) <= MOST_ARGUMENTS, f"{name} has {len(kernel.args.args)} arguments"
    groups = groups_of(kernel, lines)
    written = written_by(kernel) & set(groups)
    assert written <= {argument for argument, group in groups.items() if group.endswith("out")}, name
    for argument in written:
        if isinstance(node := next(a for a in kernel.args.args if a.arg == argument).annotation, ast.Name):
            assert node.id not in ("Cloth", "World"), f"{name} writes the model"
