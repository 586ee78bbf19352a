"""Metrics of published tables against cases worked out by hand, and what each makes of the same garment."""

from collections.abc import Callable
from dataclasses import replace
from math import hypot, inf, isnan, nan, sqrt
from pathlib import Path

import numpy as np
import pytest

from benchmarks.reconstruction.legacy import PRESETS, legacy_scores, main
from gcd_dataset.curves import LINE, Curve, Quadratic
from gcd_dataset.errors import ConfigError
from gcd_dataset.records import Edge, EdgeRef, Panel, Pattern, Placement, Seam
from gcd_dataset.spec import read_pattern, write_pattern

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


BACK = panel("back", -12.0)
MOVED = garment(panel("front", 12.0, x=3.0), BACK)
BENT = garment(panel("front", 12.0, curve=Quadratic((0.5, 0.3))), BACK)  # control point moved by (5, 3)
MORE_EDGES = garment(panel("front", 12.0, corners=[*SQUARE, (0.0, 5.0)]), BACK)
TURNED = garment(panel("front", 12.0, turn=(0, 10, 0)), BACK)
BY_350, BY_MINUS_10 = (garment(panel("front", 12.0, turn=(0, angle, 0)), BACK) for angle in (350, -10))
FRONT_ALONE = garment(panel("front", 12.0), seams=())
CUT = garment(panel("front", 12.0, corners=[(0.0, 0.0), (9.0, 0.0), *SQUARE[1:]]), BACK, seams=())
SLIVER = garment(panel("front", 12.0, corners=[(0.0, 0.0), (1.0, 0.0), (0.5, 20.0)]), BACK, seams=())
THIRD_SEAM = garment(seams=(*SEAMS, seam(("front", 0), ("back", 0))))
# Corners and control points of a square, a straight edge's control point at its start: (0, 0) three times, the others
# twice. Their distances from the mean, (40/9, 40/9):
OF_A_SQUARE = (3 * sqrt(2) * 40 / 9 + 4 * hypot(50 / 9, 40 / 9) + 2 * sqrt(2) * 50 / 9) / 9
AWAY = sqrt(5**2 + 110**2 + 12**2)  # cm from the origin to the top of a square
# Half side √½ of a square in units of half its diagonal; 2/√5 and 1/√5 of a rectangle of 2:1.
FLAT = garment(panel("front", 12.0, corners=[(0.0, 0.0), (10.0, 0.0), (10.0, 5.0), (0.0, 5.0)]), seams=())
BOTH = sqrt(0.5) / sqrt(5)
Garments = list[Pattern | None]


