"""Answers of published models, in files as they write them, become patterns."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.metrics import score_pattern
from gcd_dataset.records import Closure, EdgeRef, InnerLine, Pattern, Seam
from gcd_dataset.scoring.answers import Answer, AnswerReader
from gcd_dataset.scoring.garments import garment_name
from gcd_dataset.spec import write_pattern
from gcd_dataset.tensors import PanelColumn, encode_pattern
from tests.generator.mesh import shapes

SEAMS = (Seam(EdgeRef("wb_front", 1), EdgeRef("wb_back", 3)), Seam(EdgeRef("wb_front", 3), EdgeRef("wb_back", 1)))


def garment(name: str = "belt", width: float = 30.0) -> Pattern:
    front = shapes.panel("wb_front", shapes.rectangle(width, 8.0), at=(-width / 2, 100.0, 15.0))
    back = shapes.panel("wb_back", shapes.rectangle(width, 8.0), at=(width / 2, 100.0, -15.0), turned=np.pi)
    return Pattern(name, (front, back), SEAMS)


def read(path: Path) -> Answer:
    return AnswerReader().read_file(path)


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
    assert_perfect(AnswerReader().read(tmp_path / "predictions")["belt"], garment(width=30.0))


def test_of_other_kinds_of_files_those_asked_for_are_read(tmp_path: Path) -> None:
    """One report in JSON hid all answers in arrays."""
    (tmp_path / "scores.json").write_text("{}")
    tensor = encode_pattern(garment())
    for name in ("belt", "other"):
        save(tmp_path / f"{name}.npz", {key: getattr(tensor, key) for key in ("panels", "edges", "stitches")})
    found = AnswerReader().read(tmp_path, ["belt", "sash"])
    assert found.keys() == {"scores", "belt"}
    assert_perfect(found["belt"], garment())


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
    answer = AnswerReader(repair=True).read_file(source)
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


def test_arrays_of_a_pattern_tensor(tmp_path: Path) -> None:
    tensor = encode_pattern(garment())
    save(tmp_path / "belt.npz", {"panels": tensor.panels, "edges": tensor.edges, "stitches": tensor.stitches})
    assert_perfect(read(tmp_path / "belt.npz"), garment())
    first, second = garment().panels
    lined = replace(garment(), panels=(replace(first, lines=(InnerLine(0, 2),)), second))
    seam = Seam(EdgeRef(first.name, 4), EdgeRef(second.name, 0), True, Closure.BUTTONS, (0.0, 0.5))
    tensor = encode_pattern(replace(lined, seams=(*lined.seams[:-1], seam)))
    named = {key: getattr(tensor, key) for key in ("panels", "edges", "stitches", "closures", "lines")}
    save(tmp_path / "belt.npz", named)
    found = read(tmp_path / "belt.npz").pattern
    assert found is not None
    assert found.panels[0].lines[0].end == 2
    assert (found.seams[-1].left.edge, found.seams[-1].closure) == (4, Closure.BUTTONS)
    save(tmp_path / "belt.npz", named | {"closures": np.zeros((1, 3))})
    assert "closures" in read(tmp_path / "belt.npz").failure


def test_flattened_panels_are_chained_and_sewn_along_their_curves(tmp_path: Path) -> None:
    """Edges of a panel in any order and direction, as ReWeaver answers them; its panels have no place in space."""
    panels = {}
    for number, (panel, curves) in enumerate(zip(garment().panels, ((0, 1, 2, 3), (4, 3, 5, 1)), strict=True)):
        lines = [np.linspace(*panel.edge_ends(k), 9).tolist() for k in range(4)]
        order = (2, 0, 3, 1)
        points = [lines[k] if k % 2 else lines[k][::-1] for k in order]
        panels[str(number)] = {"edge_points": points, "curves": [curves[k] for k in order]}
    (tmp_path / "belt.json").write_text(json.dumps({"panels": panels}))
    answer = read(tmp_path / "belt.json")
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


def test_pickled_objects_are_refused(tmp_path: Path) -> None:
    trap = tmp_path / "trap"
    np.savez(tmp_path / "evil.npz", panels=np.array([Evil(trap)], object), edges=[], stitches=[])
    assert "cannot be read" in read(tmp_path / "evil.npz").failure
    assert not trap.exists()


class Evil:
    """An object whose pickle writes a file when it is loaded."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return Path.touch, (self.path,)


def test_damaged_arrays_are_failures(tmp_path: Path) -> None:
    """Wherever a byte of the compressed numbers is wrong; and a file that is encrypted."""
    tensor = encode_pattern(garment())
    path = tmp_path / "belt.npz"
    np.savez_compressed(path, panels=tensor.panels, edges=tensor.edges, stitches=tensor.stitches)
    content = path.read_bytes()
    for place in range(60, content.index(b"edges.npy") - 30, 5):
        path.write_bytes(content[:place] + bytes([content[place] ^ 0xFF]) + content[place + 1 :])
        assert read(path).failure, place
    panels = tensor.panels.copy()
    panels[0, PanelColumn.ANGLE_Y] = np.inf
    save(path, {"panels": panels, "edges": tensor.edges, "stitches": tensor.stitches})
    assert "an angle of a panel is infinite" in read(path).failure
    flags = content.index(b"PK\x01\x02") + 8
    path.write_bytes(content[:flags] + b"\x01" + content[flags + 1 :])
    assert "cannot be read" in read(path).failure


@pytest.mark.parametrize(
    ("name", "content", "fault"),
    [
        ("belt.json", b'{"pattern": {', "line 1"),
        ("belt.json", b'{"panels": {"0": {"edge_points": [[[0, 0]], 5]}}}', "edge_points are no lists of points"),
        ("belt.json", b'{"panels": {"0": {"edge_points": [], "curves": [[1]]}}}', "curves must be numbers"),
        ("belt.json", b'{"panels": {"0": {"edge_points": [[[0, 1' + 400 * b"0" + b"]]]}}}", "no lists of points"),
        ("belt.npz", b"PK", "cannot be read"),
        ("belt_design_params.yaml", b"design: 5", "design"),
    ],
)
def test_failures_name_the_place(name: str, content: bytes, fault: str, tmp_path: Path) -> None:
    """And the answer beside it is read."""
    (tmp_path / name).write_bytes(content)
    write_pattern(garment("other"), tmp_path / "other.json")
    answer = AnswerReader(size_of=lambda _: measure(build_body(neutral_shape()))).read_file(tmp_path / name)
    assert answer.pattern is None and fault in answer.failure
    if name.endswith(".json"):
        assert_perfect(AnswerReader().read(tmp_path)["other"], garment("other"))
