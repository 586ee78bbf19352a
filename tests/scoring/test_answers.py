"""Answers of published models, in files as they write them, become patterns."""

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
from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.metrics import score_pattern
from gcd_dataset.records import Edge, EdgeRef, Panel, Pattern, Placement, Seam
from gcd_dataset.scoring.answers import Answer, AnswerReader
from gcd_dataset.scoring.garments import garment_name
from gcd_dataset.spec import read_pattern, write_pattern
from gcd_dataset.tensors import encode_pattern

SEAMS = (Seam(EdgeRef("wb_front", 1), EdgeRef("wb_back", 3)), Seam(EdgeRef("wb_front", 3), EdgeRef("wb_back", 1)))

BELT = ("wb_front", "wb_back")


def garment(name: str = "belt", width: float = 30.0) -> Pattern:
    corners = np.array([[0.0, 0.0], [width, 0.0], [width, 8.0], [0.0, 8.0]])
    edges = tuple(Edge(i, (i + 1) % 4) for i in range(4))
    front = Panel("wb_front", corners, edges, Placement(np.array([-width / 2, 100.0, 15.0]), np.zeros(3)))
    back = Panel("wb_back", corners, edges, Placement(np.array([width / 2, 100.0, -15.0]), np.array([0.0, np.pi, 0.0])))
    return Pattern(name, (front, back), SEAMS)


def read(form: str, path: Path, **options: Any) -> dict[str, Answer]:
    return dict(AnswerReader(form, **options).read_file(path))


def standardised(pattern: Pattern) -> dict[str, np.ndarray]:
    """NeuralTailor's output for a pattern, in the network's units."""
    arrays = neuraltailor.encode(pattern)
    scaled = {name: neuraltailor.SCALINGS[name].apply(getattr(arrays, name)) for name in ("outlines", "rotations")}
    scaled["translations"] = neuraltailor.SCALINGS["translations"].apply(arrays.translations)
    return {**scaled, "stitch_tags": arrays.stitch_tags, "free_edges_mask": arrays.free_edges}


def save(path: Path, arrays: dict[str, np.ndarray], **others: np.ndarray) -> None:
    both: dict[str, Any] = {**arrays, **others}
    np.savez(path, **both)


def assert_perfect(answer: Answer, true: Pattern) -> None:
    assert answer.pattern is not None, answer.failure
    score = score_pattern(answer.pattern, true)
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
    found = read("", source)["skirt"].pattern
    assert found is not None
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
    assert_perfect(AnswerReader("neuraltailor").read(tmp_path / "predictions")["belt"], garment(width=30.0))


def test_faults_of_networks_are_repaired_and_named(tmp_path: Path) -> None:
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
    answer = read("sewformer", source)["odd"]
    said = "; ".join(answer.remarks)
    for fault in (
        "panel nothing: no edge",
        "panel front: edge 1: its arc is too small",
        "panel front: its outline does not close: closed by a straight edge",
        "2 of 3 seams to missing edges",
        "panel_order: did not name every panel once",
    ):
        assert fault in said
    found = answer.pattern
    assert found is not None
    assert [panel.name for panel in found.panels] == ["front", "back"]
    assert [edge.end for edge in found.panel("front").edges][-1] == found.panel("front").edges[0].start
    assert len(found.panel("front").edges) == 5


# --------------------------------------------------------------------------------------------------------------- arrays


def test_a_batch_of_garments_with_names(tmp_path: Path) -> None:
    parts = [standardised(garment(width=width)) for width in (30.0, 50.0)]
    batch = {key: np.stack([part[key] for part in parts]) for key in parts[0]}
    save(tmp_path / "batch.npz", batch, names=np.array(["thin", "wide"]))
    assert_perfect(read("neuraltailor", tmp_path / "batch.npz")["wide"], garment(width=50.0))
    tensors = {key: torch.from_numpy(value.copy()).requires_grad_() for key, value in batch.items()}
    torch.save(tensors, tmp_path / "batch.pt")
    assert_perfect(read("neuraltailor", tmp_path / "batch.pt")["batch_1"], garment(width=50.0))


def test_panels_get_the_names_of_the_true_patterns(tmp_path: Path) -> None:
    """Presets that match panels by name see the panels of NeuralTailor's classes as strangers."""
    save(tmp_path / "belt.npz", standardised(garment()))
    strangers, known = (
        legacy_scores(
            "neuraltailor", [read("neuraltailor", tmp_path / "belt.npz", panels=names)["belt"].pattern], [garment()]
        )
        for names in ((), ("wb_front", "wb_back"))
    )
    assert (strangers["stitch_recall"], known["stitch_recall"]) == (0.0, 1.0)


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
    assert_perfect(read("sewformer", tmp_path / "belt.pt")["belt_0"], garment())


def test_sewingldm_as_rows_of_edges(tmp_path: Path) -> None:
    array = sewingldm.encode(garment())
    array[..., :19] = sewingldm.SCALING.apply(array[..., :19])
    np.save(tmp_path / "belt.npy", array.reshape(39 * 37, 29))
    assert_perfect(read("sewingldm", tmp_path / "belt.npy")["belt"], garment())


