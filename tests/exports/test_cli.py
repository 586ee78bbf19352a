"""``gcd export`` of one garment or pattern."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import trimesh
from pypdf import PdfReader

from gcd_dataset.generator import fitting
from gcd_dataset.generator.maker import make
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.records import Sample
from gcd_dataset.spec import read_pattern, write_pattern
from tests.exports.dxf_reader import read_dxf
from tests.exports.patterns import squares
from tests.loaders.draping import SKIRTS
from tests.shards.folders import write_samples
from tests.test_cli import run


@pytest.fixture(scope="module")
def shards(worn: Sample, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of one sample."""
    return write_samples(tmp_path_factory.mktemp("shards"), [worn], seed=3, recipe=recipe_of(MakeConfig()))


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    write_pattern(squares(), tmp_path / "squares_specification.json")
    return tmp_path / "squares_specification.json"


@pytest.mark.parametrize("form", ["glb", "obj", "ply", "usd", "dxf", "pdf"])
def test_a_sample_in_each_format(form: str, shards: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("export", shards, f"--{form}", tmp_path / f"a.{form}") == 0
    assert capsys.readouterr().out == f"{tmp_path}/a.{form}\n"
    assert (tmp_path / f"a.{form}").stat().st_size > 1000


def test_options_reach_the_files(shards: Path, spec: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("export", shards, "--glb", tmp_path / "a.glb", "--tile", "0") == 2
    said = capsys.readouterr().err
    assert "a texture tile of 0 cm: give one from 0.01 to 10000 cm" in said and said.count("\n") == 1
    assert not list(tmp_path.glob("*.glb"))
    assert run("export", shards, "--glb", tmp_path / "a.glb", "--tile", "4", "--no-body") == 0
    scene = trimesh.load(tmp_path / "a.glb")
    assert scene.metadata["gcd"]["tile_cm"] == 4.0
    assert "body" not in scene.geometry
    assert run("export", spec, "--pdf", tmp_path / "a.pdf", "--paper", "letter") == 0
    assert float(PdfReader(tmp_path / "a.pdf").pages[0].mediabox.width) == pytest.approx(612, abs=0.1)
    assert run("export", spec, "--dxf", tmp_path / "a.dxf", "--seam-allowance", "0.5") == 0
    [cut] = read_dxf(tmp_path / "a.dxf")["one"].of("1", "POLYLINE")
    assert {abs(x) for point in cut.vertices for x in point} == {5.0, 405.0}  # mm


def test_a_bad_file_costs_no_other_and_two_of_one_name_are_told_apart(
    spec: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "bad.json").write_text("{")
    shutil.copy(spec, tmp_path / "other" / spec.name)
    sources = (spec, tmp_path / "bad.json", tmp_path / "other" / spec.name, tmp_path / "missing.json")
    assert run("export", *sources, "--dxf", tmp_path / "out") == 1
    said = capsys.readouterr().err
    assert "bad.json: line 1" in said and "missing.json: no such file" in said and said.count("\n") == 2
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["squares-2.dxf", "squares.dxf"]


def test_a_specification_is_draped_on_the_neutral_body(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As ``gcd drape --glb`` writes it: a node, texture coordinates and a material for each panel."""
    drape, drapes = fitting.drape_patterns, list[Any]()

    def once(patterns: Any, wearer: Any, **options: Any) -> Iterator[Any]:
        drapes.extend(drapes or drape(patterns, wearer, resolution=6.0, device="cpu"))
        return iter(drapes[:1])

    monkeypatch.setattr(fitting, "drape_patterns", once)
    write_pattern(make(0, 0, MakeConfig(stage="pattern", design=SKIRTS)).pattern, tmp_path / "a.json")
    assert run("export", tmp_path / "a.json", "--glb", tmp_path / "a.glb") == 0, capsys.readouterr().err
    words = ("--resolution", "6", "--device", "cpu", "--quiet", "--glb", "--out", tmp_path / "draped")
    assert run("drape", tmp_path / "a.json", *words) == 0
    assert (tmp_path / "draped" / "a.glb").read_bytes() == (tmp_path / "a.glb").read_bytes()
    scene = trimesh.load(tmp_path / "a.glb")
    panels = {panel.name for panel in read_pattern(tmp_path / "a.json").panels}
    assert scene.geometry.keys() == panels | {"body"}
    assert all(part.visual.uv is not None for part in scene.geometry.values())
    assert {part.visual.material.name for part in scene.geometry.values()} == panels | {"body"}
