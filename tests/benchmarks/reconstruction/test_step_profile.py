"""Operations of a step are counted, views are not."""

from pathlib import Path

import pytest
import torch

from benchmarks.reconstruction.step_profile import Operations, main


def test_products_and_sums_are_counted_and_views_are_not() -> None:
    factor = torch.ones(3, 4, requires_grad=True)
    with Operations() as operations:
        torch.autograd.backward((torch.ones(2, 3) @ factor).t()[0].sum())
    # Forward: ones, mm, sum. Backward: ones_like of the loss, the gradient of [0], mm.
    counts = operations.counts
    assert counts["aten::mm"] == 2
    assert counts["aten::sum"] == 1
    assert not {"aten::t", "aten::select", "aten::expand"} & set(counts)


def test_a_step_is_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flags = ["--smoke", "--resolution", "6", "--steps", "1", "--device", "cpu", "--data", str(tmp_path)]
    assert main(["panel_set", *flags]) == 0
    said = capsys.readouterr().out
    assert "panel_set: " in said
    assert " ms a step of 8 on cpu" in said
    assert int(said.splitlines()[1].split()[0]) > 100  # operations
    assert main(["nearest", *flags]) == 1
    assert "nearest has no training" in capsys.readouterr().err
    assert main(["panel_set", "--smoke", "--steps", "1", "--device", "cpu", "--source", str(tmp_path / "none")]) == 1
    assert "none" in capsys.readouterr().err
