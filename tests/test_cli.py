"""The command line: files on disk, output and exit codes."""

import contextlib
import importlib
import io
import json
import logging
import os
import signal
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gcd_dataset.cli import main
from gcd_dataset.cli.common import Stopped, interrupts_after_imports
from gcd_dataset.files import write_whole
from gcd_dataset.generator.body import named_body, read_measurements
from gcd_dataset.generator.body.motion import Gait
from gcd_dataset.generator.body.sizes import read_chart
from gcd_dataset.generator.drape.holds import fell
from gcd_dataset.generator.fitting import Fitting, write_fitting
from gcd_dataset.generator.garments import draw_garment, read_design
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.maker import make
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.records import Outcome, Pattern
from gcd_dataset.shards import decode_motion
from gcd_dataset.spec import read_pattern, spec_from_pattern, write_pattern
from tests.helpers import napkins
from tests.test_faults import sewn_unequally

SKIRT = MakeConfig(
    bodies="neutral",
    stage="pattern",
    design=Overlay.from_dict(
        {"meta": {"upper": "none", "wb": "none", "bottom": "SkirtCircle"}, "flare-skirt": {"rise": 1.0, "length": 0.2}}
    ),
)
FLAT = ["--stage", "pattern", "--workers", "0", "--quiet"]


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    """A specification file of a skirt or shirt."""
    path = tmp_path / "garment_specification.json"
    write_pattern(make(1, 0, SKIRT).pattern, path)
    return path


def one_line(text: str) -> str:
    lines = text.strip().splitlines()
    assert len(lines) == 1, text
    return lines[0]


def run(*words: object) -> int:
    return main([str(word) for word in words])


def exit_code(arguments: list[str]) -> int:
    """Exit code of ``gcd``; for wrong usage the parser raises ``SystemExit``."""
    try:
        return main(arguments)
    except SystemExit as ended:
        assert isinstance(ended.code, int)
        return ended.code


def test_captions_are_written_on_request_and_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flat = ["generate", str(tmp_path / "data"), "--count", "3", "--seed", "8", *FLAT]
    assert main([*flat, "--captions"]) == 0
    assert main(["info", str(tmp_path / "data")]) == 0
    caption = GarmentDataset(tmp_path / "data", fields=["caption"])[0]["caption"]
    assert f"  first captions:\n    {caption.splitlines()[0]}\n" in capsys.readouterr().out
    assert main(["show", str(tmp_path / "data"), "--png", str(tmp_path / "garment.png")]) == 0
    assert caption in capsys.readouterr().out
    assert main(flat) == 2
    assert "made with captions=True, asked for captions=None" in capsys.readouterr().err


def test_a_signal_leaves_no_draft(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "ftruncate", lambda *_: os.kill(os.getpid(), signal.SIGTERM))  # the draft is new
    with pytest.raises(Stopped), interrupts_after_imports():
        write_whole(tmp_path / "a.json", b"{}")
        time.sleep(60)
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


def test_options_may_come_from_a_file(tmp_path: Path) -> None:
    config = tmp_path / "set.toml"
    config.write_text('bodies = "neutral"\nstage = "mesh"\nresolution = 5.0\npoints = 16\n')
    out = tmp_path / "data"
    assert main(["generate", str(out), "--count", "1", "--config", str(config), "--quiet"]) == 0
    assert GarmentDataset(out)[0]["points"].shape == (16, 6)