@pytest.mark.parametrize(
    ("preset", "predicted", "true", "expected"),
    [
        # A missing panel is a row of zeros; placements are divided by all 23 slots.
        ("neuraltailor", [garment(panel("front", 12.0), seams=SEAMS[:1])], [TRUE], {
            "panel_l2": OF_A_SQUARE / 2, "transl_l2": AWAY / 23, "rot_l2": 1 / 23, "panels": 0.0, "edges": 0.5,
            "stitch_precision": 1.0, "stitch_recall": 0.5, "panel_l2_correct": nan,
        }),
        ("neuraltailor", [MOVED, BACK_MISSING], [TRUE] * 2, {
            "transl_l2_correct": 3 / 23, "transl_l2": (3 + AWAY) / 2 / 23, "panels": 0.5,
        }),
        # 350° and -10° are one rotation; their quaternions differ in sign.
        ("neuraltailor", [BY_350], [BY_MINUS_10], {"rot_l2": 2 / 23}),
        ("aipparel", [BY_350], [BY_MINUS_10], {"rot_l2": 0.0}),
        # A short edge is taken for padding: a perfect prediction loses its edges, a triangle is no panel.
        ("neuraltailor", [CUT], [CUT], {"edges": 0.5}),
        ("neuraltailor", [SLIVER], [SLIVER], {"panels": 0.0}),
        # The mean of nine points moves by a ninth of the control point; of a cubic curve the first one counts.
        ("neuraltailor", [BENT], [TRUE], {"panel_l2": 16 / 81 * hypot(5, 3) / 2}),
        ("aipparel", [BENT], [TRUE], {"panel_l2": 16 / 81 * hypot(10 / 3, 2) / 2}),
        # Cut to the true number of edges: the fourth of length 5 instead of 10.
        ("neuraltailor", [MORE_EDGES], [TRUE], {"panel_l2": 16 / 81 * 5 / 2, "edges": 0.5}),
        # Panels are matched by their place in the list; garments of a wrong number of panels are left out.
        ("aipparel", [garment(BACK, panel("front", 12.0))], [TRUE], {
            "transl_l2": 24.0, "edges": 1.0, "stitch_recall": 1.0,
        }),
        ("aipparel", [MOVED, BACK_MISSING, None], [TRUE] * 3, {
            "transl_l2": 1.5, "panels": 1 / 3, "edges": 1.0, "stitch_recall": 1.0,
        }),
        ("aipparel", [THIRD_SEAM], [TRUE], {"stitch_recall": 1.0}),
        ("neuraltailor", [THIRD_SEAM], [TRUE], {"stitch_precision": 2 / 3}),
        ("garmentdiffusion", [TURNED], [TRUE], {"rot_l2": np.radians(10) / 2}),
        ("garmentdiffusion", [garment(seams=SEAMS[:1]), None], [TRUE] * 2, {
            "stitch_f1": 2 / 3 / 2, "stitch_precision": 0.5, "stitch_recall": 0.25, "panels": 0.5,
        }),
        # Corners are padded with the centre: three differ by 5/3 in x and y about their mean, the fourth lies at 0.
        ("stitched", [garment(panel("front", 12.0, corners=TRIANGLE), seams=())], [FRONT_ALONE], {
            "panel_l2": (3 * sqrt(2) * 5 / 3 + sqrt(2) * 5) / 4, "edges": 0.0,
        }),
        ("stitched", [BACK_MISSING], [TRUE], {"panels": 0.0, "edges": 1.0, "panel_l2": 0.0, "transl_l2": 0.0}),
        ("stitched", [garment(TURNED.panels[0], panel("back", -12.0, x=4.0))], [TRUE], {"rot_l2": 5, "transl_l2": 2}),
        ("stitched", [TRUE, None], [TRUE] * 2, {"panel_l2": 0.0}),
        ("stitched", [Pattern("nothing", (), ())], [TRUE], {"panel_l2": inf}),
        ("reweaver", [MORE_EDGES, BACK_MISSING, None], [TRUE] * 3, {"panels": 1 / 3, "edges": 0.5, "topology": 1 / 6}),
        ("reweaver", [None], [TRUE], {"iou": nan}),
        ("reweaver", [garment(panel("front", 12.0, corners=[(x / 2, y / 2) for x, y in SQUARE]), BACK)], [TRUE], {
            "iou": 1.0, "edge_cd": 0.0,
        }),
        ("reweaver", [FLAT], [FRONT_ALONE], {"iou": BOTH / (0.5 + 2 / 5 - BOTH)}),
    ],
)  # fmt: skip
def test_metrics_of_cases_worked_out_by_hand(
    preset: str, predicted: Garments, true: list[Pattern], expected: dict[str, float]
) -> None:
    found = legacy_scores(preset, predicted, true)
    assert {name: found[name] for name in expected} == pytest.approx(expected, abs=1e-9, nan_ok=True)


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


def test_presets_of_two_folders(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for folder in ("answers", "truth"):
        (tmp_path / folder).mkdir()
        write_pattern(TRUE, tmp_path / folder / "napkins.json")
    folders = [str(tmp_path / "answers"), str(tmp_path / "truth")]
    assert main([*folders, "--preset", "stitched", "--preset", "aipparel"]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert {line.split(".")[0] for line in printed} == {"stitched", "aipparel"}
    assert main([folders[0], str(tmp_path / "nowhere"), "--preset", "stitched"]) == 1
    assert "nowhere: no such folder" in capsys.readouterr().err
