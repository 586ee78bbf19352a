"""The scoreboard: model cards, result files and their tables."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from gcd_dataset.cli import main
from gcd_dataset.generator.render import look_at
from gcd_dataset.generator.silhouettes import Silhouettes
from gcd_dataset.scoring.board import read_card, tables
from gcd_dataset.scoring.inputs import PICTURE_SIZE, TASKS

CARD = 'name = "net"\ngarments = 4000\nminutes = 8\nweights = 1000000\nhardware = "one GPU"\n'


def result(path: Path, name: str, right: float, *, truth: str = "t", draped_on: str = "CPU", **model: Any) -> Path:
    card = {"name": name, "garments": 4000, "minutes": 8.0, "weights": 10**6, "hardware": "one GPU", **model}
    figures = {score: {"mean": right, "low": right - 0.1, "high": right + 0.1} for score in ("combinatorial", "iou")}
    settings = {"task": "T1", "mini": True, "device": "CPU", "draped_on": draped_on, "hashes": {"truth": truth}}
    tree = {"schema": 1, "model": card, "settings": settings, "figures": figures}
    tree["garments"] = [{"name": name, "combinatorial": right + apart} for name, apart in (("a", 0.1), ("b", -0.1))]
    path.write_text(json.dumps(tree))
    return path


def test_only_equal_budgets_are_ranked(tmp_path: Path) -> None:
    """A longer training heads no other's rank, and a baseline of less than its budget has none."""
    files = [
        result(tmp_path / "a.json", "good", 0.6),
        result(tmp_path / "b.json", "better", 0.7),
        result(tmp_path / "c.json", "longer", 0.9, minutes=80.0),
        result(tmp_path / "d.json", "small | [copy](x)", 0.95, baseline=True),
    ]
    rows = [line.split(" | ") for line in tables(files).splitlines() if "one GPU" in line]
    assert [(row[0].strip("| "), row[1]) for row in rows] == [
        ("1", "longer"), ("1", "better"), ("2", "good"), ("–", "small  copyx"),
    ]  # fmt: skip
    assert rows[1][2] == "0.700 [0.600, 0.800]"


def test_seeds_of_a_model_are_one_row(tmp_path: Path) -> None:
    """Its figures are the mean, the lowest and the highest of the seeds; a file given twice counts once."""
    files = [result(tmp_path / f"{k}.json", "net", 0.5 + 0.1 * k) for k in range(2)]
    files.append(result(tmp_path / "2.json", "net", 0.7, minutes=8, baseline=False))
    (row,) = [line for line in tables([*files, files[0]]).splitlines() if "one GPU" in line]
    assert "| 0.600 [0.500, 0.700] |" in row
    assert row.endswith("| one GPU | 3 |")


def test_models_are_compared_by_garment(tmp_path: Path) -> None:
    """Both models find garment b harder, so that their difference is surer than their means."""
    files = [result(tmp_path / "a.json", "one", 0.6), result(tmp_path / "b.json", "other", 0.55)]
    first, second = (line for line in tables(files).splitlines() if "one GPU" in line)
    assert "|  | 4,000" in first
    assert "| -0.050 [-0.050, -0.050] | 4,000" in second


def test_the_least_error_is_first(tmp_path: Path) -> None:
    files = [result(tmp_path / f"{error}.json", f"off by {error}", 0.5) for error in (3.0, 0.5)]
    for path in files:
        tree = json.loads(path.read_text())
        tree["settings"]["task"] = "T5"
        tree["figures"] = {"error_cm": dict.fromkeys(("mean", "low", "high"), float(path.stem))}
        tree["garments"] = [{"name": "a", "error_cm": float(path.stem)}]
        path.write_text(json.dumps(tree))
    rows = [line.split(" | ")[:2] for line in tables(files).splitlines() if "one GPU" in line]
    assert rows == [["| 1", "off by 0.5"], ["| 2", "off by 3.0"]]


