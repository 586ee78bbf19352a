"""Predictions of published models, in the files that they write, become specifications that can be scored."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.reconstruction.encoding_losses import AGAIN, losses_of
from benchmarks.reconstruction.legacy import legacy_scores
from gcd_dataset.encodings import aipparel, garmentdiffusion, neuraltailor, sewformer, sewingldm
from gcd_dataset.metrics import score_pattern
from gcd_dataset.records import Edge, EdgeRef, Panel, Pattern, Placement, Seam
from gcd_dataset.scoring.answers import garment_name, main
from gcd_dataset.spec import read_pattern, write_pattern

SEAMS = (Seam(EdgeRef("wb_front", 1), EdgeRef("wb_back", 3)), Seam(EdgeRef("wb_front", 3), EdgeRef("wb_back", 1)))


def garment(name: str = "belt", width: float = 30.0) -> Pattern:
    corners = np.array([[0.0, 0.0], [width, 0.0], [width, 8.0], [0.0, 8.0]])
    edges = tuple(Edge(i, (i + 1) % 4) for i in range(4))
    front = Panel("wb_front", corners, edges, Placement(np.array([-width / 2, 100.0, 15.0]), np.zeros(3)))
    back = Panel("wb_back", corners, edges, Placement(np.array([width / 2, 100.0, -15.0]), np.array([0.0, np.pi, 0.0])))
    return Pattern(name, (front, back), SEAMS)


def run(form: str, *files: Path, out: Path, flags: tuple[str, ...] = ()) -> int:
    return main([form, *map(str, files), "--out", str(out), *flags])


def standardised(pattern: Pattern) -> dict[str, np.ndarray]:
    """NeuralTailor's output for a pattern, in the network's units."""
    arrays = neuraltailor.encode(pattern)
    scaled = {name: neuraltailor.SCALINGS[name].apply(getattr(arrays, name)) for name in ("outlines", "rotations")}
    scaled["translations"] = neuraltailor.SCALINGS["translations"].apply(arrays.translations)
    return {**scaled, "stitch_tags": arrays.stitch_tags, "free_edges_mask": arrays.free_edges}


def save(path: Path, arrays: dict[str, np.ndarray], **others: np.ndarray) -> None:
    both: dict[str, Any] = {**arrays, **others}
    np.savez(path, **both)


def assert_perfect(path: Path, true: Pattern) -> None:
    score = score_pattern(read_pattern(path), true)
    assert (score.iou, score.combinatorial, score.stitch_f1) == pytest.approx((1.0, 1.0, 1.0), abs=1e-6)
    assert score.transl_cm == pytest.approx(0.0, abs=1e-4)


# ------------------------------------------------------------------------------------------------------ specifications


def old_specification() -> dict[str, Any]:
    """A skirt panel in the format of Korosteleva and Lee (2021): curvature without a type, no units, no labels."""
    edges = [
        {"endpoints": [0, 1], "curvature": [0.5, -0.1]},
        {"endpoints": [1, 2]},
        {"endpoints": [2, 3], "curvature": [0.5, 0.1]},
        {"endpoints": [3, 0]},
    ]
    panel = {"translation": [0, -35.0, 18.0], "rotation": [0, 0, 0], "edges": edges}
    vertices = [[-33.3, -30.0], [33.3, -30.0], [20.1, 30.0], [-20.1, 30.0]]
    back = {**panel, "translation": [0, -35.0, -15.0], "rotation": [180.0, 0.0, 180.0], "vertices": vertices}
    panels = {"front": {**panel, "vertices": vertices}, "back": back}
    sides = [[{"panel": "front", "edge": 1}, {"panel": "back", "edge": 3}]]
    return {
        "pattern": {"panels": panels, "stitches": sides},
        "properties": {"curvature_coords": "relative", "normalize_panel_translation": False},
    }


def test_an_old_specification_is_read(tmp_path: Path) -> None:
    (tmp_path / "skirt").mkdir()
    source = tmp_path / "skirt" / "specification.json"
    source.write_text(json.dumps(old_specification()))
    assert run("specification", source, out=tmp_path / "out") == 0
    found = read_pattern(tmp_path / "out" / "skirt_specification.json")
    assert {panel.name for panel in found.panels} == {"front", "back"}
    assert len(found.seams) == 1
    assert score_pattern(found, read_pattern(source)).combinatorial == 1.0


def test_files_that_models_name_by_their_folder() -> None:
    names = {
        "tee_1/_predicted_specification.json": "tee_1",
        "tee_1/_predicted_single_specification.json": "tee_1",
        "tee_1/_predicted_3.25_specification.json": "tee_1",
        "sample_0/NNSewingPattern_pred_specification.json": "sample_0",
        "rand_9/specification.json": "rand_9",
        "x/rand_9_specification.json": "rand_9",
        "x/rand_9__predicted__specification.json": "rand_9",
        "x/rand_9.npz": "rand_9",
    }
    assert {path: garment_name(Path(path)) for path in names} == names


def test_of_a_folder_the_predictions_are_read(tmp_path: Path) -> None:
    """The models copy the true pattern beside the predicted one."""
    folder = tmp_path / "predictions" / "belt"
    folder.mkdir(parents=True)
    write_pattern(garment(width=99.0), folder / "specification.json")
    write_pattern(garment(width=30.0), folder / "_predicted_specification.json")
    assert run("neuraltailor", tmp_path / "predictions", out=tmp_path / "out") == 0
    assert_perfect(tmp_path / "out" / "belt_specification.json", garment(width=30.0))


def test_faults_of_networks_are_repaired_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spec = old_specification()
    front = spec["pattern"]["panels"]["front"]
    front["vertices"].append([-20.1, -25.0])
    front["edges"][3]["endpoints"] = [3, 4]
    front["edges"][1]["curvature"] = {"type": "circle", "params": [1.0, 0, 1]}
    spec["pattern"]["panels"]["nothing"] = {
        "translation": [0, 0, 0],
        "rotation": [0, 0, 0],
        "vertices": [],
        "edges": [],
    }
    spec["pattern"]["stitches"] += [[{"panel": "front", "edge": 9}, {"panel": "back", "edge": 1}], []]
    spec["pattern"]["closures"] = [{"panel": "front", "edge": 9, "closure": "zip"}]
    spec["pattern"]["panel_order"] = ["front", None, "front"]
    spec["pattern"]["new_panel_ids"] = [0, None]
    source = tmp_path / "odd.json"
    source.write_text(json.dumps(spec))
    assert run("sewformer", source, out=tmp_path / "out") == 0
    said = capsys.readouterr().err
    for fault in (
        "panel nothing: no edge",
        "panel front: edge 1: its arc is too small",
        "panel front: its outline does not close: closed by a straight edge",
        "2 of 3 seams to missing edges",
        "panel_order: did not name every panel once",
    ):
        assert fault in said
    found = read_pattern(tmp_path / "out" / "odd_specification.json")
    assert [panel.name for panel in found.panels] == ["front", "back"]
    assert [edge.end for edge in found.panel("front").edges][-1] == found.panel("front").edges[0].start
    assert len(found.panel("front").edges) == 5


# --------------------------------------------------------------------------------------------------------------- arrays


def test_a_batch_of_garments_with_names(tmp_path: Path) -> None:
    parts = [standardised(garment(width=width)) for width in (30.0, 50.0)]
    batch = {key: np.stack([part[key] for part in parts]) for key in parts[0]}
    save(tmp_path / "batch.npz", batch, names=np.array(["thin", "wide"]))
    assert run("neuraltailor", tmp_path / "batch.npz", out=tmp_path / "out") == 0
    assert_perfect(tmp_path / "out" / "wide_specification.json", garment(width=50.0))
    tensors = {key: torch.from_numpy(value.copy()).requires_grad_() for key, value in batch.items()}
    torch.save(tensors, tmp_path / "batch.pt")
    assert run("neuraltailor", tmp_path / "batch.pt", out=tmp_path / "out") == 0
    assert_perfect(tmp_path / "out" / "batch_1_specification.json", garment(width=50.0))


def test_panels_get_the_names_of_the_true_patterns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Presets that match panels by name see the panels of NeuralTailor's classes as strangers."""
    save(tmp_path / "belt.npz", standardised(garment()))
    names, out = tmp_path / "names.json", tmp_path / "out"
    names.write_text('["wb_front", "wb_back"]')
    assert run("neuraltailor", tmp_path / "belt.npz", out=out) == 0
    strangers = legacy_scores("neuraltailor", [read_pattern(out / "belt_specification.json")], [garment()])
    assert run("neuraltailor", tmp_path / "belt.npz", out=out, flags=("--panels", str(names))) == 0
    known = legacy_scores("neuraltailor", [read_pattern(out / "belt_specification.json")], [garment()])
    assert (strangers["stitch_recall"], known["stitch_recall"]) == (0.0, 1.0)
    names.write_text('["wb_front", "wb_front"]')
    assert run("neuraltailor", tmp_path / "belt.npz", out=out, flags=("--panels", str(names))) == 1
    assert "names.json: no list of names, each once" in capsys.readouterr().err


