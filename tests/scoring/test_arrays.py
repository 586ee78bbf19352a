"""Answers that are no patterns: labels of vertices, measures, drapes, motions."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gcd_dataset.cli import main
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.measurements import MEASURES
from gcd_dataset.metrics import VertexLabels
from gcd_dataset.records import BONES
from gcd_dataset.scoring.inputs import MESH, TASKS, TaskFolder, vertex_order
from gcd_dataset.spec import spec_from_pattern, write_pattern
from gcd_dataset.tensors import EDGE_LABELS
from tests.scoring.test_board import CARD
from tests.test_metrics import garment

TRUE = np.arange(26.0) + 30
NAMES = "abcd"


def item() -> dict[str, Any]:
    """A garment whose drape is its box mesh, on the mean body, seen by nobody."""
    mesh = build_box_mesh(garment(), spacing=8.0)
    labels = [(row, EDGE_LABELS.index(name)) for name, rows in mesh.labels.items() for row in rows]
    arrays = {name: getattr(mesh, name) for name in MESH if name != "labels"}
    arrays |= {"verts": mesh.vertices, "box": mesh.vertices, "labels": np.array(labels, int).reshape(-1, 2)}
    arrays |= {"stitches": np.zeros((len(garment().seams), 2), int), "body": np.zeros(len(body_model().components))}
    arrays |= {"scan": np.zeros((5, 6)), "scan_panel_id": np.array([0, 1, -1, -1, 0])}
    measures = dict(zip(MEASURES, TRUE.tolist(), strict=True))
    turns = np.zeros((3, len(BONES), 3))
    turns[2, BONES.index("left_thigh"), 0] = 0.5
    arrays |= {"motion_pose": turns, "motion_verts": np.stack([mesh.vertices + [0, k, 0] for k in range(3)])}
    meta = {"panel_names": list(mesh.panel_names), "pose": {"arm_angle": 0.0, "legs_apart": False}, "index": 0}
    spec = {**spec_from_pattern(garment()), "properties": {}}
    return {
        **{name: torch.tensor(array) for name, array in arrays.items()},
        "meta": meta,
        "spec": spec,
        "measures": measures,
    }


@pytest.fixture
def folder(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Four garments as inputs of the task ``request.param``; not the frozen ones."""
    monkeypatch.setattr(TaskFolder, "require_frozen", lambda self: None)
    task, out, made = TASKS[request.param], tmp_path / "task", item()
    for part in ("inputs", "truth", "bodies"):
        (out / part).mkdir(parents=True)
    assert task.truth is not None
    for name in NAMES:
        task.write(made, out / "inputs" / name)
        true: Mapping[str, Any] = task.truth(made, name)
        np.savez(out / "truth" / f"{name}.npz", **true)
        write_pattern(garment(), out / "truth" / f"{name}_specification.json")
        np.save(out / "bodies" / f"{name}.npy", made["body"].numpy())
    (out / "task.json").write_text(json.dumps({"task": task.name, "mini": True, "device": "CPU", "finished": True}))
    return out


def scored(folder: Path, answers: Path) -> dict[str, dict[str, Any]]:
    """The scores of each garment; the rest of the files is broken: b, of another size: c, missing: d."""
    out = folder.parent / "scores.json"
    assert main(["score", str(answers), str(folder), "--json", str(out), "--quiet"]) == 0
    return {row.pop("name"): row for row in json.loads(out.read_text())["garments"]}


def labels_of(folder: Path, name: str) -> dict[str, Any]:
    with np.load(folder / "truth" / f"{name}.npz") as truth:
        found = {key: truth[key].argmax(axis=1) for key in VertexLabels.__dataclass_fields__}
        return found | {"seams": np.where(truth["seams"].any(axis=1), found["seams"], -1)}


