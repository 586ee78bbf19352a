"""Small data sets of generated garments, made in seconds, and one of a small published recipe."""

import itertools
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import pytest

from gcd_dataset import generate_recipe
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.generator.recipes import Recipe, find_recipe
from gcd_dataset.making.progress import Progress
from gcd_dataset.records import Sample
from tests.generator.test_recipes import written

CUFFED = MakeConfig(
    stage="pattern",
    bodies="both",
    design=Overlay.from_dict(
        {
            "meta": {"upper": "none", "bottom": "Pants"},
            "pants": {"cuff": {"type": {"options": ["CuffBand"]}, "top_ruffle": 2.0}},
        }
    ),
)
"""Trousers with narrow cuffs on two bodies; some designs are rejected, since the leg does not fit the cuff."""

COUNT = 23
"""Samples: eleven designs on two bodies each, and a twelfth on one."""


@cache
def _samples(seed: int, config: MakeConfig, count: int) -> tuple[Sample, ...]:
    return tuple(produce(seed, range(count), config))


def made_once(
    seed: int, indices: Iterable[int], config: MakeConfig, *, finished: Callable[[Sample], Any], workers: int = 0
) -> Iterator[Any]:
    """Replaces ``produce``: the samples are cached, so that a test process makes each once."""
    for index in indices:
        yield finished(_samples(seed, config, COUNT)[index])


def exit_codes(*works: Callable[[], Any]) -> list[int | None]:
    """Exit codes of forked processes that do the works at the same time."""
    children = [multiprocessing.get_context("fork").Process(target=work) for work in works]
    for child in children:
        child.start()
    for child in children:
        child.join()
    return [child.exitcode for child in children]


def killed(work: Callable[..., Any], *, after: int) -> None:
    """Run ``work(on_progress=…)`` in a forked process that kills itself after ``after`` progress reports."""
    steps = itertools.count()

    def report(progress: Progress) -> None:
        if next(steps) == after:
            os.kill(os.getpid(), signal.SIGKILL)

    assert exit_codes(partial(work, on_progress=report)) == [-signal.SIGKILL]


def stopped(work: Callable[..., Any], *, after: int) -> None:
    """Run ``work(on_progress=…)`` until Ctrl-C after ``after`` samples."""

    def report(progress: Progress) -> None:
        if progress.made == after:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work(on_progress=report)


@pytest.fixture(scope="module")
def toml(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("recipe"))


@pytest.fixture(scope="module")
def recipe(toml: Path) -> Recipe:
    return find_recipe(toml)


@pytest.fixture(scope="module")
def made(recipe: Recipe, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten designs as patterns, in two splits."""
    folder = tmp_path_factory.mktemp("made") / "tiny"
    assert generate_recipe(folder, recipe, workers=0).made == 20
    return folder
