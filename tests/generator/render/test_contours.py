"""Lines in pictures lie where geometry puts them."""

import numpy as np
import pytest

from gcd_dataset.generator.render.strokes import (
    Segments,
    SketchLine,
    by_hand,
    chains,
    cracks,
    dashed,
    draw_strokes,
    level_lines,
    linked,
    smoothed,
    valleys,
)

ROW, COLUMN = np.indices((60, 80)).astype(float)


def test_a_level_line_of_a_distance_is_a_circle() -> None:
    [circle] = chains(level_lines(np.hypot(COLUMN - 40.3, ROW - 28.6), 20.0))
    assert (circle[0] == circle[-1]).all()
    assert np.hypot(circle[:, 0] - 40.3, circle[:, 1] - 28.6) == pytest.approx(20.0, abs=0.02)


def test_level_lines_end_at_missing_values() -> None:
    field = np.where(ROW < 30, COLUMN, np.nan)
    [line] = chains(level_lines(field, 12.25))
    assert line[:, 0] == pytest.approx(12.25)
    assert (line[:, 1].min(), line[:, 1].max()) == (0, 29)


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.2, 2.5])
def test_a_valley_is_its_deepest_line(angle: float) -> None:
    """A parabola across a slanted line has that line as its only valley, of curvature 2 · 0.01."""
    across = (COLUMN - 40) * np.cos(angle) + (ROW - 30) * np.sin(angle)
    segments, strength = valleys(0.01 * across**2, sigma=1.0)
    used = segments.place[segments.ends]
    used = used[(np.abs(used - [40, 30]) < 18).all(axis=(1, 2))].reshape(-1, 2)  # away from the border of the picture
    assert len(used) > 30
    found = (used[:, 0] - 40) * np.cos(angle) + (used[:, 1] - 30) * np.sin(angle)
    assert np.abs(found).max() < 0.05
    assert strength[30, 40] == pytest.approx(0.02, rel=0.01)


def test_the_border_of_a_square_is_one_closed_line() -> None:
    mask = np.zeros((9, 11), bool)
    mask[2:5, 3:9] = True
    [line] = chains(cracks(mask[:, :-1] != mask[:, 1:], mask[:-1] != mask[1:]))
    assert (line[0] == line[-1]).all()
    assert len(line) == 2 * (3 + 6) + 1
    assert (line.min(axis=0) == [2.5, 1.5]).all()
    assert (line.max(axis=0) == [8.5, 4.5]).all()


def test_lines_end_where_three_meet() -> None:
    star = Segments(np.array([[0, 1], [1, 2], [0, 3], [0, 4], [4, 5]]), np.arange(12.0).reshape(6, 2))
    lines = chains(star)
    assert sorted(len(line) for line in lines) == [2, 3, 3]
    assert all((line[0] == star.place[0]).all() for line in lines)


def test_smoothing_keeps_straight_lines_and_ends() -> None:
    steps = np.array([[x + k, x] for x in range(40) for k in (0, 1)], float)  # a staircase at 45 degrees
    curve = smoothed(steps, 3.0)
    assert curve[0] == pytest.approx(steps[0], abs=1e-9)
    assert curve[-1] == pytest.approx(steps[-1], abs=1e-9)
    assert np.ptp(curve[10:-10, 0] - curve[10:-10, 1]) < 0.1


@pytest.mark.parametrize("width", [0.6, 1.5, 4.0])
@pytest.mark.parametrize("slope", [0.0, 0.7])
def test_the_ink_of_a_line_is_its_length_times_its_width(width: float, slope: float) -> None:
    size = 200
    points = np.array([[0.2, 0.2], [0.8, 0.2 + 0.6 * slope]])
    picture = draw_strokes([SketchLine(points, width / size)], size)
    ink = float((255 - picture.astype(float)).sum()) / 255
    length = size * float(np.linalg.norm(points[1] - points[0]))
    assert ink == pytest.approx(length * width, rel=0.06)


def test_dashes_are_equal_and_fill_the_line() -> None:
    line = SketchLine(np.array([[0.1, 0.5], [0.9, 0.5]]), 0.01)
    pieces = dashed(line, 0.05, 0.03)
    assert len(pieces) == 10
    assert np.ptp([piece.length for piece in pieces]) < 1e-12
    assert pieces[0].points[0].tolist() == [0.1, 0.5]
    assert pieces[-1].points[-1] == pytest.approx([0.9, 0.5])


def test_a_hand_stays_near_the_line_and_does_not_repeat_itself() -> None:
    line = SketchLine(np.array([[0.1, 0.5], [0.9, 0.5]]), 0.004)
    first, again, other = (by_hand(line, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert all((a.points == b.points).all() for a, b in zip(first, again, strict=True))
    assert len(first) != len(other) or not np.array_equal(first[0].points, other[0].points)
    points = np.concatenate([piece.points for piece in first])
    assert 1e-4 < np.abs(points[:, 1] - 0.5).max() < 0.02
    assert (np.diff(np.sort(points[:, 0])) < 0.01).all()  # pieces leave no gap


def test_lines_are_joined_where_one_goes_on_as_another() -> None:
    along = np.arange(20.0)
    level = np.stack([along, np.zeros(20)], axis=1)
    after, aside = level[::-1] + [24.0, 0.0], np.stack([np.full(20, 21.0), along + 3.0], axis=1)
    lines = linked([level, aside, after], 6.0)
    assert sorted(len(line) for line in lines) == [20, 40]
    (joined,) = (line for line in lines if len(line) == 40)
    assert (np.abs(np.diff(joined[:, 0])) <= 5).all()
    assert np.ptp(joined[:, 0]) == 43
    assert len(linked([level, after], 4.0)) == 2


def test_quarters_of_a_circle_make_a_ring() -> None:
    angle = np.linspace(0.0, 0.5 * np.pi, 60)
    quarters = [30.0 * np.stack([np.cos(angle + turn), np.sin(angle + turn)], axis=1)
                for turn in 0.5 * np.pi * np.arange(4)]  # fmt: skip
    (ring,) = linked(quarters, 2.0)
    assert len(ring) == 240
    assert np.linalg.norm(np.diff(ring, axis=0), axis=1).max() < 1.0