def test_sewformer_with_all_edges_of_a_panel_in_one_row(tmp_path: Path) -> None:
    arrays = sewformer.encode(garment())
    scaled = {
        name: torch.from_numpy(sewformer.SCALINGS[name].apply(getattr(arrays, name)))[None]
        for name in ("outlines", "rotations", "translations")
    }
    rows = scaled["outlines"].reshape(1, 25, 56)
    similarity = torch.from_numpy(arrays.edge_similarity.copy())[None]
    scores = torch.from_numpy(arrays.edge_cls.copy()).reshape(1, -1, 1)
    output = {**scaled, "outlines": rows, "edge_cls": scores, "edge_similarity": similarity}
    torch.save(output, tmp_path / "belt.pt")
    assert run("sewformer", tmp_path / "belt.pt", out=tmp_path / "out") == 0
    assert_perfect(tmp_path / "out" / "belt_0_specification.json", garment())


def test_sewingldm_as_rows_of_edges(tmp_path: Path) -> None:
    array = sewingldm.encode(garment())
    array[..., :19] = sewingldm.SCALING.apply(array[..., :19])
    np.save(tmp_path / "belt.npy", array.reshape(39 * 37, 29))
    assert run("sewingldm", tmp_path / "belt.npy", out=tmp_path / "out") == 0
    assert_perfect(tmp_path / "out" / "belt_specification.json", garment())


