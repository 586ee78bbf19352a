"""A stranger's model on the scoreboard, with four commands and nothing of ours imported."""

import json
import subprocess
import sys
from pathlib import Path

MODEL = """
import json, math, pathlib, sys
inputs, answers = map(pathlib.Path, sys.argv[1:])
answers.mkdir()
for path in inputs.glob("*.json"):
    spec = json.loads(path.read_text())
    free = []
    for name, panel in spec["pattern"]["panels"].items():
        for row, edge in enumerate(panel["edges"]):
            a, b = (panel["vertices"][k] for k in edge["endpoints"])
            free.append((math.dist(a, b), name, row))
    free.sort()
    pairs = zip(free[::2], free[1::2])  # edges of equal length are sewn together
    spec["pattern"]["stitches"] = [[{"panel": p, "edge": e} for _, p, e in pair] for pair in pairs]
    (answers / path.name).write_text(json.dumps(spec))
"""
CARD = 'name = "equal lengths"\ngarments = 0\nminutes = 0\nweights = 0\nhardware = "none"\n'


def test_a_stranger_is_on_the_board_after_four_commands(tmp_path: Path) -> None:
    (tmp_path / "model.py").write_text(MODEL)
    (tmp_path / "card.toml").write_text(CARD)
    gcd = [sys.executable, "-m", "gcd_dataset", "bench"]
    submit = ["submit", "answers", "t3", "--card", "card.toml", "--out", "result.json", "--quiet"]
    for command in (
        [*gcd, "inputs", "T3", "t3", "--mini", "--quiet"],
        [sys.executable, "-I", "model.py", "t3/inputs", "answers"],
        [*gcd, *submit],
        [*gcd, "board", "result.json"],
    ):
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    assert "| 1 | equal lengths |" in done.stdout
    figures = json.loads((tmp_path / "result.json").read_text())["figures"]
    assert figures["iou"]["mean"] > 0.999  # a joined edge is one curve, within 2 mm
    assert 0.0 < figures["stitch_f1"]["mean"] < 0.9
