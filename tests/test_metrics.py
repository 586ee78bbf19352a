"""Scores depend on the garment only, not on names, order, loop starts or local origins."""

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gcd_dataset.curves import LINE, Arc, Curve, Quadratic, mirrored
from gcd_dataset.metrics import PatternScore, bootstrap_means, failed_score, mean_scores, score_pattern
from gcd_dataset.records import Edge, EdgeRef, Panel, Pattern, Placement, Seam
from gcd_dataset.spec import euler_angles, read_pattern
from tests import helpers
from tests.generator.mesh import shapes

PERFECT = PatternScore(1, 1, 1, 1, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0)


def panel(
    name: str, corners: list[tuple[float, float]], place: tuple[float, float, float], curve: Curve = LINE
) -> Panel:
    return shapes.panel(name, corners, curves={0: curve}, at=place, turned=0.3)


def garment() -> Pattern:
    """Front and back are congruent, as in skirts: they differ by placement only."""
    skirt = [(0.0, 0.0), (44.0, 0.0), (38.0, 60.0), (6.0, 60.0)]
    sleeve = [(0.0, 0.0), (30.0, 0.0), (33.0, 20.0), (15.0, 31.0), (-3.0, 20.0)]
    panels = (
        panel("front", skirt, (-22.0, 30.0, 18.0), Quadratic((0.5, -0.1))),
        panel("back", skirt, (-22.0, 30.0, -18.0), Quadratic((0.5, -0.1))),
        panel("sleeve", sleeve, (30.0, 100.0, 0.0), Arc(40.0, False, True)),
    )
    joins = (("front", 1, "back", 3), ("front", 3, "back", 1), ("sleeve", 1, "sleeve", 4))
    return Pattern("garment", panels, tuple(Seam(EdgeRef(a, i), EdgeRef(b, j)) for a, i, b, j in joins))


def each(change: Callable[[Panel], Panel]) -> Callable[[Pattern], Pattern]:
    return lambda pattern: replace(pattern, panels=tuple(change(panel) for panel in pattern.panels))


def shuffled(pattern: Pattern) -> Pattern:
    return replace(pattern, panels=pattern.panels[::-1], seams=pattern.seams[::-1])


def renamed(pattern: Pattern) -> Pattern:
    """Swap the panels' names cyclically."""
    names = [panel.name for panel in pattern.panels]
    seams = tuple(replace(seam, left=seam.right, right=seam.left) for seam in pattern.seams)
    return helpers.renamed(replace(pattern, seams=seams), dict(zip(names, names[1:] + names[:1], strict=True)))


def started_elsewhere(pattern: Pattern) -> Pattern:
    edges = {panel.name: len(panel.edges) for panel in pattern.panels}

    def ref(old: EdgeRef) -> EdgeRef:
        return EdgeRef(old.panel, (old.edge - 2) % edges[old.panel])

    seams = tuple(replace(seam, left=ref(seam.left), right=ref(seam.right)) for seam in pattern.seams)
    return replace(each(lambda panel: replace(panel, edges=panel.edges[2:] + panel.edges[:2]))(pattern), seams=seams)


def moved_origin(panel: Panel) -> Panel:
    away = np.array([7.0, -4.0])
    there = panel.placement.translation - panel.placement.matrix[:, :2] @ away
    return replace(panel, vertices=panel.vertices + away, placement=Placement(there, panel.placement.rotation))


def moved_by(panel: Panel, step: np.ndarray) -> Panel:
    return replace(panel, placement=replace(panel.placement, translation=panel.placement.translation + step))


def drawn_from_behind(panel: Panel) -> Panel:
    turned = euler_angles(panel.placement.matrix @ np.diag([-1.0, 1.0, -1.0]))
    edges = tuple(replace(edge, curve=mirrored(edge.curve)) for edge in panel.edges)
    placement = Placement(panel.placement.translation, turned)
    return replace(panel, vertices=panel.vertices * [-1.0, 1.0], edges=edges, placement=placement)


def split(pattern: Pattern, name: str) -> Pattern:
    """Cut the first edge of a panel, a line, in two; the outline stays the same."""
    old = pattern.panel(name)
    corners = np.insert(old.vertices, 1, old.vertices[:2].mean(axis=0), axis=0)
    edges = tuple(Edge(i, (i + 1) % len(corners)) for i in range(len(corners)))
    new = replace(old, vertices=corners, edges=edges)
    return replace(pattern, panels=tuple(new if p.name == name else p for p in pattern.panels), seams=())


