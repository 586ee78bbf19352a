"""Records are values: frozen, compared by content, in one set of units."""

from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from gcd_dataset.errors import BodyError, PatternError
from gcd_dataset.records import MEASURES, BodyShape, Edge, Measurements, Outcome, Panel, Pattern, Placement


def shape(*weights: float) -> BodyShape:
    return BodyShape(np.array(weights))


def test_records_are_compared_by_value() -> None:
    assert shape(1.0, 2.0) == shape(1.0, 2.0)
    assert shape(1.0, 2.0) != shape(1.0, 2.5)
    assert shape(1.0) != replace(shape(1.0), legs_apart=True)
    assert shape(np.nan) == shape(np.nan)


def test_arrays_in_records_cannot_be_written() -> None:
    weights = np.array([1.0, 2.0])
    record = BodyShape(weights)
    with pytest.raises(ValueError, match="read-only"):
        record.weights[0] = 5.0
    with pytest.raises(FrozenInstanceError):
        record.arm_angle = 1.0  # type: ignore[misc]
    weights[0] = 3.0  # the caller's own array stays writable


def test_a_measurement_file_is_in_degrees() -> None:
    size = Measurements.from_file_values({"waist": 70.0, "shoulder_incl": 30.0, "_derived": 1.0})
    assert size.shoulder_incl == pytest.approx(np.pi / 6)
    assert size.to_file_values() == {"waist": 70.0, "shoulder_incl": pytest.approx(30.0)}
    assert MEASURES.index("crotch_hip_diff") == 25  # GarmentCode's 26 measures come first


def test_missing_measures_are_named() -> None:
    with pytest.raises(BodyError, match="measures hips, wrist are missing"):
        Measurements(waist=70.0).require("waist", "hips", "wrist")


def test_levels_add_up() -> None:
    size = Measurements(height=170.0, head_l=25.0, waist_line=40.0, hips_line=20.0)
    assert size.waist_level == 105.0
    assert size.leg_length == 85.0


def test_a_panel_turns_about_x_then_y_then_z() -> None:
    """90 degrees about x lay the panel down; 90 degrees about z then put it on its side."""
    place = Placement(np.array([0.0, 0.0, 5.0]), np.array([np.pi / 2, 0.0, np.pi / 2]))
    points = place.apply(np.array([[1.0, 0.0], [0.0, 1.0]]))
    assert np.allclose(points, [[0.0, 1.0, 5.0], [0.0, 0.0, 6.0]])
    assert np.allclose(place.matrix @ place.matrix.T, np.eye(3))
    assert np.linalg.det(place.matrix) == pytest.approx(1.0)


def test_a_panel_is_found_by_name() -> None:
    panel = Panel("front", np.zeros((1, 2)), (Edge(0, 0),), Placement(np.zeros(3), np.zeros(3)))
    assert Pattern("p", (panel,), ()).panel("front") is panel
    with pytest.raises(PatternError, match="no panel named side: there are front"):
        Pattern("p", (panel,), ()).panel("side")


def test_every_outcome_has_its_own_message() -> None:
    assert len({outcome.value for outcome in Outcome}) == len(Outcome)


def test_measures_that_are_missing_in_both_are_equal() -> None:
    """Each NaN is another object, as after decoding."""
    one, other = (Measurements(height=170.0, waist=float("nan")) for _ in range(2))
    assert one == other
    assert hash(one) == hash(other)
    assert one != Measurements(height=170.0, waist=70.0)
    assert one != Measurements(height=171.0)
