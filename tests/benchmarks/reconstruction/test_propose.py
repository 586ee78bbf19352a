"""What the kept weights propose for a scan, and what ``gcd reconstruct`` makes of it."""

import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from benchmarks.reconstruction.models import picture_parameters
from benchmarks.reconstruction.propose import WEIGHTS, main, network
from gcd_dataset.cli import main as gcd
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator import Fitting, build_body, measure, read_design
from gcd_dataset.generator.body import neutral_shape
from gcd_dataset.generator.drape import drape_batch
from gcd_dataset.generator.garments import design_from_dict
from gcd_dataset.generator.quality import sample_surface
from gcd_dataset.spec import read_pattern
from tests.benchmarks.reconstruction.toys import small


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Points of a pencil skirt that the neutral body wears."""
    body = build_body(neutral_shape())
    design = design_from_dict({"meta": {"bottom": "PencilSkirt", "wb": "StraightWB"}, "pencil-skirt": {"length": 0.5}})
    worn = Fitting(body, measure(body), resolution=3.0).worn(design)
    assert worn is not None
    [drape] = drape_batch([worn.job], device="cpu")
    path = tmp_path_factory.mktemp("scans") / "skirt.npy"
    np.save(path, sample_surface(drape.vertices, worn.job.box_mesh.faces, 8192, np.random.default_rng(0)))
    return path


def test_a_skirt_is_proposed_and_draped_where_the_skirt_was(scan: Path, tmp_path: Path) -> None:
    """A scan that cannot be read costs the other nothing."""
    proposed, out, bad = tmp_path / "proposed", tmp_path / "out", tmp_path / "bad.npy"
    bad.write_bytes(b"no array")
    assert main([str(bad), str(scan), "--count", "4", "--out", str(proposed), "--device", "cpu"]) == 1
    first = read_design(proposed / "skirt" / "00_design_params.yaml")
    assert (first.meta.upper, first.meta.bottom and first.meta.bottom.value) == (None, "PencilSkirt")
    flags = ["--proposals", str(proposed), "--rounds", "0", "--resolution", "6", "--device", "cpu", "--quiet"]
    assert gcd(["reconstruct", str(bad), str(scan), *flags, "--out", str(out)]) == 1
    missed, found = json.loads((out / "report.json").read_text())["scans"]
    assert "bad.npy: cannot be read" in missed["error"]
    assert found["outcome"] == "SETTLED"
    assert found["mean_cm"] < 1.5
    assert {panel.label for panel in read_pattern(out / "skirt_specification.json").panels}
    assert (out / "skirt.ply").stat().st_size
    assert read_design(out / "skirt_design_params.yaml").meta == first.meta


def test_a_sparse_scan_has_proposals(scan: Path, tmp_path: Path) -> None:
    """Fewer points than the network makes regions of."""
    np.save(tmp_path / "sparse.npy", np.load(scan)[:200])
    assert main([str(tmp_path / "sparse.npy"), "--count", "1", "--out", str(tmp_path / "out"), "--device", "cpu"]) == 0


def test_designs_are_proposed_for_photographs_without_cameras(tmp_path: Path) -> None:
    """By weights of a network that sees pictures; a folder without any costs the other nothing."""
    net, weights = small("picture_parameters"), tmp_path / "T2.pt"
    torch.save(net.state_dict(), weights)
    sizes = picture_parameters.SMALL
    card = {"model": "picture_parameters", "sizes": sizes, "sha256": hashlib.sha256(weights.read_bytes()).hexdigest()}
    weights.with_suffix(".json").write_text(json.dumps(card))
    for name in ("none", "coat"):
        (tmp_path / name).mkdir()
    Image.new("RGB", (300, 200)).save(tmp_path / "coat" / "IMG_1.jpg")
    folders, out = [str(tmp_path / name) for name in ("none", "coat")], tmp_path / "out"
    assert main([*folders, "--weights", str(weights), "--count", "2", "--out", str(out), "--device", "cpu"]) == 1
    assert len([read_design(path) for path in (out / "coat").glob("*_design_params.yaml")]) == 2
    assert (out / "coat" / "coat_measurements.yaml").is_file()
    assert not (out / "none").exists()


def test_an_unknown_device_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path), "--out", str(tmp_path / "out"), "--device", "nope"]) == 1
    assert re.fullmatch(r"propose: .*nope.*\n", capsys.readouterr().err)


def test_other_weights_than_described_are_refused(tmp_path: Path) -> None:
    (tmp_path / "T1.json").write_bytes(WEIGHTS.with_suffix(".json").read_bytes())
    (tmp_path / "T1.pt").write_bytes(WEIGHTS.read_bytes()[:-1])
    with pytest.raises(ConfigError, match=r"T1\.pt: not the weights that .*T1\.json describes"):
        network(tmp_path / "T1.pt")
