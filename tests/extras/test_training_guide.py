"""The programs of docs/training.md run verbatim: two ranks see each garment once per epoch, stopped or not."""

import ast
import re
import sys
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

import pytest

from tests.extras.guide import ROOT, blocks_of, run

pytest.importorskip("accelerate", reason="the frameworks are not installed: make test-extras")
pytest.importorskip("lightning", reason="the frameworks are not installed: make test-extras")

HERE = Path(__file__).resolve().parent
N, RANKS, EPOCHS = 48, 2, 2
TORCHRUN = ["torchrun", "--standalone", "--nproc-per-node", str(RANKS), "--log-dir", "logs", "--redirects", "3"]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the garments and programs of the guide."""
    workspace = tmp_path_factory.mktemp("guide")
    for block in blocks_of(ROOT / "docs" / "training.md"):
        if block.language == "sh":
            for command in block.commands():
                run(workspace, *command)
        elif block.title:
            (workspace / block.title).write_text(block.text)
    return workspace


@pytest.fixture
def workspace(made: Path, tmp_path: Path) -> Path:
    """A fresh copy for one training."""
    (tmp_path / "garments").symlink_to(made / "garments")
    for program in made.glob("*.py"):
        (tmp_path / program.name).write_text(program.read_text())
    return tmp_path


def steps_of(lines: list[str]) -> dict[int, list[tuple[float, list[int]]]]:
    """The (loss, garments) of each rank, by step."""
    found = defaultdict(list)
    for line in lines:
        if match := re.fullmatch(r"(\d+) (\S+) (\[.*\])", line.removeprefix("train ")):
            found[int(match[1])].append((float(match[2]), ast.literal_eval(match[3])))
    return {step: sorted(ranks, key=lambda rank: rank[1]) for step, ranks in found.items()}


def assert_each_once(steps: dict[int, Any], count: int, ranks: int) -> None:
    """Assert that each garment comes once per epoch, and that all ranks take part in each step."""
    each = len(steps) // EPOCHS
    for epoch in range(EPOCHS):
        taken = [steps[step] for step in range(epoch * each + 1, (epoch + 1) * each + 1)]
        assert all(len(turn) == ranks for turn in taken)
        assert Counter(n for turn in taken for _, numbers in turn for n in numbers) == Counter(range(count))


@pytest.mark.parametrize(
    ("program", "command", "ranks", "count", "stops"),
    [
        ("plain.py", [sys.executable], 1, N, (4,)),
        ("ddp.py", TORCHRUN, RANKS, N, (5,)),
        ("lit.py", [sys.executable], RANKS, 40, (3,)),
        ("acc.py", TORCHRUN, RANKS, N, (5,)),
    ],
)
def test_a_stopped_and_resumed_training_equals_an_uninterrupted_one(
    workspace: Path, program: str, command: list[str], ranks: int, count: int, stops: tuple[int, ...]
) -> None:
    told = run(workspace, *command, program)
    whole = steps_of(told)
    assert_each_once(whole, count, ranks)
    # Complete also in the first epoch, after Lightning's sanity check of two batches.
    validated = {name: seen for name, seen in counted(told).items() if name.startswith("validate")}
    expected = {f"validate {epoch}": Counter(range(count, N)) for epoch in range(EPOCHS)}
    assert validated == (expected if program == "lit.py" else {})
    for checkpoint in ("plain.pt", "ddp.pt"):
        (workspace / checkpoint).unlink(missing_ok=True)
    for folder in ("lit", "acc"):
        if (workspace / folder).exists():
            (workspace / folder).rename(workspace / f"{folder}-whole")
    parts: dict[int, Any] = {}
    for stop in (*stops, None):
        told = run(workspace, *command, program, *([] if stop is None else [str(stop)]))
        begun = len(parts)
        offset = begun if program == "acc.py" else 0  # acc.py counts the steps of this run
        parts |= {step + offset: ranks for step, ranks in steps_of(told).items()}
        assert len(parts) == (len(whole) if stop is None else begun + stop if program == "acc.py" else stop)
    assert parts == whole  # bitwise equal losses, and garments


def counted(lines: list[str]) -> dict[str, Counter[int]]:
    """How often each garment is printed, by the label before its batch."""
    found: dict[str, Counter[int]] = defaultdict(Counter)
    for line in lines:
        if match := re.fullmatch(r"(.*?) ?(\[[\d, ]*\])", line):
            found[match[1]].update(ast.literal_eval(match[2]))
    return found


def test_a_prepared_loader_yields_each_garment_once(workspace: Path) -> None:
    seen = counted(run(workspace, *TORCHRUN, "prepared.py"))
    assert seen == {str(epoch): Counter(range(N)) for epoch in range(EPOCHS)}


def test_arrow_holds_each_garment_once(workspace: Path) -> None:
    numbers = [int(line.split()[0]) for line in run(workspace, *TORCHRUN, "hf.py") if line[:1].isdigit()]
    assert sorted(numbers) == list(range(N))


def test_accelerate_splits_unsplit_loaders(workspace: Path) -> None:
    """Each rank checks its loaders, then prints one line."""
    lines = run(workspace, *TORCHRUN, str(HERE / "under_accelerate.py"), "garments")
    passed = {line for line in lines if line.endswith("every loader yielded each garment once")}
    assert passed == {f"rank {rank}: every loader yielded each garment once" for rank in range(2)}


def test_lightning_does_not_split_a_split_loader(workspace: Path) -> None:
    seen = counted(run(workspace, *TORCHRUN, str(HERE / "under_lightning.py"), "garments"))
    names = [f"{kind} {epoch}" for kind in ("train", "validate", "fabric") for epoch in range(EPOCHS)]
    assert seen == {name: Counter(range(N)) for name in names}
