"""Metrics of published tables against cases worked out by hand, and what each makes of the same garment."""

from collections.abc import Callable
from dataclasses import replace
from math import hypot, isinf, isnan, sqrt
from pathlib import Path

import numpy as np
import pytest

from benchmarks.reconstruction.scoring.legacy import PRESETS, legacy_scores
from gcd_dataset.curves import LINE, Curve, Quadratic
from gcd_dataset.errors import ConfigError
from gcd_dataset.records import Edge, EdgeRef, Panel, Pattern, Placement, Seam
from gcd_dataset.spec import read_pattern

SQUARE = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]
TRIANGLE = SQUARE[:3]
SHARES = ("panels", "edges", "edges_correct", "stitch_precision", "stitch_recall", "stitch_f1", "topology", "iou")


def panel(
    name: str,
    z: float,
    *,
    corners: list[tuple[float, float]] = SQUARE,
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0),
    curve: Curve = LINE,
    x: float = 0.0,
) -> Panel:
    """A panel whose top lies at (x + 5, 110, z) for a square; ``curve`` is that of its first edge."""
    edges = tuple(Edge(i, (i + 1) % len(corners), curve if i == 0 else LINE) for i in range(len(corners)))
    return Panel(name, np.array(corners), edges, Placement(np.array([x, 100.0, z]), np.radians(turn)))


def seam(left: tuple[str, int], right: tuple[str, int]) -> Seam:
    return Seam(EdgeRef(*left), EdgeRef(*right))


SEAMS = (seam(("front", 1), ("back", 3)), seam(("front", 3), ("back", 1)))


def garment(*panels: Panel, seams: tuple[Seam, ...] = SEAMS) -> Pattern:
    return Pattern("napkins", panels or (panel("front", 12.0), panel("back", -12.0)), seams)


TRUE = garment()
BACK_MISSING = garment(panel("front", 12.0), seams=())


def scores(preset: str, predicted: Pattern | None, true: Pattern = TRUE) -> dict[str, float]:
    return legacy_scores(preset, [predicted], [true])


@pytest.mark.parametrize("preset", PRESETS)
def test_the_true_garment_is_perfect(preset: str) -> None:
    for name, value in scores(preset, TRUE).items():
        assert value == pytest.approx(float(name.removesuffix("_correct") in SHARES), abs=1e-12), name


def test_wrong_calls_name_the_remedy() -> None:
    with pytest.raises(ConfigError, match=r"preset neuraltaylor: give one of .*: did you mean neuraltailor"):
        legacy_scores("neuraltaylor", [TRUE], [TRUE])
    with pytest.raises(ConfigError, match="1 predictions for 2 patterns: give one for each"):
        legacy_scores("stitched", [TRUE], [TRUE, TRUE])
    with pytest.raises(ConfigError, match="at least one"):
        legacy_scores("stitched", [], [])


# --------------------------------------------------------------------------------------------------------- neuraltailor


def test_neuraltailor_a_missing_panel_is_a_row_of_zeros() -> None:
    # Corners and control points of a square, a straight edge's control point at its start: (0, 0) three times, the
    # others twice. About their mean (40/9, 40/9) their distances are:
    near, side, far = sqrt(2) * 40 / 9, hypot(50 / 9, 40 / 9), sqrt(2) * 50 / 9
    of_one_panel = (3 * near + 4 * side + 2 * far) / 9
    found = scores("neuraltailor", garment(panel("front", 12.0), seams=SEAMS[:1]))
    assert found["panel_l2"] == pytest.approx(of_one_panel / 2)
    assert found["transl_l2"] == pytest.approx(sqrt(5**2 + 110**2 + 12**2) / 23)
    assert found["rot_l2"] == pytest.approx(1 / 23)
    assert (found["panels"], found["edges"]) == (0.0, 0.5)
    assert (found["stitch_precision"], found["stitch_recall"]) == (1.0, 0.5)
    assert isnan(found["panel_l2_correct"])


def test_neuraltailor_divides_placements_by_all_slots() -> None:
    found = scores("neuraltailor", garment(panel("front", 12.0, x=3.0), panel("back", -12.0)))
    assert found["transl_l2"] == pytest.approx(3 / 23)


