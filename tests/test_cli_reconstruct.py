"""``gcd reconstruct``: one scan that fails stops no other; no file of the user is replaced; answers are as scored."""

import contextlib
import json
import shutil
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from gcd_dataset.bodyfiles import write_measurements
from gcd_dataset.cli import main
from gcd_dataset.generator import Fitting, build_body, measure
from gcd_dataset.generator.body import neutral_shape
from gcd_dataset.generator.drape import drape_batch
from gcd_dataset.generator.garments import design_from_dict
from gcd_dataset.generator.garments.design import write_design
from gcd_dataset.generator.quality import sample_surface
from gcd_dataset.scoring.answers import AnswerReader
from gcd_dataset.scoring.bodies import Wearers
from tests.generator.test_silhouettes import cut_out
from tests.test_cli import exit_code, one_line

FAST = ["--resolution", "8", "--rounds", "0", "--device", "cpu", "--quiet"]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scan and pictures of a draped skirt, its design as proposal, and a copy of both with impossible measures."""
    folder, body = tmp_path_factory.mktemp("place"), build_body(neutral_shape())
    skirt = design_from_dict({"meta": {"bottom": "PencilSkirt"}})
    worn = Fitting(body, measure(body), resolution=8.0).worn(skirt)
    assert worn is not None
    [drape] = drape_batch([worn.job], device="cpu")
    cut_out(folder / "pictured", worn.job.box_mesh, drape.vertices, body)
    cut_out(folder / "photographs", worn.job.box_mesh, drape.vertices, body)
    (folder / "photographs" / "1.json").unlink()
    for name in ("skirt", "pictured", "giant"):
        (folder / "proposed" / name).mkdir(parents=True)
        write_design(skirt, folder / "proposed" / name / "0_design_params.yaml")
        points = sample_surface(drape.vertices, worn.job.box_mesh.faces, 4096, np.random.default_rng(0))
        np.save(folder / f"{name}.npy", points * [1, 1, 1, 9, 9, 9])  # normals of any length
    write_measurements(replace(measure(body), height=1000.0), folder / "proposed" / "giant" / "a_measurements.yaml")
    np.save(folder / "metres.npy", points / 100)
    return folder


def test_a_scan_that_fails_stops_no_other(place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scans = [str(place / name) for name in ("metres.npy", "giant.npy", "photographs", "skirt.npy", "pictured")]
    out = tmp_path / "out"
    out.mkdir()
    for earlier in ("giant_specification.json", "metres_design_params.yaml"):
        (out / earlier).write_text("of a scan that was read")
    assert main(["reconstruct", *scans, "--proposals", str(place / "proposed"), "--out", str(out), *FAST]) == 1
    rows = json.loads((out / "report.json").read_text())["scans"]
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 3
    assert "metres.npy: its largest extent is" in errors[0]
    assert "giant/a_measurements.yaml: height is 1000 cm" in errors[1]
    assert "photographs/1.json: missing: " in errors[2]
    assert ["error" in row for row in rows] == [True, True, True, False, False]
    assert rows[3]["mean_cm"] < 0.5
    assert rows[4]["iou"] > 0.95
    assert (out / "pictured_pictures.png").stat().st_size
    assert not (out / "metres_design_params.yaml").exists()
    assert AnswerReader().read(out).keys() == {"skirt", "pictured"}
    assert Wearers(out, "", {}).body_of("skirt") == str(out / "skirt.npy")  # not skirt.obj, the garment


def test_a_run_that_is_stopped_reports_the_scan_that_it_worked_on(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gcd_dataset.generator.search.search", Mock(side_effect=KeyboardInterrupt))
    with contextlib.suppress(KeyboardInterrupt, SystemExit):
        main(["reconstruct", str(place / "skirt.npy"), "--out", str(tmp_path), *FAST])
    [row] = json.loads((tmp_path / "report.json").read_text())["scans"]
    assert "stopped before" in row["error"]


def test_no_scan_is_replaced(place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy(place / "skirt.npy", tmp_path / "skirt.npy")
    before = (tmp_path / "skirt.npy").read_bytes()
    for scans, out, told in (
        ([tmp_path / "skirt.npy"], tmp_path, "lies in --out"),
        ([tmp_path / "skirt.npy", place / "skirt.npy"], tmp_path / "out", "named as"),
    ):
        assert exit_code(["reconstruct", *map(str, scans), "--out", str(out), *FAST]) == 2
        assert told in one_line(capsys.readouterr().err)
    assert (tmp_path / "skirt.npy").read_bytes() == before
