"""Progress, rate and waits of a verb."""

from collections import Counter
from collections.abc import Sequence
from types import SimpleNamespace

import pytest

from gcd_dataset.cli.bar import postfix
from gcd_dataset.making.progress import Pace, Progress
from gcd_dataset.waits import Wait, Waits


def paced(steps: Sequence[tuple[float, Waits]], count: int = 10_000) -> Progress:
    """The progress after one sample for each step, given as (seconds, waits)."""
    clock = SimpleNamespace(now=100.0)
    pace, progress = Pace(lambda: clock.now), Progress(count, 0)
    for seconds, waits in steps:
        clock.now += seconds
        progress = pace.of(progress.with_made(), waits)
    assert len(pace._marks) <= 62  # for any number of samples
    return progress


def test_the_rate_is_that_of_the_last_minute() -> None:
    slow: list[tuple[float, Waits]] = [(1.0, {})] * 200
    fast: list[tuple[float, Waits]] = [(0.1, {})] * 700
    progress = paced(slow + fast)
    assert progress.rate == pytest.approx(10.0)
    assert progress.left_s == pytest.approx((10_000 - 900) / 10.0)


def test_a_run_of_less_than_a_minute_counts_from_its_beginning() -> None:
    assert paced([(5.0, {})] * 4).rate == pytest.approx(0.2)


def test_a_first_sample_without_time_has_no_rate() -> None:
    progress = paced([(0.0, {})])
    assert progress.rate is None
    assert progress.left_s is None


def test_waits_are_those_of_the_last_minute() -> None:
    waiting, busy = {"writer": Wait(1.0, 1.0)}, {"writer": Wait(0.25, 1.0)}
    assert paced([(1.0, waiting)] * 300 + [(1.0, busy)] * 70).waits == {"writer": pytest.approx(0.25)}


def test_a_finished_run_has_no_time_left() -> None:
    assert paced([(1.0, {})] * 3, count=3).left_s == 0.0


def test_the_bar_names_outcomes_waits_and_the_most_frequent_rules() -> None:
    rejects = Counter({"too_heavy": 7, "short_edge": 3, "sharp_corner": 2, "drape": 1})
    outcomes = Counter({"SETTLED": 90, "NOT_SETTLED": 2})
    progress = Progress(100, 0, made=92, rejects=rejects, outcomes=outcomes, waits={"cuda:0": 0.123, "writer": 0.6})
    assert postfix(progress) == (
        "not_settled 2, waits: cuda:0 12% writer 60%, rejected 13 (too_heavy 7, short_edge 3, sharp_corner 2, …)"
    )