def test_validate_prints_every_fault(spec: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = json.loads(spec.read_text())
    first = next(iter(content["pattern"]["panels"]))
    content["pattern"]["panels"][first]["edges"][0]["endpoints"] = [0, 99]
    bad, broken = tmp_path / "bad.json", tmp_path / "broken.json"
    bad.write_text(json.dumps(content))
    broken.write_text("{")
    assert main(["validate", str(bad), str(broken), str(tmp_path / "missing.json")]) == 1
    said = capsys.readouterr()
    lines = said.out.splitlines() + said.err.splitlines()
    assert any(f"  panel {first}, edge 0: error: vertex out of range: vertex 99" in line for line in lines)
    assert any("broken.json: line 1, column 2" in line for line in lines)
    assert any("missing.json: no such file" in line for line in lines)


def test_warnings_are_listed_under_their_file_and_fail_only_a_strict_check(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gathered = str(tmp_path / "gathered.json")
    write_pattern(sewn_unequally(), tmp_path / "gathered.json")
    assert main(["validate", gathered, gathered]) == 0
    assert capsys.readouterr().out.splitlines()[0] == f"{gathered}:"
    assert main(["validate", "--strict", gathered]) == 1
    assert capsys.readouterr().out.count("gathered.json") == 1
    assert main(["validate", "--errors", "--strict", gathered]) == 0
    assert "no fault found" in capsys.readouterr().out


@dataclass(frozen=True)
class Draped:
    """What one ``gcd drape`` of good and bad files leaves."""

    out: Path
    fittings: list[Fitting]
    files: list[Path]
    errors: str
    log: str
    report: dict[str, Any]

    @property
    def rows(self) -> dict[str, dict[str, Any]]:
        """Name of a pattern to its row of the report."""
        return {row["pattern"]: row for row in self.report["garments"]}


REFUSED = {
    "missing": "no such file",
    "other": "Is a directory",
    "empty": "empty, not a specification JSON",
    "thin": "panel one is nearly a line",
    "apart": "no seam joins",
}
"""Name of a file that cannot be draped to the reason."""


@pytest.fixture(scope="module")
def draped(tmp_path_factory: pytest.TempPathFactory) -> Draped:
    """Two skirts of one file name, the second without labels, among files that cannot be draped."""
    folder = tmp_path_factory.mktemp("draped")
    spec, out = folder / "garment_specification.json", folder / "out"
    bare = folder / "other" / spec.name
    bare.parent.mkdir()
    write_pattern(make(1, 0, SKIRT).pattern, spec)
    content = json.loads(spec.read_text())
    for panel in content["pattern"]["panels"].values():
        panel.pop("label", None)
        for edge in panel["edges"]:
            edge.pop("label", None)
    bare.write_text(json.dumps(content))
    strip = napkins().panels[0]
    write_pattern(Pattern("thin", (replace(strip, vertices=strip.vertices * [1.0, 0.01]),), ()), folder / "thin.json")
    write_pattern(replace(napkins(), seams=()), folder / "apart.json")
    (folder / "empty.json").touch()
    files = [folder / "missing.json", spec, bare.parent, bare]
    files += [folder / f"{name}.json" for name in ("empty", "thin", "apart")]
    options = ["--fabric", "denim", "--resolution", "5", "--device", "cpu", "--quiet", "--glb"]
    log, fittings = io.StringIO(), list[Fitting]()
    handler = logging.StreamHandler(log)
    logging.getLogger("gcd_dataset").addHandler(handler)

    def kept(fitting: Fitting, *given: Any, **options: Any) -> None:
        fittings.append(fitting)
        write_fitting(fitting, *given, **options)

    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stderr(io.StringIO()) as errors:
        patch.setattr("gcd_dataset.generator.fitting.write_fitting", kept)
        patch.setattr("gcd_dataset.generator.fitting.PICTURE_SIZE", 200)
        assert main(["drape", *map(str, files), "--out", str(out), *options]) == 1
    logging.getLogger("gcd_dataset").removeHandler(handler)
    report = json.loads((out / "report.json").read_text())
    return Draped(out, fittings, files, errors.getvalue(), log.getvalue(), report)


def test_drape_leaves_meshes_pictures_and_a_report(draped: Draped) -> None:
    for ending in (".obj", ".mtl", ".ply", ".glb", "_front.png", "_side.png", "_back.png", "_pattern.png"):
        assert (draped.out / f"garment{ending}").stat().st_size > 50
    assert draped.report["fabric"] == "denim"
    lines = (draped.out / "garment.obj").read_text().splitlines()
    assert sum(line.startswith("v ") for line in lines) == draped.rows["garment"]["vertices"]
    assert np.asarray(Image.open(draped.out / "garment_front.png")).std() > 10


def test_fit_draws_a_design_for_a_body_and_drapes_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Pattern, measures, meshes and pictures lie together; broken rules are named with their figures."""
    file, out = tmp_path / "mini_design_params.yaml", tmp_path / "out"
    file.write_text("design:\n  meta: {bottom: {v: SkirtCircle}}\n  flare-skirt: {length: {v: 0.1}, suns: {v: 1.2}}\n")
    options = ["--body", "female:7", "--resolution", "8", "--device", "cpu", "--quiet"]
    assert main(["fit", str(file), "--out", str(out), *options, "--allow-unsettled"]) == 0
    said = capsys.readouterr()
    assert "mini: SETTLED" in said.out
    assert "on this body, too_heavy: length 0.10 and 1.20 suns" in one_line(said.err)
    _, size, _ = named_body("female:7")
    drawn = read_pattern(out / "mini_specification.json")
    assert spec_from_pattern(drawn) == spec_from_pattern(draw_garment(size, read_design(file)))
    written = read_measurements(out / "mini_body_measurements.yaml")
    assert written.to_file_values() == pytest.approx(size.to_file_values())
    for ending in ("_pattern.svg", "_front.png", "_pattern.png"):
        assert (out / f"mini{ending}").stat().st_size > 1000


def test_drape_moves_the_body_to_a_pose(spec: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The report has the pose; one that cuts the body is named."""
    out, bent = tmp_path / "out", tmp_path / "bent.json"
    bent.write_text('{"upper_arm": [0, -48, 0], "left_thigh": [20, 5, 0]}')
    options = ["drape", str(spec), "--out", str(out), "--resolution", "8", "--device", "cpu", "--quiet"]
    assert main([*options, "--pose", str(bent), "--maps", "--allow-unsettled"]) == 0
    assert "in this pose the body cuts itself" in capsys.readouterr().err
    [maps] = out.glob("*_maps.npz")
    assert np.load(maps)["gap"].max() < 60.0
    report = json.loads((out / "report.json").read_text())
    assert report["pose"]["left_thigh"] == [20.0, 5.0, 0.0]
    assert report["garments"][0]["frames"] > 10


def test_drape_moves_the_body_through_a_motion(
    spec: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames, their crossings and a picture; a garment that falls in frame 4 keeps three, and exits with 1."""
    out = tmp_path / "out"
    options = ["drape", str(spec), "--out", str(out), "--resolution", "8", "--device", "cpu", "--quiet"]
    monkeypatch.setattr("gcd_dataset.generator.body.motion.GAITS", {"walk": Gait(cadence=900.0)})
    calls = iter(range(99))  # the first two: at rest in the A-pose, and in the first frame
    falls = lambda *given: "it lies at 2 cm" if next(calls) == 4 else fell(*given)  # noqa: E731
    monkeypatch.setattr("gcd_dataset.generator.drape.outcome.fell", falls)
    assert main([*options, "--motion", "walk"]) == 1
    assert "FELL" in (said := capsys.readouterr().out) and "frame 4 of 9: it lies at 2 cm" in said
    [row] = json.loads((out / "report.json").read_text())["garments"]
    motion = decode_motion((out / "garment.motion.z").read_bytes())
    assert len(row["motion"]["body_through"]) == len(motion.vertices) == 3
    assert motion.crossings[:, 1].tolist() == row["motion"]["body_crossings"]
    assert np.asarray(Image.open(out / "garment_motion.png")).shape[:2] == (600, 900)


def test_drape_cuts_a_design_for_a_size_and_tells_how_it_fits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The mean woman has size 96; a specification without a design is refused, the other files are draped."""
    skirt, spec = tmp_path / "skirt_design_params.yaml", tmp_path / "napkins_specification.json"
    skirt.write_text("meta: {upper: null, bottom: PencilSkirt, wb: null}\n")
    write_pattern(napkins(), spec)
    options = ["--body", "female", "--resolution", "8", "--device", "cpu", "--quiet", "--allow-unsettled"]
    reports = {}
    for size in ("88", "76"):
        out = tmp_path / size
        assert main(["drape", str(skirt), str(spec), "--cut-for", size, *options, "--out", str(out)]) == 1
        reports[size] = json.loads((out / "report.json").read_text())["garments"]
    said = capsys.readouterr()
    (fits, refused), (tight, _) = reports["88"], reports["76"]
    assert fits["fit"] == {"chart": "women", "cut_for": "88", "wearer_size": "96", "step": -2, "labels": []}
    assert refused["outcome"] == "REFUSED" and "a specification without its design" in refused["reason"]
    assert "fit" not in refused
    assert tight["outcome"] == "CANNOT_BE_PUT_ON"
    assert tight["fit"]["labels"][0]["figures"]["ring_cm"] == pytest.approx(read_chart("women").body("76").waist)
    assert "on this body, too_tight: a top edge of 62.0 cm" in said.err


def test_a_garment_that_slides_off_ends_with_1(
    draped: Draped, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The files are written too; with ``--allow-unsettled`` the exit code is 0."""
    settled = draped.fittings[0]
    slid = replace(settled, drape=replace(settled.drape, outcome=Outcome.SLID_OFF))
    monkeypatch.setattr("gcd_dataset.generator.fitting.drape_patterns", lambda *_, **__: iter([slid]))
    monkeypatch.setattr("gcd_dataset.generator.fitting.PICTURE_SIZE", 200)
    options = ["drape", str(draped.files[1]), "--out", str(tmp_path), "--device", "cpu", "--quiet"]
    assert main(options) == 1
    assert "SLID_OFF" in capsys.readouterr().out
    [row] = json.loads((tmp_path / "report.json").read_text())["garments"]
    assert row["outcome"] == "SLID_OFF" and (tmp_path / "garment.obj").exists()
    assert main([*options, "--allow-unsettled"]) == 0


def test_ctrl_c_waits_for_the_end_of_an_import(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Trimesh would take an interrupted import for a missing package."""
    (tmp_path / "interrupted.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\nwhole = True\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in a background process
    try:
        with pytest.raises(Stopped), interrupts_after_imports():
            importlib.import_module("interrupted")
            time.sleep(60)
    finally:
        signal.signal(signal.SIGINT, before)
    assert sys.modules.pop("interrupted").whole


def test_assumptions_of_a_drape_are_logged_and_reported(draped: Draped) -> None:
    """A skirt without labels is held at the waist by assumption; a skirt with labels needs none."""
    labelled, found = draped.rows["garment"], draped.rows["garment-2"]
    assert labelled["assumed"] == []
    assert any("lower_interface" in sentence for sentence in found["assumed"])
    assert all(f"garment-2: {sentence}" in draped.log for sentence in found["assumed"])
    assert found["outcome"] == labelled["outcome"] == "SETTLED"


def test_a_file_that_cannot_be_draped_costs_no_other(draped: Draped, tmp_path: Path) -> None:
    """Two files of one name both leave a mesh."""
    rows = draped.rows
    assert [row["file"] for row in rows.values()] == list(map(str, draped.files))
    assert {name for name, row in rows.items() if row["outcome"] == "REFUSED"} == REFUSED.keys()
    for name, reason in REFUSED.items():
        assert reason in rows[name]["reason"]
        assert f"gcd drape: {name}: REFUSED: {rows[name]['reason']}" in draped.errors
    for name in ("garment", "garment-2"):
        assert rows[name]["outcome"] == "SETTLED"
        assert (draped.out / f"{name}.ply").exists()
    options = ["--out", str(tmp_path), "--resolution", "5", "--device", "cpu", "--quiet"]
    assert main(["drape", str(draped.files[0]), *options, "--allow-unsettled"]) == 1
    assert [row["outcome"] for row in json.loads((tmp_path / "report.json").read_text())["garments"]] == ["REFUSED"]


def test_show_draws_a_sample_and_a_pattern(spec: Path, tmp_path: Path) -> None:
    assert main(["generate", str(tmp_path / "data"), "--count", "1", *FLAT]) == 0
    for what in (spec, tmp_path / "data"):
        picture = tmp_path / "picture.png"
        assert main(["show", str(what), "--png", str(picture)]) == 0
        assert np.asarray(Image.open(picture)).std() > 5
        page = tmp_path / "page.html"
        assert main(["show", str(what), "--html", str(page)]) == 0
        assert page.read_text("utf-8").count("data-panel=") >= 2
    assert main(["show", str(spec), "--body", "male", "--html", str(tmp_path / "male.html")]) == 0
    assert main(["show", str(spec), "--html", str(page)]) == 0
    assert page.read_bytes() != (tmp_path / "male.html").read_bytes()


def test_a_config_narrows_designs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "trousers.toml"
    config.write_text(
        'bodies = "neutral"\n[design.meta]\nupper = "none"\nbottom = "Pants"\n[design.pants]\nlength = 0.8\n'
    )
    assert main(["generate", str(tmp_path / "out"), "--count", "2", "--config", str(config), *FLAT]) == 0
    dataset = GarmentDataset(tmp_path / "out", fields=["design", "spec"])
    assert all(item["design"]["pants"]["length"] == 0.8 for item in dataset)
    assert all("pant_f_r" in item["spec"]["pattern"]["panels"] for item in dataset)
    assert dataset.recipe(0)["recipe"]["design"]["meta"]["bottom"] == {"options": ["Pants"]}
    for text, message in (
        ("bodes = 1\n", "no option is called bodes"),
        ("design = 3\n", "design is 3: write tables such as [design.pants]"),
        ("[design.pants]\nlenght = 0.8\n", "no design parameter is called pants.lenght: did you mean pants.length?"),
    ):
        config.write_text(text)
        assert main(["generate", str(tmp_path / "out"), "--count", "2", "--config", str(config), *FLAT]) == 2
        said = one_line(capsys.readouterr().err)
        assert "trousers.toml: " in said and message in said