def assert_close(score: PatternScore, expected: PatternScore) -> None:
    for name in PatternScore.__dataclass_fields__:
        assert getattr(score, name) == pytest.approx(getattr(expected, name), abs=1e-6), name


SAME: dict[str, Callable[[Pattern], Pattern]] = {
    "copied": lambda pattern: pattern,
    "shuffled": shuffled,
    "renamed": renamed,
    "started elsewhere": started_elsewhere,
    "moved origins": each(moved_origin),
    "drawn from behind": each(drawn_from_behind),
    "all of it": lambda pattern: each(drawn_from_behind)(
        each(moved_origin)(started_elsewhere(renamed(shuffled(pattern))))
    ),
}


@pytest.mark.parametrize("change", SAME)
def test_the_same_garment_is_perfect(change: str) -> None:
    assert_close(score_pattern(SAME[change](garment()), garment()), PERFECT)


def test_the_last_panel_of_real_garments_is_missing(examples: Path) -> None:
    """Four patterns of 6, 6, 12 and 8 panels: IoU, edges and panel F1 by counting panels."""
    counts, found = [], []
    for path in sorted((examples / "patterns").glob("*_specification.json")):
        whole, last = read_pattern(path), list(json.loads(path.read_text())["pattern"]["panels"])[-1]
        kept = tuple(panel for panel in whole.panels if panel.name != last)
        seams = tuple(seam for seam in whole.seams if last not in (seam.left.panel, seam.right.panel))
        score = score_pattern(replace(whole, panels=kept, seams=seams), whole)
        share, n = (len(kept) / len(whole.panels), len(whole.panels))
        assert (score.iou, score.edge_count_acc, score.panel_f1) == pytest.approx(
            (share, share, 2 * (n - 1) / (2 * n - 1))
        )
        assert (score.panel_l2, score.combinatorial) == pytest.approx((0, 0), abs=1e-9)
        counts.append(n)
        found.append(score.stitch_f1)
    assert counts == [6, 6, 12, 8]
    assert np.mean(found) == pytest.approx(0.85, abs=0.005)  # as computed by other code from the same files


def test_a_shift_of_3_cm_is_3_cm() -> None:
    moved = each(lambda panel: moved_by(panel, np.array([2.0, -1.0, 2.0])))(garment())
    assert_close(score_pattern(moved, garment()), replace(PERFECT, transl_cm=3.0))


def test_a_turn_of_10_degrees_is_10_degrees() -> None:
    c, s = np.cos(np.radians(10)), np.sin(np.radians(10))
    about_y = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])

    def turned(panel: Panel) -> Panel:
        placement = panel.placement
        turn = euler_angles(about_y @ placement.matrix)
        return replace(panel, placement=Placement(about_y @ placement.translation, turn))

    assert score_pattern(each(turned)(garment()), garment()).rot_deg == pytest.approx(10.0)


def test_an_edge_cut_in_two_changes_the_edge_count_alone() -> None:
    straight = replace(
        garment(),
        panels=tuple(replace(p, edges=tuple(Edge(e.start, e.end) for e in p.edges)) for p in garment().panels),
        seams=(),
    )
    score = score_pattern(split(straight, "front"), straight)
    assert_close(score, replace(PERFECT, edge_count_acc=2 / 3, combinatorial=0, edges_within_1cm=0))


def rectangles(width: float, other: float, *, seams: tuple[tuple[int, int], ...] = ((0, 0),)) -> Pattern:
    """Two rectangles, 20 cm high, right sides out; ``seams``: edges of the front and the back sewn together."""
    back = panel("back", [(0.0, 0.0), (other, 0.0), (other, 20.0), (0.0, 20.0)], (other / 2, 50.0, -15.0))
    panels = (
        panel("front", [(0.0, 0.0), (width, 0.0), (width, 20.0), (0.0, 20.0)], (-width / 2, 50.0, 15.0)),
        replace(back, placement=replace(back.placement, rotation=np.array([0.0, np.pi, 0.0]))),
    )
    return Pattern("two", panels, tuple(Seam(EdgeRef("front", i), EdgeRef("back", j)) for i, j in seams))