def test_garmentdiffusion_in_centimetres(tmp_path: Path) -> None:
    np.savez(tmp_path / "belts.npz", edges=garmentdiffusion.encode(garment())[None])
    assert run("garmentdiffusion", tmp_path / "belts.npz", out=tmp_path / "out", flags=("--raw",)) == 0
    assert_perfect(tmp_path / "out" / "belts_0_specification.json", garment())


def test_aipparel_tokens(tmp_path: Path) -> None:
    tokens = aipparel.encode(garment())
    scaled = {}
    for command, rows in tokens.values.items():
        if command == aipparel.MOVE:
            tops = aipparel.SCALINGS["translations"].apply(rows[:, :3])
            scaled[command] = np.concatenate([tops, rows[:, 3:]], axis=1).tolist()
        else:
            scaled[command] = aipparel.SCALINGS["vertices"].apply(rows.reshape(-1, 2)).reshape(rows.shape).tolist()
    (tmp_path / "belt.json").write_text(json.dumps({"tokens": tokens.tokens, "values": scaled}))
    assert run("aipparel", tmp_path / "belt.json", out=tmp_path / "out") == 0
    assert_perfect(tmp_path / "out" / "belt_specification.json", garment())


def test_losses_of_encodings_are_measured() -> None:
    found = {name: losses_of(again, [garment()]) for name, again in AGAIN.items()}
    assert all(fit == 1.0 and means["combinatorial"] == 1.0 for fit, means in found.values())
    many = Pattern("many", tuple(garment().panels[0] for _ in range(24)), ())
    fit, means = losses_of(AGAIN["NeuralTailor, 23 × 14 × 4"], [garment(), many])
    assert (fit, means["iou"]) == pytest.approx((0.5, 1.0))