def test_neuraltailor_takes_one_rotation_for_two() -> None:
    """350° and -10° are one rotation; their quaternions differ in sign."""
    true = garment(panel("front", 12.0, turn=(0, -10, 0)), panel("back", -12.0))
    found = scores("neuraltailor", garment(panel("front", 12.0, turn=(0, 350, 0)), panel("back", -12.0)), true)
    assert found["rot_l2"] == pytest.approx(2 / 23)


def test_neuraltailor_takes_a_short_edge_for_padding() -> None:
    """A perfect prediction loses its edges, and a triangle with an edge of 1 cm is no panel."""
    cut = [(0.0, 0.0), (9.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]
    true = garment(panel("front", 12.0, corners=cut), panel("back", -12.0), seams=())
    assert scores("neuraltailor", true, true)["edges"] == 0.5
    sliver = garment(
        panel("front", 12.0, corners=[(0.0, 0.0), (1.0, 0.0), (0.5, 20.0)]), panel("back", -12.0), seams=()
    )
    assert scores("neuraltailor", sliver, sliver)["panels"] == 0.0


def test_neuraltailor_compares_control_points() -> None:
    # The control point of the first edge moves by d = (5, 3), the mean of nine points by d/9.
    bent = garment(panel("front", 12.0, curve=Quadratic((0.5, 0.3))), panel("back", -12.0))
    assert scores("neuraltailor", bent)["panel_l2"] == pytest.approx(16 / 81 * hypot(5, 3) / 2)


def test_neuraltailor_cuts_a_prediction_to_the_true_number_of_edges() -> None:
    # Two cut corners: the first three edges alike, the fourth of length 5 instead of 10. Nine points; the last moves
    # by (0, 5).
    more = panel("front", 12.0, corners=[*SQUARE, (0.0, 5.0)])
    found = scores("neuraltailor", garment(more, panel("back", -12.0)))
    assert found["panel_l2"] == pytest.approx(16 / 81 * 5 / 2)
    assert found["edges"] == 0.5


def test_neuraltailor_averages_correct_garments_apart() -> None:
    moved = garment(panel("front", 12.0, x=3.0), panel("back", -12.0))
    found = legacy_scores("neuraltailor", [moved, BACK_MISSING], [TRUE, TRUE])
    assert found["transl_l2_correct"] == pytest.approx(3 / 23)
    assert found["transl_l2"] == pytest.approx((3 + sqrt(5**2 + 110**2 + 12**2)) / 2 / 23)
    assert found["panels"] == 0.5


# ------------------------------------------------------------------------------------------------------------- aipparel


def test_aipparel_matches_panels_by_their_place_in_the_list() -> None:
    found = scores("aipparel", garment(panel("back", -12.0), panel("front", 12.0)))
    assert found["transl_l2"] == pytest.approx(24.0)
    assert (found["edges"], found["stitch_recall"]) == (1.0, 1.0)


def test_aipparel_leaves_wrong_numbers_of_panels_out() -> None:
    moved = garment(panel("front", 12.0, x=3.0), panel("back", -12.0))
    found = legacy_scores("aipparel", [moved, BACK_MISSING, None], [TRUE, TRUE, TRUE])
    assert found["transl_l2"] == pytest.approx(1.5)
    assert found["panels"] == pytest.approx(1 / 3)
    assert (found["edges"], found["stitch_recall"]) == (1.0, 1.0)


def test_aipparel_forgives_wrong_seams() -> None:
    more = garment(seams=(*SEAMS, seam(("front", 0), ("back", 0))))
    assert scores("aipparel", more)["stitch_recall"] == 1.0
    assert scores("neuraltailor", more)["stitch_precision"] == pytest.approx(2 / 3)


def test_aipparel_compares_the_first_control_point_of_a_cubic_curve() -> None:
    # The quadratic control point (5, 3) is the cubic's first at (10/3, 2).
    bent = garment(panel("front", 12.0, curve=Quadratic((0.5, 0.3))), panel("back", -12.0))
    assert scores("aipparel", bent)["panel_l2"] == pytest.approx(16 / 81 * hypot(10 / 3, 2) / 2)


def test_aipparel_ignores_the_sign_of_quaternions() -> None:
    true = garment(panel("front", 12.0, turn=(0, -10, 0)), panel("back", -12.0))
    found = scores("aipparel", garment(panel("front", 12.0, turn=(0, 350, 0)), panel("back", -12.0)), true)
    assert found["rot_l2"] == pytest.approx(0.0, abs=1e-12)


# ----------------------------------------------------------------------------------------------------- garmentdiffusion


def test_garmentdiffusion_measures_euler_angles() -> None:
    turned = garment(panel("front", 12.0, turn=(0, 10, 0)), panel("back", -12.0))
    assert scores("garmentdiffusion", turned)["rot_l2"] == pytest.approx(np.radians(10) / 2)


def test_garmentdiffusion_averages_f1_over_garments() -> None:
    half = garment(seams=SEAMS[:1])
    found = legacy_scores("garmentdiffusion", [half, None], [TRUE, TRUE])
    assert found["stitch_f1"] == pytest.approx(2 / 3 / 2)
    assert (found["stitch_precision"], found["stitch_recall"]) == (0.5, 0.25)
    assert found["panels"] == 0.5


# ------------------------------------------------------------------------------------------------------------- stitched


def test_stitched_pads_corners_with_the_centre() -> None:
    # Three corners of the square about their mean differ from the square's by 5/3 in x and y; the fourth lies at 0.
    true = garment(panel("front", 12.0), seams=())
    found = scores("stitched", garment(panel("front", 12.0, corners=TRIANGLE), seams=()), true)
    assert found["panel_l2"] == pytest.approx((3 * sqrt(2) * 5 / 3 + sqrt(2) * 5) / 4)
    assert found["edges"] == 0.0


def test_stitched_does_not_punish_a_missing_panel() -> None:
    found = scores("stitched", BACK_MISSING)
    assert (found["panels"], found["edges"], found["panel_l2"], found["transl_l2"]) == (0.0, 1.0, 0.0, 0.0)


def test_stitched_measures_degrees_and_local_origins() -> None:
    turned = garment(panel("front", 12.0, turn=(0, 10, 0)), panel("back", -12.0, x=4.0))
    found = scores("stitched", turned)
    assert (found["rot_l2"], found["transl_l2"]) == pytest.approx((5.0, 2.0))


def test_stitched_leaves_failures_out_and_gives_infinity_for_nothing() -> None:
    assert legacy_scores("stitched", [TRUE, None], [TRUE, TRUE])["panel_l2"] == 0.0
    assert isinf(scores("stitched", Pattern("nothing", (), ()))["panel_l2"])


# ------------------------------------------------------------------------------------------------------------- reweaver


def test_reweaver_leaves_failures_out_of_all_but_the_number_of_panels() -> None:
    wrong_edges = garment(panel("front", 12.0, corners=[*SQUARE, (0.0, 5.0)]), panel("back", -12.0))
    found = legacy_scores("reweaver", [wrong_edges, BACK_MISSING, None], [TRUE] * 3)
    assert found["panels"] == pytest.approx(1 / 3)
    assert found["edges"] == 0.5
    assert found["topology"] == pytest.approx(1 / 6)
    assert isnan(scores("reweaver", None)["iou"])


def test_reweaver_ignores_the_size_of_a_panel() -> None:
    small = garment(panel("front", 12.0, corners=[(x / 2, y / 2) for x, y in SQUARE]), panel("back", -12.0))
    found = scores("reweaver", small)
    assert (found["iou"], found["edge_cd"]) == pytest.approx((1.0, 0.0), abs=1e-9)


def test_reweaver_overlap_of_a_square_and_a_flat_rectangle() -> None:
    # In units of half their diagonals: a square of half side √½, a rectangle of 2:1 of half sides 2/√5 and 1/√5.
    flat = garment(panel("front", 12.0, corners=[(0.0, 0.0), (10.0, 0.0), (10.0, 5.0), (0.0, 5.0)]), seams=())
    both = sqrt(0.5) / sqrt(5)
    expected = both / (0.5 + 2 / 5 - both)
    assert scores("reweaver", flat, garment(panel("front", 12.0), seams=()))["iou"] == pytest.approx(expected)


# ---------------------------------------------------------------------------------------------------------- sensitivity


def started_elsewhere(pattern: Pattern) -> Pattern:
    edges = {panel.name: len(panel.edges) for panel in pattern.panels}

    def ref(old: EdgeRef) -> EdgeRef:
        return EdgeRef(old.panel, (old.edge - edges[old.panel] // 2) % edges[old.panel])

    def moved(panel: Panel) -> Panel:
        half = len(panel.edges) // 2
        return replace(panel, edges=panel.edges[half:] + panel.edges[:half])

    panels = tuple(map(moved, pattern.panels))
    seams = tuple(replace(s, left=ref(s.left), right=ref(s.right)) for s in pattern.seams)
    return replace(pattern, panels=panels, seams=seams)


def reordered(pattern: Pattern) -> Pattern:
    return replace(pattern, panels=pattern.panels[::-1])


def renamed(pattern: Pattern) -> Pattern:
    name = {panel.name: f"panel_{number}" for number, panel in enumerate(pattern.panels)}
    panels = tuple(replace(panel, name=name[panel.name]) for panel in pattern.panels)
    seams = tuple(
        replace(s, left=replace(s.left, panel=name[s.left.panel]), right=replace(s.right, panel=name[s.right.panel]))
        for s in pattern.seams
    )
    return replace(pattern, panels=panels, seams=seams)


def moved_origins(pattern: Pattern) -> Pattern:
    away = np.array([7.0, -4.0])

    def moved(panel: Panel) -> Panel:
        there = panel.placement.translation - panel.placement.matrix[:, :2] @ away
        return replace(panel, vertices=panel.vertices + away, placement=replace(panel.placement, translation=there))

    return replace(pattern, panels=tuple(map(moved, pattern.panels)))


def last_panel_missing(pattern: Pattern) -> Pattern:
    name = pattern.panels[-1].name
    seams = tuple(s for s in pattern.seams if name not in (s.left.panel, s.right.panel))
    return replace(pattern, panels=pattern.panels[:-1], seams=seams)


# Panel L2 and stitch score of four GarmentCode examples; ``None`` where the preset leaves all of them out. Outlines
# start at the opposite corner (at a random one panel_l2 is 32), panels are in reverse order.
TABLE: list[tuple[Callable[[Pattern], Pattern], str, float | None, float | None]] = [
    (started_elsewhere, "neuraltailor", 41.2, 0.0),
    (started_elsewhere, "aipparel", 41.9, 0.0),
    (started_elsewhere, "stitched", 0.0, 0.0),
    (reordered, "neuraltailor", 0.0, 1.0),
    (reordered, "aipparel", 29.8, 1.0),
    (reordered, "stitched", 0.0, 1.0),
    (renamed, "neuraltailor", 22.82, 0.0),
    (renamed, "aipparel", 0.0, 0.0),
    (renamed, "stitched", 0.0, 1.0),
    (last_panel_missing, "neuraltailor", 2.70, 1.0),
    (last_panel_missing, "aipparel", None, None),
    (last_panel_missing, "stitched", 0.0, 1.0),
]


@pytest.mark.parametrize(("change", "preset", "shape", "stitches"), TABLE)
def test_what_presets_make_of_the_same_garment(
    change: Callable[[Pattern], Pattern], preset: str, shape: float | None, stitches: float | None, examples: Path
) -> None:
    true = [read_pattern(path) for path in sorted((examples / "patterns").glob("*_specification.json"))]
    found = legacy_scores(preset, [change(pattern) for pattern in true], true)
    stitch = found["stitch_recall" if preset == "aipparel" else "stitch_precision"]
    if shape is None:
        assert isnan(found["panel_l2"]) and isnan(stitch)
        return
    assert found["panel_l2"] == pytest.approx(shape, rel=0.02, abs=1e-6)
    assert stitch == pytest.approx(stitches, abs=0.05)


def test_only_stitched_notices_moved_local_origins(examples: Path) -> None:
    true = [read_pattern(path) for path in sorted((examples / "patterns").glob("*_specification.json"))]
    found = {preset: legacy_scores(preset, [moved_origins(p) for p in true], true) for preset in PRESETS}
    assert found["stitched"]["transl_l2"] == pytest.approx(hypot(7, 4))
    assert found["neuraltailor"]["transl_l2"] == pytest.approx(0.0, abs=1e-9)
    assert found["aipparel"]["transl_l2"] == pytest.approx(0.0, abs=1e-9)
