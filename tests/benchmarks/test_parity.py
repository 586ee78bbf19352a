"""Comparison of patterns: equal patterns agree; each difference is reported with its size."""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.cases import parity
from benchmarks.comparison import compare
from gcd_dataset.curves import Quadratic
from gcd_dataset.errors import ConfigError
from gcd_dataset.records import EdgeRef, Panel, Pattern, Placement, Seam
from tests.helpers import napkins


def test_a_pattern_agrees_with_itself() -> None:
    found = compare(napkins(), napkins())
    assert not found.structure
    assert max(found.outline.values()) == max(found.placement.values()) == 0.0


def test_a_moved_panel_keeps_its_outline() -> None:
    found = compare(changed(napkins(), placement=Placement(np.array([3.0, 0.0, 4.0]), np.zeros(3))), napkins())
    assert found.outline["one"] == pytest.approx(0.0, abs=1e-9)
    assert found.placement == {"one": pytest.approx(5.0), "two": 0.0}


def test_a_rotated_panel_is_off_by_its_farthest_corner() -> None:
    """Rotated about its centre by an angle a: twice the half diagonal times sin(a / 2)."""
    centred = changed(napkins(), vertices=napkins().panels[0].vertices - [10.0, 5.0])
    turned = Placement(np.zeros(3), np.array([0.0, 0.0, 0.2]))
    found = compare(changed(centred, placement=turned), centred)
    assert found.outline["one"] == pytest.approx(0.0, abs=1e-9)
    assert found.placement["one"] == pytest.approx(2 * np.hypot(10.0, 5.0) * np.sin(0.1))


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


def run(folder: Path, expect: Path | None = None) -> dict[str, float]:
    measured = parity.run(argparse.Namespace(folder=folder, only="", expect=expect))
    return {figure.metric: figure.value for figure in measured.figures}


def test_our_patterns_agree_with_the_reference(examples: Path) -> None:
    figures = run(examples / "patterns")
    assert figures["designs"] == 24
    assert figures["same"] == figures["outline"] == figures["placement"] == 1.0


def test_without_an_expected_mend_a_difference_counts(examples: Path, tmp_path: Path) -> None:
    """Our levels are as wide as the hem above; GarmentCode's width also depends on the hips."""
    expect = tmp_path / "mends.toml"
    expect.write_text("")
    assert run(examples / "patterns" / "levels_skirt", expect)["outline"] == 0.0
    expect.write_text('default_body = ["LEVEL_GIRTH", "WORN_LENGTH"]\n')
    assert run(examples / "patterns" / "levels_skirt", expect)["outline"] == 0.5
    expect.write_text('default_body = ["LEVELS"]\n')
    with pytest.raises(ConfigError, match="unknown mend 'LEVELS': choose among"):
        run(examples / "patterns" / "levels_skirt", expect)


def test_a_folder_without_designs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no folder in it has design, measures and specification"):
        run(tmp_path)