def subdivided(pattern: Pattern, number: int, share: float) -> Pattern:
    """The same garment, with the straight edges of a seam cut in two, and two seams in place of one."""
    seam = pattern.seams[number]
    away = share if seam.right_wrong else 1 - share
    cuts = {seam.left: share, seam.right: away}
    assert len({ref.panel for ref in cuts}) == 2

    def cut(old: Panel) -> Panel:
        [(row, at)] = [(ref.edge, at) for ref, at in cuts.items() if ref.panel == old.name] or [(-1, 0.0)]
        if row < 0:
            return old
        edge = old.edges[row]
        middle = (1 - at) * old.vertices[edge.start] + at * old.vertices[edge.end]
        halves = Edge(edge.start, len(old.vertices)), Edge(len(old.vertices), edge.end)
        edges = (*old.edges[:row], *halves, *old.edges[row + 1 :])
        return replace(old, vertices=np.vstack([old.vertices, middle]), edges=edges)

    def ref(old: EdgeRef, half: int = 0) -> EdgeRef:
        later = sum(old.panel == other.panel and old.edge > other.edge for other in cuts)
        return EdgeRef(old.panel, old.edge + later + half)

    rest = [replace(s, left=ref(s.left), right=ref(s.right)) for i, s in enumerate(pattern.seams) if i != number]
    two = [Seam(ref(seam.left, i), ref(seam.right, i if seam.right_wrong else 1 - i), seam.right_wrong) for i in (0, 1)]
    return Pattern(pattern.name, tuple(map(cut, pattern.panels)), (*rest, *two))


@pytest.mark.parametrize("change", SAME)
def test_subdividing_the_edges_of_a_seam_keeps_the_seam_by_length(change: str) -> None:
    whole = garment()
    parts = SAME[change](subdivided(subdivided(whole, 1, 0.3), 3, 0.8))
    for predicted, true in ((parts, whole), (whole, parts)):
        score = score_pattern(predicted, true)
        assert (score.stitch_nm_p, score.stitch_nm_r, score.stitch_nm_f1) == pytest.approx((1, 1, 1))
        assert (score.stitch_f1 < 1, score.combinatorial) == (True, 0)


def square(width: float, height: float) -> Pattern:
    return Pattern("p", (panel("p", [(0, 0), (width, 0), (width, height), (0, height)], (0, 0, 0)),), ())


G, PAIR, GATHERED = garment(), rectangles(30.0, 30.0), rectangles(40.0, 30.0, seams=((0, 0), (1, 1)))
THIRD = subdivided(PAIR, 0, 1 / 3)
LOW = replace(G.panels[1], vertices=G.panels[1].vertices * [1.0, 0.75])
TURNED = replace(G, seams=tuple(replace(seam, right_wrong=True) for seam in G.seams))
SMALL = each(lambda panel: replace(panel, vertices=0.6 * panel.vertices))(G)
NOWHERE = Seam(EdgeRef("front", 9), EdgeRef("nobody", 0))
SCORES: list[tuple[Pattern, Pattern, dict[str, float]]] = [
    # A panel is missing, one is too many, a quarter is cut off one.
    (replace(G, panels=G.panels[:2], seams=G.seams[:2]), G,
        {"panel_count_acc": 0, "edge_count_acc": 2 / 3, "iou": 2 / 3, "panel_l2": 0, "stitch_p": 1, "stitch_r": 2 / 3,
         "stitch_f1": 0.8}),
    (replace(G, panels=(*G.panels, replace(G.panels[0], name="extra"))), G, {"panel_count_acc": 0, "iou": 3 / 4}),
    (replace(G, panels=(G.panels[0], LOW, G.panels[2])), G,
        {"panel_f1": 2 / 3, "panel_count_acc": 1, "combinatorial": 1, "edges_within_1cm": 0}),
    # A seam is not there; one is missing; all are.
    (replace(G, seams=(*G.seams, Seam(EdgeRef("front", 2), EdgeRef("sleeve", 0)))), G,
        {"stitch_p": 3 / 4, "stitch_r": 1}),
    (replace(G, seams=G.seams[1:]), G,
        {"garment_perfect": 0, "stitch_nm_perfect": 0, "combinatorial": 0, "panel_f1": 1}),
    (replace(G, seams=()), G, {"seam_mismatch": 1}),
    # 40 cm are sewn to 30 cm, and 20 cm to 20 cm: (1/4 + 0) / 2.
    (GATHERED, GATHERED, {"seam_mismatch": 0.125}),
    # A square and its upper half, centroid on centroid; a bow tie in it.
    (square(20, 10), square(20, 20), {"iou": 0.5}),
    (Pattern("p", (panel("p", [(0, 0), (20, 20), (20, 0), (0, 20)], (0, 0, 0)),), ()), square(20, 20),
        {"valid": 0, "iou": 0.5}),
    # Every point of the outline moves by 10 % of its radius; the mean radius of a square of side 2 is 1.1478.
    (square(22, 22), square(20, 20), {"panel_l2": (np.sqrt(2) + np.arcsinh(1)) / 2}),
    # All seams turned: the right edges, the wrong ends. All lengths times 0.6.
    (TURNED, G, {"garment_perfect": 1, "stitch_nm_perfect": 0, "combinatorial": 0, "edges_within_1cm": 0}),
    (SMALL, G, {"garment_perfect": 1, "combinatorial": 1, "edges_within_1cm": 0}),
    # Sides 1.3 cm longer move the corners of a square out by 0.92 cm, sides 1.9 cm longer by 1.34 cm.
    (square(21.3, 21.3), square(20, 20), {"combinatorial": 1, "edges_within_1cm": 1}),
    (square(21.9, 21.9), square(20, 20), {"combinatorial": 1, "edges_within_1cm": 0}),
    # By length: the first third of a seam alone; a wrong seam of 20 cm beside one of 30; a twisted one; to no edge.
    (replace(THIRD, seams=THIRD.seams[:1]), PAIR, {"stitch_nm_p": 1, "stitch_nm_r": 1 / 3, "stitch_nm_f1": 1 / 2}),
    (rectangles(30.0, 30.0, seams=((0, 0), (1, 1))), PAIR, {"stitch_nm_p": 3 / 5, "stitch_nm_r": 1}),
    (replace(PAIR, seams=(replace(PAIR.seams[0], right_wrong=True),)), PAIR, {"stitch_f1": 1, "stitch_nm_f1": 0}),
    (replace(PAIR, seams=(*PAIR.seams, NOWHERE)), PAIR,
        {"stitch_p": 1 / 2, "stitch_nm_p": 1 / 2, "seam_mismatch": 1 / 2}),
    # Gathered seams are subdivided in proportion.
    (subdivided(rectangles(60.0, 30.0), 0, 0.25), rectangles(60.0, 30.0), {"stitch_nm_f1": 1}),
]  # fmt: skip


