"""Reports of trained models, from files of results."""

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks.reconstruction.leaderboard import main, read_entries


def result(task: str, model: str, exact: float) -> dict[str, Any]:
    data = {"count": 4, "patterns": "ab" * 32, "ids": "cd" * 32, "recipe": {}}
    return {
        "task": task, "model": model, "scores": {"topology_exact": [exact, exact - 0.1, exact + 0.1]},
        "scores_of_kinds": {"skirt": {"topology_exact": 0.25}}, "data": {"train": data, "test": data},
        "minutes": 8.0, "steps": 10, "parameters": 1234, "device": "NVIDIA H200",
    }  # fmt: skip


def added(folder: Path, found: dict[str, Any]) -> int:
    path = folder / "report.json"
    path.write_text(json.dumps(found))
    return main(["--reports", str(folder), "--add", str(path), "--command", "python -m x", "--commit", "abc"])


def test_the_best_model_of_a_task_comes_first(tmp_path: Path) -> None:
    assert added(tmp_path, result("T0", "nearest", 0.2)) == 0
    assert added(tmp_path, result("T0", "panel_set", 0.7)) == 0
    assert [entry.model for entry in read_entries(tmp_path / "learning")] == ["panel_set", "nearest"]
    page, board = (tmp_path / "learning_T0.md").read_text(), (tmp_path / "leaderboard.md").read_text()
    for text in (page, board):
        assert text.index("| panel_set | 4 | 8.0 | 0.7 (0.6 to 0.8) |") < text.index("| nearest | 4 |")
    assert "| Of skirt | 0.25 |" in page
    assert "- command: `python -m x`" in page


def test_a_result_that_is_added_again_replaces_the_first(tmp_path: Path) -> None:
    added(tmp_path, result("T0", "nearest", 0.2))
    added(tmp_path, result("T0", "nearest", 0.3))
    assert [entry.scores["topology_exact"][0] for entry in read_entries(tmp_path / "learning")] == [0.3]


@pytest.mark.parametrize("text", ["{", "[]", '{"a": 1}', '{"scores": {}}'])
def test_another_file_is_refused(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "report.json").write_text(text)
    assert main(["--reports", str(tmp_path), "--add", str(tmp_path / "report.json"), "--command", "x"]) == 1
    assert "report.json" in capsys.readouterr().err
    assert not (tmp_path / "learning").exists()
