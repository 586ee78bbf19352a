"""Kills at each operation on files: nothing is lost but the sample in work, and no file is left over."""

import os
import signal
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from gcd_dataset import generate
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.making import run
from gcd_dataset.making.tasks import Work
from gcd_dataset.shards import encode_sample
from gcd_dataset.shards.manifest import Plan
from gcd_dataset.shards.place import FolderPlace
from tests.making.real import contents, killed

RENAMES = ("replace", "unlink", "mkdir", "rmdir")
"""The functions of ``os`` between which the files of a data set change."""
FLAT = MakeConfig(stage="pattern")


@cache
def encoded(index: int) -> dict[str, bytes]:
    return encode_sample(fake_sample(0, index))


def make(folder: Path, count: int) -> None:
    """Make garments with pictures, on two bodies each; every third is a failed drape."""

    def maker(wanted: run.Wanted) -> Iterator[run.Made]:
        for index in (index for _, left in wanted for index in left):
            yield run.Made(index, encoded(index), failed=index % 3 == 1)

    plan = Plan("garments", 0, {"fake": True}, count, 1)
    run.run(Work(FolderPlace(folder), plan, {"train": range(count)}, 2), maker)


def killed_at(work: Callable[[], Any], number: int) -> bool:
    """Run ``work`` in a forked process that kills itself before its ``number``-th call of ``RENAMES``."""
    child = os.fork()
    if child == 0:
        calls = iter(range(number + 1))

        def counted(function: Callable[..., Any]) -> Callable[..., Any]:
            def call(*arguments: Any, **options: Any) -> Any:
                if next(calls, None) == number:
                    os.kill(os.getpid(), signal.SIGKILL)
                return function(*arguments, **options)

            return call

        try:
            for name in RENAMES:
                setattr(os, name, counted(getattr(os, name)))
            work()
        finally:
            os._exit(0)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("whole")
    make(folder, 5)
    return contents(folder)


@pytest.mark.parametrize("before", [0, 3])
def test_a_run_killed_anywhere_goes_on_to_the_same_bytes(before: int, tmp_path: Path, whole: dict[str, bytes]) -> None:
    """Of a new data set, and of one that grows."""
    for number in range(1000):
        folder = tmp_path / str(number)
        if before:
            make(folder, before)
        was_killed = killed_at(lambda folder=folder: make(folder, 5), number)  # type: ignore[misc]
        make(folder, 5)
        assert contents(folder) == whole, f"killed before call {number}"
        if not was_killed:
            break
    assert 30 < number < 999


def test_a_data_set_that_was_set_aside_is_not_mixed_with_another(tmp_path: Path) -> None:
    generate(tmp_path, 3, config=FLAT, workers=0)
    killed(lambda **options: generate(tmp_path, 5, config=FLAT, workers=0, **options), after=0)
    assert not list(tmp_path.glob("*.tar"))
    with pytest.raises(ConfigError, match="made with seed=0, asked for seed=1"):
        generate(tmp_path, 5, seed=1, config=FLAT, workers=0)
    with pytest.raises(ConfigError, match="a data set of 3 samples, asked for 2"):
        generate(tmp_path, 2, config=FLAT, workers=0)


def test_shards_without_notes_are_not_taken_for_those_of_another_seed(tmp_path: Path) -> None:
    generate(tmp_path, 3, config=FLAT, workers=0)
    for path in tmp_path.glob("*.json"):
        path.unlink()
    with pytest.raises(ConfigError, match="made with seed=0, asked for seed=1"):
        generate(tmp_path, 3, seed=1, config=FLAT, workers=0)


def test_the_files_of_a_stopped_growth_are_not_called_other_files(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    generate(tmp_path, 3, config=FLAT, workers=0)
    killed(lambda **options: generate(tmp_path, 5, config=FLAT, workers=0, **options), after=0)
    generate(tmp_path, 5, config=FLAT, workers=0)
    assert not caplog.text
