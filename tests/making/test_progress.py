"""Progress and rate of a verb."""

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace

import pytest

from gcd_dataset.cli.common import postfix
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.making.progress import Pace, Progress
from gcd_dataset.making.run import Made, Wanted, run
from gcd_dataset.making.store import place_for
from gcd_dataset.making.tasks import Work
from gcd_dataset.shards.codec import encode_sample
from gcd_dataset.shards.manifest import Plan


def paced(steps: Sequence[float], count: int = 10_000) -> Progress:
    """The progress after one sample for each step, given in seconds."""
    clock = SimpleNamespace(now=100.0)
    pace, progress = Pace(lambda: clock.now), Progress(count, 0)
    for seconds in steps:
        clock.now += seconds
        progress = pace.of(progress.with_made())
    assert len(pace._marks) <= 62  # for any number of samples
    return progress


def test_the_rate_is_that_of_the_last_minute() -> None:
    progress = paced([1.0] * 200 + [0.1] * 700)
    assert progress.rate == pytest.approx(10.0)
    assert progress.left_s == pytest.approx((10_000 - 900) / 10.0)


def test_a_run_of_less_than_a_minute_counts_from_its_beginning() -> None:
    assert paced([5.0] * 4).rate == pytest.approx(0.2)


def test_a_first_sample_without_time_has_no_rate() -> None:
    progress = paced([0.0])
    assert progress.rate is None
    assert progress.left_s is None


def test_a_finished_run_has_no_time_left() -> None:
    assert paced([1.0] * 3, count=3).left_s == 0.0


def test_the_bar_names_outcomes_and_the_most_frequent_rules() -> None:
    rejects = Counter({"too_heavy": 7, "short_edge": 3, "sharp_corner": 2, "drape": 1})
    outcomes = Counter({"SETTLED": 90, "NOT_SETTLED": 2})
    progress = Progress(100, 0, made=92, rejects=rejects, outcomes=outcomes)
    assert postfix(progress) == ("not_settled 2, rejected 13 (too_heavy 7, short_edge 3, sharp_corner 2, …)")


def test_an_interrupted_run_closes_its_source_at_once(tmp_path: Path) -> None:
    closed = []

    def make(wanted: Wanted) -> Iterator[Made]:
        try:
            yield Made(0, encode_sample(fake_sample(0, 0)))
        finally:
            closed.append(True)

    def interrupt(progress: Progress) -> None:
        if progress.made:
            raise KeyboardInterrupt

    work = Work(place_for(tmp_path), Plan("garments", 0, {"fake": True}, 3, 1), {"train": range(3)})
    with pytest.raises(KeyboardInterrupt) as caught:
        run(work, make, on_progress=interrupt)
    assert closed, f"not while the traceback of {caught!r} holds its frames"
