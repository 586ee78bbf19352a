"""Progress of a run, and its log: JSON lines; log errors never stop the run."""

import json
import logging
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from gcd_dataset import generate, generate_people
from gcd_dataset.cli.common import postfix
from gcd_dataset.errors import GcdError, OutputError
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.making import log
from gcd_dataset.making.progress import Pace, Progress, ignore_progress
from gcd_dataset.shards.layout import recipe_hash

FLAT = MakeConfig(stage="pattern")
FIGURES = {"count", "there", "made", "rate", "left_s", "outcomes", "rejects", "rss_mb"}


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_a_log_has_begin_progress_and_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log, "EVERY", 2)
    path = tmp_path / "logs" / "run.jsonl"
    generate(tmp_path / "data", 5, seed=3, config=FLAT, workers=1, log=path)
    begin, *progress, end = lines(path)
    assert (begin["event"], begin["recipe"]) == ("begin", recipe_hash(recipe_of(FLAT)))
    assert (begin["options"]["seed"], begin["options"]["stage"]) == (3, "pattern")
    assert begin["versions"]["numpy"] and begin["machine"]["cores"] >= 1
    assert [line["event"] for line in progress] == ["progress"] * 2
    assert [line["made"] for line in progress] == [2, 4]
    assert all(set(line) == {"event", "time"} | FIGURES for line in progress)
    assert set(end) == {"event", "time", "seconds"} | FIGURES
    assert (end["event"], end["count"], end["made"]) == ("end", 5, 5)
    assert end["rss_mb"] > 10


def test_a_run_that_goes_on_appends(tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    for _ in range(2):
        generate(tmp_path / "data", 1, config=FLAT, log=path)
    assert [line["event"] for line in lines(path)] == ["begin", "end", "begin", "end"]
    assert lines(path)[-1]["there"] == 1
    generate_people(tmp_path / "people", 2, log=path)
    with pytest.raises(GcdError):
        generate(tmp_path / "data", 1, seed=1, config=FLAT, log=path)
    assert [line["event"] for line in lines(path)[4:]] == ["begin", "end", "begin", "failed"]
    assert "seed" in lines(path)[-1]["error"]


def test_the_last_line_holds_the_reason_why_a_run_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for error, event, logged in (
        (GcdError("a worker was killed"), "failed", "a worker was killed"),
        (RuntimeError("a bug\nof ours"), "failed", "a bug of ours"),
        (KeyboardInterrupt(), "stopped", None),
    ):
        monkeypatch.setattr("gcd_dataset.making.garments.produce", Mock(side_effect=error))
        with pytest.raises(type(error)):
            generate(tmp_path / "data", 1, config=FLAT, log=tmp_path / "run.jsonl")
        last = lines(tmp_path / "run.jsonl")[-1]
        assert (last["event"], last.get("error")) == (event, logged)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
def test_a_full_disk_ends_the_log_and_not_the_run(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "gcd_dataset"):
        assert generate(tmp_path / "data", 2, config=FLAT, log="/dev/full").made == 2
    assert len([record for record in caplog.records if "goes on without its log" in record.message]) == 1
    with pytest.raises(OutputError, match="choose another name"):
        generate(tmp_path / "other", 2, config=FLAT, log=tmp_path)
    assert not (tmp_path / "other").exists()


def test_two_runs_may_share_a_log(tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    with (
        log.run_log(path, ignore_progress, options={"part": 0}, recipe={}),
        log.run_log(path, ignore_progress, options={"part": 1}, recipe={}),
    ):
        pass
    assert [line["event"] for line in lines(path)] == ["begin", "begin", "end", "end"]


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
    assert paced([5.0] * 4).rate == pytest.approx(0.2)  # a run of less than a minute
    assert paced([1.0] * 3, count=3).left_s == 0.0
    first = paced([0.0])
    assert (first.rate, first.left_s) == (None, None)


def test_the_bar_names_outcomes_and_the_most_frequent_rules() -> None:
    rejects = Counter({"too_heavy": 7, "short_edge": 3, "sharp_corner": 2, "drape": 1})
    outcomes = Counter({"SETTLED": 90, "NOT_SETTLED": 2})
    progress = Progress(100, 0, made=92, rejects=rejects, outcomes=outcomes)
    assert postfix(progress) == "not_settled 2, rejected 13 (too_heavy 7, short_edge 3, sharp_corner 2, …)"