def test_drapes_of_a_cpu_and_of_a_gpu_share_no_table(tmp_path: Path) -> None:
    files = [result(tmp_path / f"{kind}.json", kind, 0.5, draped_on=kind) for kind in ("CPU", "GPU")]
    heads = [line for line in tables(files).splitlines() if line.startswith("## ")]
    assert heads == [
        f"## T1: 2 garments (mini), inputs draped on a CPU, answers on a {kind}" for kind in ("CPU", "GPU")
    ]


def test_results_on_other_patterns_share_no_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [result(tmp_path / "a.json", "one", 0.6), result(tmp_path / "b.json", "other", 0.7, truth="u")]
    assert main(["bench", "board", *map(str, files)]) == 1
    [line] = capsys.readouterr().err.splitlines()
    assert "b.json: other true patterns than" in line
    (tmp_path / "c.json").write_text("{}")
    assert main(["bench", "board", str(tmp_path / "c.json")]) == 1
    assert "c.json: no result file of schema 1: make it with gcd bench submit" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"settings": ["task", "mini", "device", "hashes"]}, "settings must be a JSON object"),
        ({"settings": {"task": ["T1"], "device": "CPU", "hashes": {"truth": "t"}}}, "its settings name no task"),
        ({"settings": {"task": "T1", "device": "CPU", "hashes": {}}}, "hash of the truth must be a string"),
        ({"model": {"name": "net"}}, "no garments, minutes, weights, hardware"),
        ({"model": []}, "model must be a JSON object"),
        ({"figures": {"iou": {"mean": None}}}, "mean of iou must be a number, found nothing"),
        ({"figures": {"combinatorial": dict.fromkeys(("mean", "low", "high"), 0.9)}}, "the mean of combinatorial is"),
        ({"garments": []}, "the mean of combinatorial is not that of its garments"),
        ({"garments": 5}, "garments must be a list, found 5"),
        ({"garments": [{"name": "a"}]}, "combinatorial of garment a must be a number"),
    ],
)
def test_results_that_cannot_be_read(
    change: dict[str, Any], fault: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Anybody may edit a result file: its fault is one sentence."""
    path = result(tmp_path / "a.json", "net", 0.6)
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    assert main(["bench", "board", str(path)]) in (1, 2)
    [line] = capsys.readouterr().err.splitlines()
    assert f"a.json: {fault}" in line


def test_results_of_a_task_have_its_bodies_and_resolution(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Scores on other bodies, inputs or meshes are no result, and other true patterns are told before the work."""
    (tmp_path / "model.toml").write_text(CARD)
    rest = ["--card", str(tmp_path / "model.toml"), "--out", str(tmp_path / "r.json"), "--drape"]
    command = ["bench", "submit", str(tmp_path / "none"), str(tmp_path), *rest]
    for option in (["--bodies", "neutral"], ["--resolution", "4"], ["--inputs", "x"], ["--partial"]):
        with pytest.raises(SystemExit, match="2"):
            main([*command, *option])
    assert option[0] in capsys.readouterr().err
    assert main(command) == 1
    assert "task.json: no such file" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("card", "fault"),
    [
        (CARD.replace("minutes = 8\n", ""), "no minutes: a model card has name"),
        (CARD + "speed = 3\n", "speed is unknown"),
        (CARD.replace("4000", "4000.5"), "garments is 4000.5: give a whole number"),
        (CARD.replace("4000", "true"), "garments is True: give a whole number"),
        (CARD.replace("= 8", "= -8"), "minutes is -8: give a number of 0 or more"),
        (CARD + "baseline = 1\n", "baseline is 1: give true or false"),
    ],
)
def test_cards_that_cannot_be_used(card: str, fault: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "model.toml"
    path.write_text(card)
    command = ["bench", "submit", str(tmp_path), str(tmp_path), "--card", str(path), "--out", str(tmp_path / "r.json")]
    assert main(command) == 2
    assert f"model.toml: {fault}" in capsys.readouterr().err
    path.write_text(CARD)
    assert read_card(path)["minutes"] == 8


def test_photographs_are_laid_out_as_pictures_of_t2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two of one garment, one of each other, which is red and upright in a white square."""
    photographs, out = tmp_path / "photographs", tmp_path / "out"
    photographs.mkdir()
    for name in ("IMG_0412.jpg", "IMG_0413.jpg", "coat_0.jpg", "coat_1.png", "shirt.jpg"):
        Image.new("RGB", (300, 600), "red").save(photographs / name)
    command = ["bench", "inputs", "T2", str(out), "--pictures", str(photographs)]
    assert main(command) == 0
    names = [f"{name}_{k}.png" for name in ("IMG_0412", "IMG_0413", "coat", "shirt") for k in range(4)]
    assert sorted(path.name for path in (out / "inputs").iterdir()) == names
    with Image.open(out / "inputs" / "shirt_3.png") as image:
        assert image.size == (PICTURE_SIZE, PICTURE_SIZE)
        assert image.getpixel((0, 64)) == (255, 255, 255)
        assert image.getpixel((64, 64))[0] > 250 > 20 > image.getpixel((64, 64))[1]  # type: ignore[index]
    (photographs / "bad.png").write_text("x")
    assert main(command) == 2
    assert "bad.png: cannot be read" in capsys.readouterr().err
    assert main([*command[:-1], str(tmp_path / "none")]) == 2
    assert "none: no pictures: give a folder of .jpg" in capsys.readouterr().err
    assert main(["bench", "inputs", "T1", str(out), "--pictures", str(photographs)]) == 2


def test_pictures_of_t2_lie_beside_their_cut_outs(tmp_path: Path) -> None:
    """The garment, in the left half of grey pictures, and the cameras."""
    pictures = np.full((4, 128, 128, 3), 90, np.uint8)
    panel = np.where(np.arange(128) < 64, 2, -1) * np.ones((4, 128, 1), int)
    cameras = [look_at(np.array([0.0, 90.0, away]), np.array([0.0, 90.0, 0.0]), focal=2.0) for away in (1, 2, 3, 4)]
    item: Any = {"views": pictures, "panel_id_map": panel}
    item |= {"camera_k": np.stack([camera.intrinsics(128) for camera in cameras])}
    item |= {"camera_rt": np.stack([camera.extrinsics() for camera in cameras])}
    (tmp_path / "inputs").mkdir()
    TASKS["T2"].write({name: torch.from_numpy(array) for name, array in item.items()}, tmp_path / "inputs" / "coat")
    assert len(list((tmp_path / "inputs").glob("coat_?.png"))) == 4
    found = Silhouettes.read(tmp_path / "cut_outs" / "coat")
    assert (found.pictures == 90).all()
    assert np.array_equal(found.masks, np.arange(256) < np.full((4, 256, 1), 128))
    assert np.allclose([camera.eye[2] for camera in found.cameras], [1, 2, 3, 4])


def test_a_task_that_is_unknown_or_unfinished(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "inputs", "T9", str(tmp_path / "t")]) == 2
    assert "no task T9: give one of T1, T1-scan, T2, T3" in capsys.readouterr().err
    (tmp_path / "task.json").write_text('{"task": "T3", "finished": false}')
    assert main(["score", str(tmp_path), str(tmp_path)]) == 1
    assert "unfinished: the same gcd bench inputs command continues it" in capsys.readouterr().err
    for content in ("[]", '{"task": ["T3"], "finished": true}'):
        (tmp_path / "task.json").write_text(content)
        assert main(["score", str(tmp_path), str(tmp_path)]) == 1
        assert "task.json: no description of a task" in capsys.readouterr().err
    (tmp_path / "task.json").write_text("[]")
    assert main(["bench", "inputs", "T3", str(tmp_path)]) == 1
    assert "task.json: the file must be a JSON object, found []" in capsys.readouterr().err
