"""The log of a run: complete JSON lines; log errors never stop the run."""

import json
import logging
import os
import resource
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from gcd_dataset import generate, generate_people
from gcd_dataset.cli import main
from gcd_dataset.errors import GcdError
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.making import log
from gcd_dataset.making.progress import Progress, ignore_progress
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
    assert begin["event"] == "begin"
    assert begin["options"]["seed"] == 3
    assert begin["options"]["stage"] == "pattern"
    assert begin["versions"]["numpy"]
    assert begin["recipe"] == recipe_hash(recipe_of(FLAT))
    assert begin["machine"]["cores"] >= 1
    assert [line["event"] for line in progress] == ["progress"] * 2
    assert [line["made"] for line in progress] == [2, 4]
    assert all(set(line) == {"event", "time"} | FIGURES for line in progress)
    assert set(end) == {"event", "time", "seconds"} | FIGURES
    assert (end["event"], end["count"], end["made"]) == ("end", 5, 5)
    assert end["rss_mb"] > 10


def test_a_run_that_goes_on_appends(tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    for count in (1, 3):
        generate(tmp_path / "data", count, config=FLAT, log=path)
    assert [line["event"] for line in lines(path)] == ["begin", "end", "begin", "end"]
    assert lines(path)[-1]["there"] == 1
    generate_people(tmp_path / "people", 2, log=path)
    assert [line["event"] for line in lines(path)[4:]] == ["begin", "end"]


@pytest.mark.parametrize(
    ("error", "event", "logged"),
    [
        (GcdError("a worker was killed"), "failed", "a worker was killed"),
        (RuntimeError("a bug\nof ours"), "failed", "a bug of ours"),
        (KeyboardInterrupt(), "stopped", None),
    ],
)
def test_the_last_line_holds_the_reason_why_a_run_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException, event: str, logged: str | None
) -> None:
    def broken(*_: Any, **__: Any) -> Iterator[Any]:
        yield from ()
        raise error

    monkeypatch.setattr("gcd_dataset.making.garments.produce", broken)
    with pytest.raises(type(error)):
        generate(tmp_path / "data", 1, config=FLAT, log=tmp_path / "run.jsonl")
    last = lines(tmp_path / "run.jsonl")[-1]
    assert (last["event"], last.get("error")) == (event, logged)


def test_faults_of_the_folder_are_logged(tmp_path: Path) -> None:
    generate(tmp_path / "data", 1, config=FLAT)
    with pytest.raises(GcdError):
        generate(tmp_path / "data", 1, seed=1, config=FLAT, log=tmp_path / "run.jsonl")
    assert "seed" in lines(tmp_path / "run.jsonl")[-1]["error"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("milk\nbread", "its last line is not a line of a run log: choose another file"),
        ("bread", "its last line is not a line of a run log: choose another file"),
        ('{"members": ["meta.json"]}\n', "its last line is not a line of a run log: choose another file"),
        ("folder", "choose another name"),
        ("pipe", "cannot be written"),
    ],
)
def test_a_file_that_is_no_log_is_refused_and_kept(
    content: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "file"
    others: dict[str, Callable[[], object]] = {"folder": path.mkdir, "pipe": partial(os.mkfifo, path)}
    others.get(content, partial(path.write_text, content))()
    arguments = ["generate", str(tmp_path / "data"), "--count=1", "--stage=pattern", "--quiet"]
    assert main([*arguments, "--log", str(path)]) == 1
    assert message in capsys.readouterr().err
    assert not path.is_file() or path.read_text() == content
    assert not (tmp_path / "data").exists()


def test_a_partial_last_line_is_dropped(tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    path.write_text('{"event": "begin", "time": "1"}\n{"event": "progr')
    generate(tmp_path / "data", 1, config=FLAT, log=path)
    assert [line["event"] for line in lines(path)] == ["begin", "begin", "end"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
def test_a_full_disk_ends_the_log_and_not_the_run(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "gcd_dataset"):
        assert generate(tmp_path / "data", 2, config=FLAT, log="/dev/full").made == 2
    assert len([record for record in caplog.records if "goes on without its log" in record.message]) == 1


def test_a_line_for_which_there_is_half_the_room_is_not_begun(tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    with log.run_log(path, ignore_progress, options={}, recipe={}) as on_progress:
        size = path.stat().st_size
        resource.setrlimit(resource.RLIMIT_FSIZE, (size + 40, before[1]))
        try:
            on_progress(Progress(200, 0, made=100))
            assert path.stat().st_size == size
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        on_progress(Progress(200, 0, made=200))
    assert [line["event"] for line in lines(path)] == ["begin", "progress", "end"]


def test_two_runs_may_share_a_log(tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    with (
        log.run_log(path, ignore_progress, options={"part": 0}, recipe={}),
        log.run_log(path, ignore_progress, options={"part": 1}, recipe={}),
    ):
        pass
    assert [line["event"] for line in lines(path)] == ["begin", "begin", "end", "end"]