@pytest.mark.parametrize("folder", ["T4"], indirect=True)
def test_labels_are_right_under_any_numbering(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An answer that cannot be read, of other vertices or none counts as wrong, is named, and stops nothing."""
    (answers := tmp_path / "answers").mkdir()
    right = labels_of(folder, "a")
    changed = {"panels": 90 - 7 * right["panels"], "seams": np.where(right["seams"] < 0, -1, 500 + right["seams"])}
    np.savez(answers / "a.npz", **{**right, **changed})
    (answers / "b.npz").write_text("no archive")
    np.savez(answers / "c.npz", **{**labels_of(folder, "c"), "edges": np.zeros(3, int)})
    found = scored(folder, answers)
    assert all(value == 1 for key, value in found["a"].items() if key not in ("kind", "failure", "remarks"))
    for name, failure in (("b", "cannot be read"), ("c", "edges: int64 of shape (3,): give"), ("d", "no answer")):
        assert failure in found[name]["failure"]
        assert found[name]["panel_label"] == found[name]["seam_label"] == 0
    assert "score.panel_label 0.25 share" in capsys.readouterr().out
    np.savez(answers / "b.npz", **{**labels_of(folder, "b"), "classes": np.full(len(right["panels"]), 10**6)})
    assert (scored(folder, answers)["b"]["panel_class"], scored(folder, answers)["b"]["panel_label"]) == (0, 1)


@pytest.mark.parametrize("folder", ["T4"], indirect=True)
def test_the_order_of_a_mesh_tells_nothing(folder: Path) -> None:
    """Its vertices are those of the drape in an order of its garment's; its faces begin with the least and ascend."""
    true = item()
    with np.load(folder / "inputs" / "a.npz") as given:
        assert sorted(given.files) == ["faces", "vertices"]
        order, faces = vertex_order("a", len(true["verts"])), given["faces"]
        assert np.allclose(given["vertices"], true["verts"].numpy()[order], atol=1e-4)
    assert not np.array_equal(order, vertex_order("b", len(order)))
    assert (faces.argmin(axis=1) == 0).all()
    assert faces.tolist() == sorted(faces.tolist())
    ours, theirs = ({frozenset(face) for face in rows.tolist()} for rows in (order[faces], true["faces"]))
    assert ours == theirs


@pytest.mark.parametrize("folder", ["T5"], indirect=True)
def test_measures_are_compared_by_name(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (answers := tmp_path / "answers").mkdir()
    right = dict(zip(reversed(MEASURES), TRUE[::-1].tolist(), strict=True))
    (answers / "a.json").write_text(json.dumps(right))
    (answers / "b.json").write_text(json.dumps({**right, "bust": None}))
    (answers / "c.json").write_text("[1, 2]")
    found = scored(folder, answers)
    assert (found["a"]["error_cm"], found["a"]["error_degrees"], found["a"]["waist"]) == (0, 0, 0)
    for name, failure in (("b", "bust must be a number"), ("c", "must be a JSON object"), ("d", "no answer")):
        assert failure in found[name]["failure"]
        assert (found[name]["error_cm"], found[name]["error_degrees"]) == (100, 180)
    assert "score.error_cm 75 cm" in capsys.readouterr().out
    assert np.load(folder / "inputs" / "a.npy")[:, 6].tolist() == [1, 1, 0, 0, 1]
    assert main(["score", str(answers), str(folder), "--drape"]) == 2
    assert "answers are no patterns: leave out --repair, --bodies and --drape" in capsys.readouterr().err
    (tmp_path / "card.toml").write_text(CARD)
    command = ["bench", "submit", str(answers), str(folder), "--card", str(tmp_path / "card.toml")]
    assert main([*command, "--out", str(tmp_path / "result.json"), "--quiet"]) == 0
    assert main(["bench", "board", str(tmp_path / "result.json")]) == 0
    assert "| rank | model | error_cm | error_degrees |" in capsys.readouterr().out


@pytest.mark.parametrize("folder", ["T6"], indirect=True)
def test_positions_are_compared_with_the_drape(folder: Path, tmp_path: Path) -> None:
    (answers := tmp_path / "answers").mkdir()
    true = item()["verts"].numpy()
    np.savez(answers / "a.npz", vertices=true, ms=3.0)
    np.savez(answers / "b.npz", vertices=true + [0, 2, 0])
    np.savez(answers / "c.npz", vertices=np.where(np.arange(len(true))[:, None] == 0, np.nan, true))
    found = scored(folder, answers)
    assert (found["a"]["error_cm"], found["a"]["stretch_error"], found["a"]["within_1cm"]) == (0, 0, 1)
    assert found["b"]["error_cm"] == pytest.approx(2)
    for name, failure in (("c", "finite numbers"), ("d", "no answer")):
        assert failure in found[name]["failure"]
        assert (found[name]["error_cm"], found[name]["stretch_error"]) == (100, 1)
        assert found[name]["self_crossings"] > found["a"]["self_crossings"]


@pytest.mark.parametrize("folder", ["T8"], indirect=True)
def test_positions_are_compared_in_each_frame_but_the_first(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of the first frame, which is given, nothing counts; of a garment without a whole motion nothing is asked."""
    (answers := tmp_path / "answers").mkdir()
    with np.load(folder / "inputs" / "a.npz") as given, np.load(folder / "truth" / "a.npz") as truth:
        first, true = given["first"], truth["vertices"]
        leg = np.linalg.norm(np.diff(given["body_vertices"], axis=0), axis=2)
    assert leg.max() > 20
    assert np.median(leg) < 1  # the wearer lifts a leg
    (folder / "truth" / "b.npz").unlink()
    np.savez(answers / "a.npz", vertices=np.concatenate([true[:1] + 50, true[1:]]))
    np.savez(answers / "c.npz", vertices=np.stack([first, first]))
    np.savez(answers / "d.npz", vertices=first)
    assert main(["score", str(answers), str(folder)]) == 1  # an input without its truth
    assert "truth/b.npz: cannot be read" in capsys.readouterr().err
    for path in (folder / "inputs").glob("b*"):
        path.unlink()
    found = scored(folder, answers)
    assert (found["a"]["error_cm"], found["a"]["within_1cm"]) == (0, 1)
    assert (found["c"]["error_cm"], found["c"]["within_1cm"]) == (pytest.approx(2), 0)
    assert f"give ({len(true)}, {len(first)}, 3) finite numbers" in found["d"]["failure"]
    assert (found["d"]["error_cm"], found["d"]["stretch_error"]) == (100, 1)
    assert found["d"]["self_crossings"] > found["a"]["self_crossings"]
    assert "b" not in found
    assert "1 of 4 garments have no input, and no score" in capsys.readouterr().err
