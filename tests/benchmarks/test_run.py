"""The runner prints figures and writes a report."""

import argparse
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks import run
from benchmarks.cases.figures import Figure, Measured, jpeg_file


@pytest.fixture(autouse=True)
def tape(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """``tape`` is the only case; reports of the tree go to a temporary folder."""

    def add_arguments(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--length", type=float)

    def measure(options: argparse.Namespace) -> Measured:
        return Measured([Figure("girth", 2 * options.length, "cm")], [{"body": "doll", "cm": options.length}])

    case = SimpleNamespace(__doc__="A case.", add_arguments=add_arguments, run=measure)
    monkeypatch.setattr(run, "CASES", {"tape": "tape"})
    monkeypatch.setattr(run, "load_case", lambda name: case)
    monkeypatch.setattr(run, "REPORTS", tmp_path / "reports")


def test_figures_are_printed_and_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "tape.md"
    assert run.main(["tape", "--length", "3", "--report", str(path)]) == 0
    assert capsys.readouterr().out == "tape.girth 6 cm\n"
    text = path.read_text()
    assert "`python -m benchmarks.run tape --length 3 --report" in text
    assert "| tape.girth | 6 | cm |" in text
    assert "| doll | 3 |" in text
    assert "commit: " in text


def test_a_report_in_the_tree_is_replaced_only_on_request(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = tmp_path / "reports" / "tape.md"
    kept.parent.mkdir()
    kept.write_text("of a full run")
    assert run.main(["tape", "--length", "3"]) == 0
    assert kept.read_text() == "of a full run"
    told = capsys.readouterr()
    assert told.out == "tape.girth 6 cm\n"
    assert f"no report is written: --keep writes {kept}" in told.err
    assert run.main(["tape", "--length", "3", "--keep"]) == 0
    assert "| tape.girth | 6 | cm |" in kept.read_text()


def test_a_jpeg_has_no_other_ending() -> None:
    assert jpeg_file("drapes.JPG") == Path("drapes.JPG")
    with pytest.raises(argparse.ArgumentTypeError, match=r"drapes.png: the picture is a JPEG"):
        jpeg_file("drapes.png")