def test_garmentdiffusion_in_centimetres(tmp_path: Path) -> None:
    np.savez(tmp_path / "belts.npz", edges=garmentdiffusion.encode(garment())[None])
    assert_perfect(read("garmentdiffusion", tmp_path / "belts.npz", raw=True)["belts_0"], garment())


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
    assert_perfect(read("", tmp_path / "belt.json")["belt"], garment())


def test_arrays_of_a_pattern_tensor(tmp_path: Path) -> None:
    tensor = encode_pattern(garment())
    save(tmp_path / "belt.npz", {"panels": tensor.panels, "edges": tensor.edges, "stitches": tensor.stitches})
    assert_perfect(read("", tmp_path / "belt.npz")["belt"], garment())


def test_flattened_panels_are_chained_and_sewn_along_their_curves(tmp_path: Path) -> None:
    """Edges of a panel in any order and direction, as ReWeaver answers them; its panels have no place in space."""
    panels = {}
    for number, (panel, curves) in enumerate(zip(garment().panels, ((0, 1, 2, 3), (4, 3, 5, 1)), strict=True)):
        lines = [np.linspace(*panel.edge_ends(k), 9).tolist() for k in range(4)]
        order = (2, 0, 3, 1)
        points = [lines[k] if k % 2 else lines[k][::-1] for k in order]
        panels[str(number)] = {"edge_points": points, "curves": [curves[k] for k in order]}
    (tmp_path / "belt.json").write_text(json.dumps({"panels": panels}))
    answer = read("", tmp_path / "belt.json")["belt"]
    assert answer.pattern is not None, answer.failure
    score = score_pattern(answer.pattern, garment())
    assert (score.iou, score.garment_perfect, score.panel_f1) == pytest.approx((1.0, 1.0, 1.0), abs=1e-6)


def test_a_design_is_drawn_for_the_body_of_its_garment(tmp_path: Path) -> None:
    (tmp_path / "belt_design_params.yaml").write_text("design: {meta: {bottom: {v: PencilSkirt}}}")
    (tmp_path / "odd_design_params.yaml").write_text("design: {meta: {bottom: {v: Kilt}}}")
    size = measure(build_body(neutral_shape()))
    found = AnswerReader(size_of=lambda name: size).read(tmp_path)
    drawn = draw_garment(size, design_from_dict({"meta": {"bottom": "PencilSkirt"}}))
    assert_perfect(found["belt"], drawn)
    assert "Kilt" in found["odd"].failure
    assert "give --bodies" in AnswerReader().read(tmp_path)["belt"].failure


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
def test_pickled_objects_are_refused(suffix: str, tmp_path: Path) -> None:
    trap, source = tmp_path / "trap", tmp_path / f"evil.{suffix}"
    evil = np.array([Evil(trap)], object)
    if suffix == "npz":
        np.savez(source, outlines=evil)
    elif suffix == "npy":
        np.save(source, evil)
    else:
        torch.save({"outlines": Evil(trap)}, source)
    assert "cannot be read" in read("neuraltailor", source)["evil"].failure
    assert not trap.exists()


def test_one_failure_does_not_stop_the_others(tmp_path: Path) -> None:
    parts = [standardised(garment()), standardised(garment())]
    parts[0]["outlines"] = np.full_like(parts[0]["outlines"], np.nan)
    save(tmp_path / "two.npz", {key: np.stack([part[key] for part in parts]) for key in parts[0]})
    found = read("neuraltailor", tmp_path / "two.npz")
    assert found["two_0"].pattern is None and "nan" in found["two_0"].failure
    assert_perfect(found["two_1"], garment())


ARRAYS = {name: standardised(garment())[name] for name in ("outlines", "rotations", "translations")}


@pytest.mark.parametrize(
    ("form", "changed", "fault"),
    [
        ("neuraltailor", {"rotations": None}, "no array rotations among outlines, translations: save the network's"),
        ("neuraltailor", {"outlines": np.full_like(ARRAYS["outlines"], np.inf)}, "outlines[0, 0, 0] is "),
        (
            "neuraltailor",
            {"outlines": ARRAYS["outlines"].reshape(-1)},
            "outlines have shape (1288,), not (p",
        ),
        ("neuraltailor", {"outlines": ARRAYS["outlines"] * 1j}, "cannot be read (complex numbers): save plain arrays"),
        (
            "garmentdiffusion",
            {"edges": garmentdiffusion.encode(garment())},
            "GarmentDiffusion published no scaling",
        ),
        ("aipparel", {}, "aipparel has no arrays: give a JSON file"),
    ],
)
def test_failures_name_place_and_remedy(form: str, changed: dict[str, Any], fault: str, tmp_path: Path) -> None:
    source = tmp_path / "belt.npz"
    save(source, {name: array for name, array in {**ARRAYS, **changed}.items() if array is not None})
    assert read(form, source)["belt"].failure.startswith(fault)


@pytest.mark.parametrize("suffix", ["npz", "npy", "pt"])
def test_truncated_files_are_failures(suffix: str, tmp_path: Path) -> None:
    source, array = tmp_path / f"belt.{suffix}", sewingldm.encode(garment())
    if suffix == "pt":
        torch.save({"samples": torch.from_numpy(array)}, source)
    elif suffix == "npz":
        np.savez(source, samples=array)
    else:
        np.save(source, array)
    source.write_bytes(source.read_bytes()[:50])
    assert read("sewingldm", source)["belt"].failure.startswith("cannot be read (")