@pytest.mark.parametrize(("predicted", "true", "expected"), SCORES)
def test_scores_by_hand(predicted: Pattern, true: Pattern, expected: dict[str, float]) -> None:
    score = asdict(score_pattern(predicted, true))
    assert {name: score[name] for name in expected} == pytest.approx(expected, rel=1e-3, abs=1e-9)


def test_the_penalty_of_a_missing_panel_is_its_mean_radius_over_all_panels() -> None:
    """About 17 cm over three panels."""
    assert 3 < score_pattern(replace(G, panels=G.panels[:2], seams=G.seams[:2]), G).panel_l2_pen < 10


def test_an_edge_sewn_to_two_edges_equals_its_parts_sewn_to_one_each() -> None:
    """The order of the seams does not decide which part is sewn to which edge: the places of the panels do."""
    whole = subdivided(rectangles(30.0, 30.0), 0, 1 / 3)
    front = rectangles(30.0, 30.0).panels[0]
    seams = tuple(Seam(EdgeRef("front", 0), seam.right) for seam in whole.seams)
    for order in (seams, seams[::-1]):
        score = score_pattern(Pattern("n:m", (front, whole.panels[1]), order), whole)
        assert score.stitch_nm_f1 == pytest.approx(1)


@pytest.mark.parametrize("noise", [0.3, 1.0])
def test_moved_corners_keep_the_seams(noise: float) -> None:
    whole, rng = garment(), np.random.default_rng(0)
    moved = each(lambda p: replace(p, vertices=p.vertices + rng.normal(0, noise, p.vertices.shape)))(whole)
    assert score_pattern(moved, whole).stitch_nm_f1 == pytest.approx(1)


