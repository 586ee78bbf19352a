"""Values: records are frozen and compared by content, curves agree with closed forms, random streams are keyed."""

import itertools
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from gcd_dataset.curves import (
    LINE,
    Arc,
    Cubic,
    Curve,
    Quadratic,
    curve_length,
    curve_points,
    curve_tangents,
    from_frame,
    mirrored,
    reversed_curve,
    sample_curve,
    to_frame,
)
from gcd_dataset.errors import BodyError, PatternError
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import MEASURES, BodyShape, Edge, Measurements, Outcome, Panel, Pattern, Placement
from gcd_dataset.seeding import Stage, rng


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
    assert len(Outcome.__members__) == len(Outcome)  # of two with one message the second would be an alias


def test_measures_that_are_missing_in_both_are_equal() -> None:
    """Each NaN is another object, as after decoding."""
    one, other = (Measurements(height=170.0, waist=float("nan")) for _ in range(2))
    assert one == other
    assert hash(one) == hash(other)
    assert one != Measurements(height=170.0, waist=70.0)
    assert one != Measurements(height=171.0)


START, END = (3.0, -2.0), (11.0, 4.0)
CURVES: tuple[Curve, ...] = (
    LINE,
    Quadratic((0.4, 0.3)),
    Cubic((0.2, 0.5), (0.9, -0.4)),
    Arc(8.0, large=False, right=True),
    Arc(6.0, large=True, right=False),
)


def test_length_of_a_quarter_circle() -> None:
    assert curve_length((10, 0), (0, 10), Arc(10, large=False, right=True)) == pytest.approx(5 * np.pi)
    assert curve_length((10, 0), (0, 10), Arc(10, large=True, right=True)) == pytest.approx(15 * np.pi)


def test_an_arc_to_the_right_bulges_to_the_right() -> None:
    """Travelling along +x, right is -y."""
    middle = curve_points((0, 0), (10, 0), Arc(8, large=False, right=True), np.array([0.5]))[0]
    assert middle[0] == pytest.approx(5)
    assert middle[1] == pytest.approx(-(8 - np.sqrt(64 - 25)))


def test_a_parabola_has_its_closed_length() -> None:
    """y = x² / 2 from x = 0 to 1: (√2 + asinh 1) / 2."""
    control = to_frame((0, 0), (1, 0.5), (0.5, 0.0))
    assert curve_length((0, 0), (1, 0.5), Quadratic(control)) == pytest.approx((np.sqrt(2) + np.arcsinh(1)) / 2)


@pytest.mark.parametrize("curve", CURVES)
def test_ends_are_exact_and_steps_equal(curve: Curve) -> None:
    points = sample_curve(START, END, curve, 60)
    assert tuple(points[0]) == START
    assert tuple(points[-1]) == END
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert np.ptp(steps) < 0.02 * steps.mean()
    assert steps.sum() == pytest.approx(curve_length(START, END, curve), rel=2e-3)


@pytest.mark.parametrize("curve", CURVES)
def test_tangents_are_derivatives_and_a_curve_is_its_own_image_backwards_and_mirrored(curve: Curve) -> None:
    t, step = np.linspace(0.1, 0.9, 5), 1e-6
    ahead, behind = (curve_points(START, END, curve, t + s) for s in (step, -step))
    assert np.allclose(curve_tangents(START, END, curve, t), (ahead - behind) / (2 * step), atol=1e-5)
    assert np.allclose(curve_points(END, START, reversed_curve(curve), 1 - t), curve_points(START, END, curve, t))
    image = curve_points((-START[0], START[1]), (-END[0], END[1]), mirrored(curve), t)
    assert np.allclose(image, curve_points(START, END, curve, t) * [-1.0, 1.0])


finite = st.floats(-100, 100)


@given(st.tuples(finite, finite), st.tuples(finite, finite))
def test_the_edge_frame_and_back(start: tuple[float, float], control: tuple[float, float]) -> None:
    end = (start[0] + 3.0, start[1] - 4.0)
    assert from_frame(start, end, to_frame(start, end, control)) == pytest.approx(control, abs=1e-9)


def test_impossible_curves_are_rejected() -> None:
    with pytest.raises(PatternError, match=r"radius 4 cm cannot span a chord of 10 cm"):
        curve_length((0, 0), (10, 0), Arc(4.0, large=False, right=True))
    with pytest.raises(PatternError, match="no length"):
        to_frame((1, 1), (1, 1), (2, 2))


def test_every_key_has_its_own_stream() -> None:
    names = list(itertools.product((0, 1), (0, 1), (Stage.BODY, Stage.DESIGN), (0, 1)))
    first = {rng(seed, index, stage, attempt).integers(2**63) for seed, index, stage, attempt in names}
    assert len(first) == len(names)


def test_the_numbers_of_a_release_stay() -> None:
    """A change here would change every sample of every published seed."""
    assert rng(0, 0, Stage.BODY).integers(1000, size=3).tolist() == [199, 964, 836]
    assert rng(7, 12, Stage.DESIGN, 1).integers(1000, size=3).tolist() == [491, 768, 710]


def test_neighbours_are_uncorrelated() -> None:
    draws = np.array([rng(3, index, Stage.DESIGN).standard_normal(4) for index in range(500)])
    assert np.abs(np.corrcoef(draws[:-1, 0], draws[1:, 0])[0, 1]) < 0.15
    assert np.abs(draws.mean(axis=0)).max() < 0.2


def test_keys_are_natural_numbers() -> None:
    with pytest.raises(ValueError, match="index is -1"):
        rng(0, -1, Stage.BODY)


def test_edges_are_those_that_trimesh_finds() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=2)
    edges = mesh_edges(sphere.faces)
    expected = np.sort(sphere.edges_unique, axis=1)
    assert (edges.ends == expected[np.lexsort(expected.T[::-1])]).all()
    assert (edges.counts == 2).all()
    assert len(sphere.vertices) - len(edges.ends) + len(sphere.faces) == 2  # Euler's formula


def test_faces_know_their_edges() -> None:
    faces = np.array([[4, 0, 9], [0, 4, 2]], np.uint16)
    edges = mesh_edges(faces)
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2)
    assert (edges.ends[edges.of_faces] == np.sort(sides, axis=2)).all()
    assert edges.counts[edges.of_faces].tolist() == [[2, 1, 1], [2, 1, 1]]
    edges = mesh_edges(np.zeros((0, 3), int))
    assert (edges.ends.shape, edges.of_faces.shape, edges.counts.shape) == ((0, 2), (0, 3), (0,))
