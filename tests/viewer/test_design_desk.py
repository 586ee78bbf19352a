"""Designs by hand: controls of all parameters, patterns for changed measures, reasons of rules, design files."""

from pathlib import Path

import numpy as np
import pytest

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.garments.design import read_design
from gcd_dataset.records import Closure, Outcome
from gcd_dataset.viewer import design_desk
from gcd_dataset.viewer.design_desk import Desk, controls, measure_controls


@pytest.fixture(scope="module")
def desk() -> Desk:
    return Desk()


def values(desk: Desk, **changes: object) -> dict[str, object]:
    return {one.path: one.value for one in controls(desk.start)} | {k.replace("__", "."): v for k, v in changes.items()}


def test_every_parameter_has_a_control_whose_value_lies_in_its_range(desk: Desk) -> None:
    found = controls(desk.start)
    assert len({one.path for one in found}) == len(found) > 120
    for one in found:
        assert one.low <= one.value <= one.high if one.kind in ("number", "whole") else one.value in one.options


def test_what_sampling_never_draws_can_be_chosen(desk: Desk) -> None:
    offered = {one.path: one.options for one in controls(desk.start)}
    assert "Cape" in offered["meta.upper"]
    assert {"open", "zip", "buttons"} < set(offered["front.closure"])
    chosen = desk.draw(values(desk, **{"meta.upper": "Shirt", "front.closure": "zip"}), {})
    assert "front" in chosen.used
    assert chosen.pattern is not None
    assert Closure.ZIP in {seam.closure for seam in chosen.pattern.seams}


def test_a_longer_skirt_has_larger_panels(desk: Desk) -> None:
    def area(length: float) -> float:
        pattern = desk.draw(values(desk, **{"flare-skirt.length": length}), {}).pattern
        assert pattern is not None
        corners = next(panel.vertices for panel in pattern.panels if "skirt" in panel.name)
        return float(np.ptp(corners, axis=0).prod())

    assert area(0.5) > 1.2 * area(0.3)


def test_a_wider_waist_widens_the_pattern(desk: Desk) -> None:
    waist = {one.path: one.value for one in measure_controls(desk.size)}["waist"]
    widths = []
    for wanted in (waist, 1.1 * waist):
        pattern = desk.draw(values(desk), {"waist": wanted}).pattern
        assert pattern is not None
        widths.append(sum(panel.edge_lengths()[0] for panel in pattern.panels))
    assert widths[0] != pytest.approx(widths[1])


def test_a_rule_says_why_a_design_cannot_be_worn(desk: Desk) -> None:
    drawing = desk.draw(
        values(desk, meta__upper=None, **{"meta.bottom": "SkirtCircle", "flare-skirt.length": 0.95}), {}
    )
    assert drawing.pattern is not None
    assert any(fault.startswith(("too_heavy", "reaches_floor", "overloaded_hips")) for fault in drawing.faults)


def test_sections_in_use_follow_the_garment(desk: Desk) -> None:
    assert "flare-skirt" in desk.draw(values(desk), {}).used
    assert "flare-skirt" not in desk.draw(values(desk, meta__bottom="Pants"), {}).used


@pytest.mark.parametrize(
    ("changes", "measures"),
    [
        ({"meta.upper": "Toga"}, {}),
        ({"nonsense.x": 1}, {}),
        ({"sleeve": 1, "sleeve.length": 1}, {}),
        ({}, {"waist": "wide"}),
        ({}, {"tail": 3.0}),
    ],
)
def test_invalid_values_are_refused(changes: dict[str, object], measures: dict[str, object], desk: Desk) -> None:
    with pytest.raises(ConfigError):
        desk.draw({**values(desk), **changes}, measures)


def test_a_saved_design_is_read_back(desk: Desk, tmp_path: Path) -> None:
    path = tmp_path / "design_params.yaml"
    path.write_text(desk.file_text(values(desk, **{"flare-skirt.length": 0.31})))
    assert read_design(path).flare_skirt.length == pytest.approx(0.31)


def test_a_design_is_draped_on_request(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(design_desk, "COARSE", 6.0)
    content = desk.draped(values(desk), {})
    assert content.outcome is Outcome.SETTLED
    assert content.draped is not None and np.isfinite(content.draped).all()
    assert "stretch" in content.values and content.crossed is not None