def distorted(pattern: Pattern, rng: np.random.Generator) -> Pattern:
    """Some panels left out, scaled, bent, moved or added; some edges missing; some seams left out, wrong or twice."""

    def one_of(*values: Any) -> Any:
        return values[rng.integers(len(values))]

    def changed(panel: Panel) -> Panel:
        corners = panel.vertices * one_of(1, 1, 0, 0.01, 3, 30, 1e6, 1e200, [1, -1])
        corners = corners + rng.normal(0, one_of(0, 0.1, 3, 30), panel.vertices.shape)
        curves = (LINE, Arc(40.0, True, True), Arc(1.0, True, False), Quadratic((0.5, 2.0)), Quadratic((np.nan, 0.0)))
        edges = tuple(replace(edge, curve=one_of(edge.curve, edge.curve, *curves)) for edge in panel.edges)
        moved = panel.placement.translation + rng.normal(0, one_of(0, 1, 20, 1e4), 3) * one_of(*[1] * 9, np.inf)
        turned = panel.placement.rotation + rng.normal(0, one_of(0, 0.1, 3), 3) * one_of(*[1] * 9, np.nan)
        return Panel(panel.name, corners, edges[one_of(0, 0, 0, 1) :], Placement(moved, turned))

    panels = [changed(panel) for panel in pattern.panels if rng.random() < 0.8]
    panels += [replace(one_of(*pattern.panels), name=f"more_{k}") for k in range(one_of(0, 0, 1, 3))]
    names = [panel.name for panel in (*panels, *pattern.panels)]
    refs = [EdgeRef(one_of(*names), int(rng.integers(6))) for _ in range(2 * one_of(0, 0, 1, 4))]
    seams = [seam for seam in pattern.seams if rng.random() < 0.8]
    seams += [Seam(one, other, bool(rng.integers(2))) for one, other in zip(refs[::2], refs[1::2], strict=True)]
    return Pattern("distorted", tuple(panels), tuple(seams * one_of(1, 1, 2)))


@pytest.mark.parametrize("seed", range(20))
def test_no_distortion_is_worse_than_a_failure(seed: int) -> None:
    """Nor is nothing, a garment of 30 times the size, or one 9 m away. Shares are of 0 to 1, and all scores finite."""
    rng = np.random.default_rng(seed)
    whole = (garment(), rectangles(60.0, 10.0), replace(garment(), seams=()))[seed % 3]
    worst = asdict(failed_score(whole))
    large = each(lambda panel: replace(panel, vertices=30 * panel.vertices))(whole)
    far = each(lambda panel: moved_by(panel, np.full(3, 500.0)))(whole)
    named = [whole, replace(whole, panels=whole.panels[:1], seams=()), large, far, Pattern("", (), ())]
    with np.errstate(all="ignore"):
        answers = [*named, *(distorted(whole, rng) for _ in range(5))]
        found = [asdict(score_pattern(answer, whole)) for answer in answers]
    for score in found:
        for name, value in score.items():
            if name in ("panel_l2", "panel_l2_pen", "transl_cm", "rot_deg", "seam_mismatch"):
                assert 0 <= value <= worst[name], name
            else:
                assert 0 <= worst[name] <= value <= 1, name


def test_a_failure_scores_0_though_the_garment_has_no_seams() -> None:
    assert (failed_score(replace(garment(), seams=())).stitch_f1, failed_score(garment()).valid) == (0, 0)


def test_a_prediction_that_cannot_be_drawn_gets_the_worst() -> None:
    whole = garment()
    broken = each(lambda panel: replace(panel, edges=panel.edges[:-1]))(whole)
    for nothing in (broken, Pattern("empty", (), ())):
        score = score_pattern(nothing, whole)
        assert (score.valid, score.iou, score.edge_count_acc, score.stitch_f1) == (0, 0, 0, 0)
        assert (score.transl_cm, score.rot_deg) == (40.0, 180.0)
        assert score.panel_l2 == score.panel_l2_pen > 10


def test_means_include_every_garment() -> None:
    whole = garment()
    means = mean_scores([score_pattern(whole, whole), score_pattern(Pattern("empty", (), ()), whole)])
    assert (means.iou, means.transl_cm) == pytest.approx((0.5, 20.0))


def test_the_bootstrap_covers_the_true_mean() -> None:
    """95 % of the intervals of 200 test sets of 60 garments hold the mean of the distribution, 0.3."""
    rng = np.random.default_rng(1)
    low, high = bootstrap_means(np.arange(100)[:, None] % 2, rng)
    assert (high - low)[0] == pytest.approx(2 * 1.96 * 0.5 / 10, rel=0.2)
    held = 0
    for _ in range(100):
        low, high = bootstrap_means((rng.random((60, 1)) < 0.3).astype(float), rng, draws=200)
        held += bool(low[0] <= 0.3 <= high[0])
    assert 0.88 < held / 100 <= 0.99
