"""Edges joined as a tailor draws them, and answers to them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from gcd_dataset.metrics import score_pattern
from gcd_dataset.records import EdgeRef, Pattern, Seam
from gcd_dataset.scoring.inputs import TASKS
from gcd_dataset.scoring.joining import joined
from gcd_dataset.spec import read_pattern, spec_from_pattern
from tests.generator.mesh.shapes import panel

SLEEVE = panel("sleeve", [(0, 0), (30, 0), (30, 40), (18, 40), (0, 40)], at=(0, 0, 0))
FRONT = panel("front", [(0, 0), (12, 0), (12, 50), (0, 50)], at=(18, 41, 0))
BACK = panel("back", [(0, 0), (18, 0), (18, 50), (0, 50)], at=(0, 41, 0))
CAP = (Seam(EdgeRef("sleeve", 2), EdgeRef("front", 0)), Seam(EdgeRef("sleeve", 3), EdgeRef("back", 0)))
TRUE = Pattern("shirt", (SLEEVE, FRONT, BACK), CAP)


def test_a_sleeve_cap_is_one_edge_without_a_trace_of_its_parts() -> None:
    found = joined(TRUE)
    assert [len(each.edges) for each in found.panels] == [4, 4, 4]
    assert [len(each.vertices) for each in found.panels] == [4, 4, 4]
    assert not found.seams
    one_panel = replace(TRUE, seams=(CAP[0], Seam(EdgeRef("sleeve", 3), EdgeRef("front", 2))))
    assert len(joined(one_panel).panels[0].edges) == 5  # both parts are sewn to the front


def test_an_answer_may_part_the_edge_or_sew_it_twice(tmp_path: Path) -> None:
    """The cap of 30 cm, cut at 12.5 instead of 12 cm, or sewn whole to both; not cut in the middle."""
    cap = EdgeRef("sleeve", next(k for k, edge in enumerate(joined(TRUE).panels[0].edges) if edge_at(k) == 40))
    twice = replace(joined(TRUE), seams=(Seam(EdgeRef("back", 0), cap), Seam(cap, EdgeRef("front", 0))))
    assert score_pattern(twice, TRUE).stitch_nm_perfect == 1
    for place, right in ((17.5, 1), (15.0, 0)):
        corners = SLEEVE.vertices.copy()
        corners[3] = place, 40
        answer = replace(TRUE, panels=(replace(SLEEVE, vertices=corners), FRONT, BACK))
        assert score_pattern(answer, TRUE).stitch_nm_perfect == right
    item = {"spec": {**spec_from_pattern(TRUE), "properties": {}}, "meta": {"index": 0}}
    for task, count in (("T3", 12), ("T3-subdivided", 13)):
        TASKS[task].write(item, tmp_path / task)
        panels = json.loads((tmp_path / f"{task}.json").read_text())["pattern"]["panels"]
        assert sum(len(each["edges"]) for each in panels.values()) == count
        assert len(read_pattern(tmp_path / f"{task}.json").panels) == 3


def edge_at(k: int) -> float:
    """Least height of an edge of the joined sleeve [cm]."""
    return float(np.array(joined(TRUE).panels[0].edge_ends(k))[:, 1].min())
