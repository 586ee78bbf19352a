"""Body sets are made like garments: by jobs, after kills, growing, with equal bytes."""

from functools import partial
from pathlib import Path

import pytest

from gcd_dataset import Job, generate_people, index
from gcd_dataset.errors import ConfigError
from gcd_dataset.shards.place import FolderPlace
from tests.making.real import contents, killed

make = partial(generate_people, count=12, seed=3, bodies="female", workers=0)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("people")
    make(folder)
    return contents(folder)


@pytest.mark.parametrize("after", [0, 3, 9])
def test_a_killed_run_continues_to_the_same_bytes(after: int, tmp_path: Path, whole: dict[str, bytes]) -> None:
    killed(partial(make, tmp_path), after=after)
    assert make(tmp_path).made == 12 - after
    assert contents(tmp_path) == whole


def test_jobs_are_one_run(tmp_path: Path, whole: dict[str, bytes]) -> None:
    for number in (1, 0):
        make(tmp_path, job=Job(number, 2))
    assert contents(tmp_path) == whole


def test_a_set_grows(tmp_path: Path, whole: dict[str, bytes]) -> None:
    generate_people(tmp_path, 5, seed=3, bodies="female", workers=0)
    assert make(tmp_path).made == 7
    assert contents(tmp_path) == whole
    for name in ("train.index", "manifest.json"):
        (tmp_path / name).unlink()
    index(FolderPlace(tmp_path))
    assert contents(tmp_path) == whole
    with pytest.raises(ConfigError, match="bodies='female', asked for bodies='male'"):
        generate_people(tmp_path, 12, seed=3, bodies="male")