# --------------------------------------------------------------------------------------------------------------- errors


class Evil:
    """An object whose pickle writes a file when it is loaded."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return Path.touch, (self.path,)


@pytest.mark.parametrize("suffix", ["npz", "npy", "pt"])
def test_pickled_objects_are_refused(suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trap, source = tmp_path / "trap", tmp_path / f"evil.{suffix}"
    evil = np.array([Evil(trap)], object)
    if suffix == "npz":
        np.savez(source, outlines=evil)
    elif suffix == "npy":
        np.save(source, evil)
    else:
        torch.save({"outlines": Evil(trap)}, source)
    assert run("neuraltailor", source, out=tmp_path / "out") == 1
    assert "cannot be read" in capsys.readouterr().err
    assert not trap.exists()


def one_line_of(capsys: pytest.CaptureFixture[str]) -> str:
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    return lines[0]


def test_one_failure_does_not_stop_the_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    parts = [standardised(garment()), standardised(garment())]
    parts[0]["outlines"] = np.full_like(parts[0]["outlines"], np.nan)
    save(tmp_path / "two.npz", {key: np.stack([part[key] for part in parts]) for key in parts[0]})
    assert run("neuraltailor", tmp_path / "two.npz", out=tmp_path / "out") == 0
    captured = capsys.readouterr()
    assert "importing.garments 1 garments\nimporting.failed 1 garments\n" in captured.out
    assert "two_0" in captured.err
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["two_1_specification.json"]


ARRAYS = {name: standardised(garment())[name] for name in ("outlines", "rotations", "translations")}


@pytest.mark.parametrize(
    ("form", "changed", "fault"),
    [
        ("neuraltailor", {"rotations": None}, "no array rotations among outlines, translations: save the network's"),
        ("neuraltailor", {"outlines": np.full_like(ARRAYS["outlines"], np.inf)}, "belt: outlines[0, 0, 0] is "),
        (
            "neuraltailor",
            {"outlines": ARRAYS["outlines"].reshape(-1)},
            "belt: outlines have shape (1288,), not (p",
        ),
        ("neuraltailor", {"outlines": ARRAYS["outlines"] * 1j}, "cannot be read (complex numbers): save plain arrays"),
        (
            "garmentdiffusion",
            {"edges": garmentdiffusion.encode(garment())},
            "belt: GarmentDiffusion published no scaling",
        ),
        ("aipparel", {}, "aipparel has no arrays: give a JSON file"),
    ],
)
def test_errors_name_file_place_and_remedy(
    form: str, changed: dict[str, Any], fault: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "belt.npz"
    save(source, {name: array for name, array in {**ARRAYS, **changed}.items() if array is not None})
    assert run(form, source, out=tmp_path / "out") == 1
    assert f"belt.npz: {fault}" in one_line_of(capsys)


@pytest.mark.parametrize("suffix", ["npz", "npy", "pt"])
def test_truncated_files_are_one_error(suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, array = tmp_path / f"belt.{suffix}", sewingldm.encode(garment())
    if suffix == "pt":
        torch.save({"samples": torch.from_numpy(array)}, source)
    elif suffix == "npz":
        np.savez(source, samples=array)
    else:
        np.save(source, array)
    source.write_bytes(source.read_bytes()[:50])
    assert run("sewingldm", source, out=tmp_path / "out") == 1
    assert f"belt.{suffix}: cannot be read (" in one_line_of(capsys)
