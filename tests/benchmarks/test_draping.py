"""The drape benchmark: figures, pictures of failures."""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import run
from benchmarks.cases import parity
from benchmarks.cases.parity import compare
from benchmarks.draping.modes import write_failures
from benchmarks.draping.workload import Worn, pass_paper, quality
from benchmarks.peers.newton import unmirrored
from gcd_dataset.curves import Quadratic
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob, drape_batch
from gcd_dataset.records import Drape, EdgeRef, Outcome, Panel, Pattern, Placement, Seam
from gcd_dataset.spec import write_pattern
from tests.generator.dressing import test_dressing as openings
from tests.helpers import SIZE, far_ball, napkins, patch


def drape(outcome: Outcome, *, crossings: int = 0) -> Drape:
    return Drape(np.zeros((3, 3), np.float32), outcome, 10, crossings, 0, 1.0, 1.0)


def worn(index: int) -> Worn:
    return Worn(index, "neutral", "Shirt", "", "", DrapeJob(patch(4, 4), far_ball(), SIZE))


def test_the_papers_checks_ignore_stretch() -> None:
    assert pass_paper(drape(Outcome.OVERSTRETCHED))
    assert [outcome for outcome in Outcome if pass_paper(drape(outcome))] == [Outcome.SETTLED, Outcome.OVERSTRETCHED]


def test_the_papers_checks_count_edges_of_the_cloth_only() -> None:
    failed = drape(Outcome.THROUGH_BODY)
    assert pass_paper(replace(failed, body_crossings=30, body_through=6))
    assert not pass_paper(replace(failed, body_crossings=36, body_through=6))
    assert not pass_paper(replace(failed, body_crossings=30, body_through=6, self_crossings=301))


def test_shares_and_percentiles() -> None:
    drapes = [drape(Outcome.SETTLED), drape(Outcome.OVERSTRETCHED), drape(Outcome.THROUGH_ITSELF, crossings=400)]
    figures = {figure.metric: figure.value for figure in quality(drapes)}
    assert figures["passed"] == pytest.approx(1 / 3)
    assert figures["passed_paper"] == pytest.approx(2 / 3)
    assert [figures["self_p50"], figures["self_p80"], figures["body_p95"]] == pytest.approx([0.0, 240.0, 0.0])


def test_each_failure_has_its_picture(tmp_path: Path) -> None:
    """A picture also of a garment with NaN positions, none of a settled garment."""
    garments = [worn(0), worn(1), worn(2)]
    [falling] = drape_batch([garments[0].job], DrapeConfig(max_frames=1), device="cpu")
    assert falling.outcome is Outcome.NOT_SETTLED
    lost = replace(falling, vertices=np.full_like(falling.vertices, np.nan), outcome=Outcome.DIVERGED)
    write_failures(tmp_path, garments, [falling, replace(falling, outcome=Outcome.SETTLED), lost], device="cpu")
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["0_NOT_SETTLED.jpg", "2_DIVERGED.jpg", "kinds.jpg"]


def test_mirrored_panels_keep_area_and_edge_lengths() -> None:
    mesh = patch(3, 2)
    mirrored = replace(mesh, uv=mesh.uv * [-1.0, 1.0])
    corners = unmirrored(mirrored)
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    np.testing.assert_allclose(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0], 1.0)
    np.testing.assert_allclose(np.abs(corners), np.abs(mirrored.uv[mirrored.corners]))
    np.testing.assert_array_equal(unmirrored(mesh), mesh.uv[mesh.corners])


def test_a_pattern_that_cannot_be_read_is_named_and_the_others_are_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good, bad, report = tmp_path / "good.json", tmp_path / "bad.json", tmp_path / "report.md"
    write_pattern(openings.tube(50.0, 30.0, y=80.0), good)
    bad.write_text("{")
    options = ["--device", "cpu", "--resolution", "6", "--report", str(report)]
    assert run.main(["drape", str(bad), str(good), *options]) == 1
    printed = capsys.readouterr()
    assert "drape.s_per_garment" in printed.out
    assert f"bad: REFUSED: {bad}: line 1" in printed.err
    assert "| bad |  | REFUSED |" in report.read_text()


def test_a_moved_panel_keeps_its_outline() -> None:
    found = compare(changed(napkins(), placement=Placement(np.array([3.0, 0.0, 4.0]), np.zeros(3))), napkins())
    assert found.outline["one"] == pytest.approx(0.0, abs=1e-9)
    assert found.placement == {"one": pytest.approx(5.0), "two": 0.0}


def test_a_loop_may_begin_at_any_corner() -> None:
    """The same panel drawn from its second corner, its seam renumbered."""
    panel = napkins().panels[0]
    begun = changed(napkins(), edges=(*panel.edges[1:], panel.edges[0]))
    begun = replace(begun, seams=(Seam(EdgeRef("one", 0), EdgeRef("two", 3)),))
    found = compare(begun, napkins())
    assert not found.structure
    assert found.outline["one"] == pytest.approx(0.0, abs=1e-9)


def test_a_bulge_is_located_on_its_edge() -> None:
    """A quadratic's midpoint is half as far off the chord as its control point: 0.5 · 0.1 · 20 cm."""
    panel = napkins().panels[0]
    bent = (panel.edges[0], panel.edges[1], replace(panel.edges[2], curve=Quadratic((0.5, 0.1))), panel.edges[3])
    found = compare(changed(napkins(), edges=bent), napkins())
    assert found.outline["one"] == pytest.approx(1.0, abs=1e-3)
    assert found.worst_edge["one"] == 2


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        (replace(napkins(), panels=napkins().panels[:1], seams=()), "panel two: is missing"),
        (replace(napkins(), seams=()), "seam one edge 1 with two edge 3 is not sewn"),
        (replace(napkins(), seams=(replace(napkins().seams[0], right_wrong=True),)), "is sewn the other way"),
        (replace(napkins(), seams=(Seam(EdgeRef("one", 3), EdgeRef("two", 3)),)), "one edge 3 with two edge 3 is sewn"),
    ],
)
def test_different_seams_are_named(pattern: Pattern, message: str) -> None:
    assert any(message in str(difference) for difference in compare(pattern, napkins()).structure)


def changed(pattern: Pattern, **values: object) -> Pattern:
    """The pattern with its first panel changed."""
    panel: Panel = replace(pattern.panels[0], **values)  # type: ignore[arg-type]
    return replace(pattern, panels=(panel, *pattern.panels[1:]))


def parity_figures(folder: Path, *, only: str = "") -> dict[str, float]:
    measured = parity.run(argparse.Namespace(folder=folder, only=only))
    return {figure.metric: figure.value for figure in measured.figures}


def test_our_patterns_agree_with_the_reference(examples: Path) -> None:
    """Those of two designs; of all 24 in tests/extras."""
    figures = parity_figures(examples / "patterns", only="shirt_sleeves_hood")
    assert figures["designs"] == 2
    assert figures["same"] == figures["outline"] == figures["placement"] == 1.0


def test_a_difference_that_a_mend_explains_is_told(examples: Path) -> None:
    """Our levels are as wide as the hem above; GarmentCode's width also depends on the hips."""
    figures = parity_figures(examples / "patterns" / "levels_skirt")
    assert (figures["outline"], figures["with_all_mends"]) == (1.0, 0.0)


def test_a_folder_without_designs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no folder in it has design, measures and specification"):
        parity_figures(tmp_path)
