"""Scores of stitches: up to symmetry, by kind of garment, and of files of the latest run alone."""

from dataclasses import astuple, fields, replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.reconstruction.stitching.graphs import graph_of
from benchmarks.reconstruction.stitching.run import _by_kind, write
from benchmarks.reconstruction.stitching.scores import StitchScore, congruences, random_symmetry, score_stitches
from gcd_dataset.records import EdgeRef, Pattern, Seam
from tests.benchmarks.reconstruction.sewn_patterns import (
    ARMHOLE_L,
    ARMHOLE_R,
    CAP_1,
    CAP_2,
    panel,
    rectangle,
    rows_of,
    t_shirt,
    tube,
)


def test_congruent_panels_are_exchangeable_and_mirror_images_are_not() -> None:
    slanted = panel("a", [(0, 0), (30, 0), (30, 20), (5, 10)], {}, (0, 0, 0))
    flipped = panel("b", [(0, 0), (30, 0), (25, 10), (0, 20)], {}, (0, 0, 0))
    assert set(congruences(graph_of(Pattern("p", (slanted, flipped), ())))) == {(0, 0), (1, 1)}
    square = congruences(graph_of(Pattern("p", (rectangle("a", 9, 9), rectangle("b", 9, 9)), ())))
    assert square == {(i, j): [0, 1, 2, 3] for i in (0, 1) for j in (0, 1)}
    assert congruences(graph_of(t_shirt()))[2, 3] == [0]


def test_exchanged_belts_are_right_up_to_symmetry() -> None:
    graph, rows = graph_of(tube()), rows_of(tube())
    exchanged = [(left, (right + 4 - 8) % 8 + 8 if left < 8 <= right else right) for left, right in rows]
    score = score_stitches(graph, exchanged)
    assert (score.perfect, score.perfect_symmetric) == (0.0, 1.0)
    assert score.f1 == pytest.approx(4 / 6)


def test_without_answers_nothing_is_right() -> None:
    """As the evaluator counts: no precision without predicted seams, unless the truth has none, either."""
    score = score_stitches(graph_of(t_shirt()), [])
    assert (score.precision, score.recall, score.f1) == (0.0, 0.0, 0.0)
    bare = graph_of(replace(t_shirt(), seams=()))
    assert set(astuple(score_stitches(bare, []))) == {1.0}
    excess = score_stitches(bare, rows_of(t_shirt()))
    assert (excess.precision, excess.recall, excess.f1) == (0.0, 0.0, 0.0)


def test_half_an_exchange_is_wrong() -> None:
    rows = rows_of(t_shirt())
    one, two = rows.index((ARMHOLE_R, 16 + CAP_2)), rows.index((ARMHOLE_L, 21 + CAP_1))
    half = list(rows)
    half[one], half[two] = (ARMHOLE_R, 21 + CAP_1), (ARMHOLE_L, 16 + CAP_2)
    score = score_stitches(graph_of(t_shirt()), half)
    assert score.f1 == pytest.approx(0.8)
    assert score.perfect_symmetric == 0.0


@pytest.mark.parametrize("seed", range(4))
def test_every_symmetry_of_the_truth_is_right(seed: int) -> None:
    """A ring of six equal gores: any cycle of them is the same skirt."""
    rng = np.random.default_rng(seed)
    gores = tuple(panel(f"{k}", [(0, 0), (20, 0), (15, 50), (5, 50)], {}, (0, 0, 0)) for k in range(6))
    ring = [Seam(EdgeRef(f"{k}", 1), EdgeRef(f"{(k + 1) % 6}", 3)) for k in range(6)]
    graph, order = graph_of(Pattern("skirt", gores, tuple(ring))), rng.permutation(6).tolist()
    cycle = [(4 * order[k] + 1, 4 * order[(k + 1) % 6] + 3) for k in range(6)]
    assert score_stitches(graph, cycle).perfect_symmetric == 1.0
    two_rings = [(4 * a + 1, 4 * b + 3) for a, b in ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3))]
    assert score_stitches(graph, two_rings).perfect_symmetric == 0.0


def test_a_random_symmetry_of_the_truth_is_right() -> None:
    graph = graph_of(tube())
    images = [random_symmetry(graph, np.random.default_rng(seed)) for seed in range(8)]
    scores = [score_stitches(graph, [(moved[a], moved[b]) for a, b in rows_of(tube())]) for moved in images]
    assert all(sorted(moved) == list(range(16)) for moved in images)
    assert {score.perfect_symmetric for score in scores} == {1.0}
    assert min(score.f1 for score in scores) < 1.0


def test_stitches_on_edges_that_the_truth_lacks_are_wrong() -> None:
    rows = rows_of(t_shirt())
    score = score_stitches(graph_of(t_shirt()), rows, others=2)
    assert score.precision == pytest.approx(10 / 12)
    assert score.recall == 1.0


def test_answers_of_an_earlier_run_are_removed(tmp_path: Path) -> None:
    patterns = [replace(t_shirt(), name=f"1_{k:09d}") for k in range(3)]
    (tmp_path / "own.json").write_text("{}")
    write(tmp_path, patterns)
    write(tmp_path, patterns[:2])
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "1_000000000_specification.json", "1_000000001_specification.json", "own.json",
    ]  # fmt: skip


def test_scores_of_kinds_leave_out_missing_ones() -> None:
    """A kind without seams n to m has none."""
    best, least = (StitchScore(*[value] * len(fields(StitchScore))) for value in (1.0, 0.0))
    assert _by_kind(["skirt", "dress", "skirt"], [best, least, least]) == {"dress": [least], "skirt": [best, least]}
    assert _by_kind(["skirt", "dress", "skirt"], [best, None, least]) == {"skirt": [best, least]}
