"""``gcd score``, as its users run it."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gcd_dataset.cli import main
from gcd_dataset.faults import MOST_EDGES, MOST_PANELS
from gcd_dataset.metrics import PatternScore
from gcd_dataset.records import InnerLine, Pattern
from gcd_dataset.spec import spec_from_pattern, write_pattern
from tests.generator.mesh.shapes import panel
from tests.test_metrics import SAME, garment

Capture = pytest.CaptureFixture[str]
NO_PATTERN = "; if bodies.json is no true pattern, move it elsewhere"
POINTS = np.random.default_rng(0).uniform(size=(100, 3))


def save(folder: Path, patterns: dict[str, Pattern], *, order: bool = True, ending: str = "") -> Path:
    folder.mkdir()
    for name, pattern in patterns.items():
        tree = spec_from_pattern(pattern)
        if not order:
            del tree["pattern"]["panel_order"]
        (folder / f"{name}{ending}.json").write_text(json.dumps(tree))
    return folder


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    return save(tmp_path / "truth", dict.fromkeys("abcd", garment()), ending="_specification")


def figures(printed: str) -> dict[str, float]:
    """The figures of lines ``score.metric value unit …``."""
    lines = [line.split() for line in printed.splitlines() if line.startswith("score.")]
    return {name.removeprefix("score."): float(value) for name, value, *_ in lines}


def run(*arguments: object) -> int:
    return main(["score", *map(str, arguments), "--quiet"])


def test_copies_are_perfect_however_they_are_written(tmp_path: Path, truth: Path, capsys: Capture) -> None:
    """Without ``panel_order``, in another order, renamed, started elsewhere and drawn from behind."""
    ours = dict(
        zip("abcd", (SAME[change](garment()) for change in ("copied", "renamed", "shuffled", "all of it")), strict=True)
    )
    assert run(save(tmp_path / "ours", ours, order=False), truth) == 0
    printed = capsys.readouterr()
    found = figures(printed.out)
    assert set(PatternScore.__dataclass_fields__) <= found.keys()
    assert (found["garments"], found["failed"]) == (4, 0)
    for name in ("iou", "stitch_f1", "panel_count_acc", "edge_count_acc", "combinatorial", "garment_perfect"):
        assert found[name] == 1, name
    for name in ("panel_l2", "transl_cm", "boxmesh_cd", "seam_mismatch"):
        assert found[name] == pytest.approx(0, abs=1e-2), name
    assert printed.err == ""


def test_an_answer_with_a_line_from_nowhere_is_not_valid(tmp_path: Path, truth: Path, capsys: Capture) -> None:
    """Lines are not scored, but they are cut with the panel."""
    first, *others = garment().panels
    lined = replace(garment(), panels=(replace(first, lines=(InnerLine(0, 99),)), *others))
    assert run(save(tmp_path / "ours", {"a": garment(), "b": lined}), truth) == 0
    printed = capsys.readouterr()
    found = figures(printed.out)
    assert (found["iou"], found["valid"]) == (0.5, 0.25)
    assert "panel front, line 0: no vertex 0 or 99: correct its ends; not valid" in printed.out


def test_every_garment_is_in_the_denominator(tmp_path: Path, truth: Path, capsys: Capture) -> None:
    """One perfect, one unreadable, one without panels, one missing: a quarter."""
    ours = save(tmp_path / "ours", {"a": garment(), "c": Pattern("", (), ()), "z": garment()})
    (ours / "b.json").write_text('{"pattern": {')
    assert run(ours, truth, "--json", tmp_path / "out.json") == 0
    printed = capsys.readouterr()
    found = figures(printed.out)
    assert (found["garments"], found["failed"]) == (4, 3)
    for name in ("iou", "stitch_f1", "stitch_nm_f1", "combinatorial", "valid", "panel_f1"):
        assert found[name] == 0.25, name
    assert found["transl_cm"] == pytest.approx(30)
    assert found["boxmesh_cd"] == pytest.approx(75)
    table = {line.split()[0]: line for line in printed.out.splitlines() if line[:2] in ("a ", "b ", "c ", "d ")}
    assert "line 1, column 14" in table["b"]
    assert "no answer" in table["d"]
    assert "no panel with an edge" in table["c"]
    assert "1 of 4 garments without an answer, all failures: d" in printed.err
    assert "answers without a true pattern, not scored: 1: z" in printed.err
    tree = json.loads((tmp_path / "out.json").read_text())
    assert [row["iou"] for row in tree["garments"]] == pytest.approx([1, 0, 0, 0], abs=1e-9)
    assert tree["figures"]["iou"]["low"] <= 0.25 <= tree["figures"]["iou"]["high"]


def test_a_prediction_beyond_the_limits_of_size_is_a_failure(tmp_path: Path, truth: Path, capsys: Capture) -> None:
    """To match 20,000 edges takes gigabytes."""
    angles, whole = np.linspace(0, 2 * np.pi, MOST_EDGES + 1, endpoint=False), garment()
    disc = panel("disc", [(30 * np.cos(angle), 30 * np.sin(angle)) for angle in angles])
    many = tuple(replace(whole.panels[0], name=f"panel {k}") for k in range(MOST_PANELS + 1))
    ours = {"a": replace(whole, panels=(*whole.panels, disc)), "b": Pattern("", many, ()), "c": whole, "d": whole}
    assert run(save(tmp_path / "ours", ours), truth) == 0
    printed = capsys.readouterr().out
    assert (figures(printed)["failed"], figures(printed)["iou"]) == (2, 0.5)
    assert f"panel disc: error: too many edges: {MOST_EDGES + 1}" in printed
    assert f"too many panels: {MOST_PANELS + 1}" in printed


def test_kinds_apart(tmp_path: Path, capsys: Capture) -> None:
    kinds = {"a": "cape", "b": "cape", "c": "tea gown"}
    patterns = {name: replace(garment(), extra={"properties": {"kind": kind}}) for name, kind in kinds.items()}
    true = save(tmp_path / "true", patterns)
    assert run(save(tmp_path / "ours", {"a": garment(), "c": garment()}), true, "--by-kind") == 0
    found = figures(capsys.readouterr().out)
    assert (found["cape.garments"], found["cape.iou"], found["tea_gown.iou"]) == (2, 0.5, 1)
    assert found["iou"] == pytest.approx(2 / 3, abs=1e-4)


@pytest.mark.parametrize(
    ("name", "content", "place"),
    [
        *(("bodies.json", content, NO_PATTERN) for content in ("[]", '{"pattern": 5}', "no JSON")),
        ("b_specification.json", "{", "line 1"),
        ("b_specification.json", '{"pattern": {"panels": {"p": {"vertices": [[0, 0]], "edges": 3}}}}', "panel p"),
        ("b_specification.json", '{"pattern": {"panels": {}}}', "without panels"),
        (
            "b_specification.json",
            '{"pattern": {"panels": {"p": {"vertices": [[0, 0], [9, 0], [9, 9]], "edges": '
            '[{"endpoints": [0, 1]}, {"endpoints": [1, 2]}]}}}}',
            "panel p, edge 0",
        ),
    ],
)
def test_true_patterns_must_be_readable(
    name: str, content: str, place: str, tmp_path: Path, truth: Path, capsys: Capture
) -> None:
    (truth / name).write_text(content)
    assert run(save(tmp_path / "ours", {"a": garment()}), truth) == 1
    [line] = capsys.readouterr().err.strip().splitlines()[-1:]
    assert line.startswith("gcd score: ")
    assert f"{name}: " in line and place in line


def test_missing_bodies_and_folders_are_errors_at_once(tmp_path: Path, truth: Path, capsys: Capture) -> None:
    ours, bodies = save(tmp_path / "ours", {"a": garment()}), tmp_path / "bodies"
    bodies.mkdir()
    for name in "abc":
        np.save(bodies / f"{name}.npy", np.zeros(3))
    assert run(ours, truth, "--drape", "--bodies", bodies) == 1
    assert "no body for d" in capsys.readouterr().err
    assert run(ours, truth, "--json", tmp_path / "nowhere" / "out.json") == 1
    assert "no such folder" in capsys.readouterr().err
    assert run(ours, truth, "--json", bodies) == 1
    assert f"{bodies}: a folder: give a file" in capsys.readouterr().err
    for missing in ("nowhere", tmp_path / "nowhere"):
        assert run(ours, truth, "--drape", "--bodies", missing) == 1
        [line] = [line for line in capsys.readouterr().err.splitlines() if "nowhere" in line]
        assert f"{missing}: no such folder, and no body named" in line


def test_hashes_tell_what_predictions_were_scored_against(
    tmp_path: Path, truth: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of drapes that nobody computes: only what is written beside the scores matters."""
    monkeypatch.setattr("gcd_dataset.scoring.draping.with_drapes", lambda garments, *_, **__: iter(garments))
    ours, bodies, inputs = save(tmp_path / "ours", {"a": garment()}), tmp_path / "bodies", tmp_path / "inputs"
    for folder in (bodies, inputs):
        folder.mkdir()
        for name in "abcd":
            np.save(folder / f"{name}.npy", 80 * POINTS)

    def settings(*options: Any) -> dict[str, Any]:
        assert run(ours, truth, "--json", tmp_path / "out.json", *options) == 0
        return dict(json.loads((tmp_path / "out.json").read_text())["settings"])

    draped = ("--drape", "--bodies", bodies, "--inputs", inputs)
    first = settings(*draped)
    assert first["resolution"] == 2.0
    assert first["hashes"].keys() == {"truth", "bodies", "inputs"}
    assert settings(*draped)["hashes"] == first["hashes"]
    assert settings("--drape")["hashes"] == settings("--drape", "--bodies", "neutral")["hashes"]
    assert settings()["hashes"] == {"truth": first["hashes"]["truth"]}
    changed = {"bodies": bodies / "a.npy", "inputs": inputs / "b.npy", "truth": truth / "c_specification.json"}
    for name, path in changed.items():
        before = settings(*draped)["hashes"]
        if name == "truth":
            write_pattern(replace(garment(), seams=()), path)
        else:
            np.save(path, 90 * POINTS)
        after = settings(*draped)["hashes"]
        assert {key for key in after if after[key] != before[key]} == {name}
