"""The runner prints figures and leaves a report."""

import argparse
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks import run
from benchmarks.cases.figures import Figure, Measured


def test_figures_are_printed_and_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def add_arguments(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--length", type=float)

    def measure(options: argparse.Namespace) -> Measured:
        return Measured([Figure("girth", 2 * options.length, "cm")], [{"body": "doll", "cm": options.length}])

    case = SimpleNamespace(__doc__="A case.", add_arguments=add_arguments, run=measure)
    monkeypatch.setattr(run, "CASES", {"tape": "tape"})
    monkeypatch.setattr(run, "load_case", lambda name: case)
    path = tmp_path / "tape.md"
    assert run.main(["tape", "--length", "3", "--report", str(path)]) == 0
    assert capsys.readouterr().out == "tape.girth 6 cm\n"
    text = path.read_text()
    assert "`python -m benchmarks.run tape --length 3 --report" in text
    assert "| tape.girth | 6 | cm |" in text
    assert "| doll | 3 |" in text
    assert "commit: " in text
