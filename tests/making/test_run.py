"""Equal plans give equal bytes: by one run, several jobs, racing or killed runs, on a full disk, in a store."""

import hashlib
import itertools
import json
import os
import resource
import shutil
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import fsspec
import pytest

from gcd_dataset import Job, generate, generate_people, index
from gcd_dataset.cli import main
from gcd_dataset.errors import ConfigError, OutputError, ShardError
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.making import garments, run, store
from gcd_dataset.making.tasks import Work
from gcd_dataset.shards import ShardReader, encode_sample, read_manifest
from gcd_dataset.shards.access import Place
from gcd_dataset.shards.manifest import Plan
from gcd_dataset.shards.notes import StoredSample, stored_samples
from gcd_dataset.shards.writer import draft_name
from tests.making.conftest import COUNT, CUFFED, exit_codes, killed, made_once, stopped
from tests.shards.folders import contents, forbidden, public_folder

make = partial(generate, config=CUFFED, workers=0)


@pytest.fixture(scope="module", autouse=True)
def cached() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(garments, "produce", made_once)
        yield


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("first") / "set"
    assert make(folder, COUNT).made == COUNT
    return folder


@pytest.fixture(scope="module")
def whole(first: Path) -> dict[str, bytes]:
    """The files of one run."""
    return contents(first)


@pytest.fixture
def copy(first: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(first, tmp_path / "copy"))


def test_the_files_of_a_data_set(first: Path, whole: dict[str, bytes]) -> None:
    """Twelve shards of a design each, on two bodies: 23 // 20 samples, rounded up to whole designs."""
    names = {f"train-{number:05d}.{ending}" for number in range(12) for ending in ("tar", "json")}
    assert whole.keys() == names | {"manifest.json", "train.index", "rejects.jsonl"}
    split = (read_manifest(first) or pytest.fail("no manifest")).splits["train"]
    assert hashlib.sha256(whole["train.index"]).hexdigest() == split.index_sha256


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1)])
def test_jobs_in_any_order_are_one_run(order: tuple[int, ...], tmp_path: Path, whole: dict[str, bytes]) -> None:
    for number in order:
        assert not (tmp_path / "manifest.json").exists()
        make(tmp_path, COUNT, job=Job(number, 3))
    assert contents(tmp_path) == whole


def test_workers_change_no_byte(tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(garments, "produce", produce)
    made = generate(tmp_path, COUNT, config=CUFFED, workers=2)
    assert contents(tmp_path) == whole
    assert made.rejects == {"tight_cuff": len(whole["rejects.jsonl"].splitlines())}  # once for all wearers


def test_racing_runs_write_one_data_set(tmp_path: Path, whole: dict[str, bytes]) -> None:
    assert exit_codes(*3 * [partial(make, tmp_path, COUNT)]) == [0, 0, 0]
    assert contents(tmp_path) == whole


def test_a_draft_that_another_run_finishes_while_it_is_read_is_no_error(
    tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    killed(partial(make, tmp_path, COUNT), after=3)

    def vanishing(path: Path, **options: Any) -> Iterator[StoredSample]:
        path.unlink(missing_ok=True)
        return stored_samples(path, **options)

    monkeypatch.setattr(run, "stored_samples", vanishing)
    make(tmp_path, COUNT)
    assert contents(tmp_path) == whole


def test_a_killed_run_and_ctrl_c_keep_whole_samples(tmp_path: Path, whole: dict[str, bytes]) -> None:
    killed(partial(make, tmp_path, COUNT), after=3)
    stopped(partial(make, tmp_path, COUNT), after=2)
    found = contents(tmp_path)
    shards = {f"train-0000{number}.{ending}" for number in (0, 1) for ending in ("tar", "json")}
    assert found.keys() == shards | {draft_name("train", 2, COUNT)}
    again = make(tmp_path, COUNT)
    assert (again.existing, again.made) == (5, COUNT - 5)
    assert contents(tmp_path) == whole


def test_a_full_disk_and_a_read_only_folder_are_reported(tmp_path: Path, whole: dict[str, bytes]) -> None:
    size = max(len(content) for name, content in whole.items() if name.startswith("train-"))

    def limited() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size - 2048, size - 2048))
        with pytest.raises(OutputError, match=r"\.train-000\d\d-of-\d+\.draft: cannot .*samples in it are kept"):
            make(tmp_path, COUNT)

    assert exit_codes(limited) == [0]
    make(tmp_path, COUNT)
    assert contents(tmp_path) == whole
    with public_folder() as parent:
        folder = Path(shutil.copytree(tmp_path, parent / "set"))
        (folder / "train-00003.tar").unlink()
        with forbidden(folder, 0o555), pytest.raises(OutputError, match="cannot be written"):
            make(folder, COUNT)


@pytest.mark.parametrize(
    "name", ["train-00003.tar", "train-00003.json", "train.index", "manifest.json", "rejects.jsonl"]
)
def test_a_deleted_file_is_made_again(name: str, copy: Path, whole: dict[str, bytes]) -> None:
    (copy / name).unlink()
    make(copy, COUNT)
    index(Place(copy))
    assert contents(copy) == whole


def test_index_twice_is_index_once(copy: Path, whole: dict[str, bytes], capsys: pytest.CaptureFixture[str]) -> None:
    for path in copy.glob("*.json"):  # the notes too: they follow from the tars
        path.unlink()
    for _ in range(2):
        assert main(["index", str(copy)]) == 0
        assert "train: 23 samples in 12 shards" in capsys.readouterr().out
    found = contents(copy)
    assert {*found.items()} <= {*whole.items(), ("manifest.json", found["manifest.json"])}
    assert len(ShardReader(copy, verify="full")) == COUNT


def test_sets_of_bodies_are_made_likewise(tmp_path: Path) -> None:
    people = partial(generate_people, seed=3, bodies="female", workers=0)
    people(tmp_path / "whole", 12)
    for number in (1, 0):
        people(tmp_path / "jobs", 12, job=Job(number, 2))
    assert contents(tmp_path / "jobs") == contents(tmp_path / "whole")
    with pytest.raises(ConfigError, match="bodies='female', asked for bodies='male'"):
        generate_people(tmp_path / "jobs", 12, seed=3, bodies="male")
    with pytest.raises(ConfigError, match="kind='bodies', asked for kind='garments'"):
        make(tmp_path / "jobs", COUNT)
    for name in ("train.index", "manifest.json"):
        (tmp_path / "jobs" / name).unlink()
    index(Place(tmp_path / "jobs"))
    assert contents(tmp_path / "jobs") == contents(tmp_path / "whole")


@pytest.fixture
def url() -> Iterator[str]:
    yield "memory://bucket/set"
    fsspec.filesystem("memory").store.clear()


def stored(url: str) -> dict[str, bytes]:
    fs, root = fsspec.core.url_to_fs(url)
    return {path.removeprefix(f"{root}/"): fs.cat_file(path) for path in fs.find(root)}


def test_a_store_holds_the_bytes_of_a_folder(
    url: str, tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GCD_CACHE", str(tmp_path))
    stopped(partial(make, url, COUNT), after=5)
    assert stored(url).keys() < whole.keys()
    make(url, COUNT, job=Job(0, 2))
    make(url, COUNT, job=Job(1, 2))
    assert stored(url) == whole
    assert make(url, COUNT).made == 0
    fsspec.filesystem("memory").rm("/bucket/set/train-00003.tar")
    assert make(url, COUNT).made == 2
    assert stored(url) == whole
    fsspec.filesystem("memory").rm("/bucket/set/train-00001.json")  # made again from a copy of its tar
    index(store.place_for(url))
    assert not [path for path in (tmp_path / "work").rglob("*") if path.is_file()]
    assert make(url, COUNT).made == 0
    assert stored(url) == whole
    assert not [path for path in (tmp_path / "work").rglob("*") if path.is_file()]
    with pytest.raises(ConfigError, match="seed=0, asked for seed=1"):
        make(url, COUNT, seed=1)
    with pytest.raises(ConfigError, match="asked for 24: choose another folder"):
        make(url, COUNT + 1)


def test_a_store_that_does_not_answer_is_reported(
    url: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def stall(*_: object, **__: object) -> None:
        time.sleep(0.3)
        raise TimeoutError("read timed out")

    monkeypatch.setattr(store, "SLOW", 0.05)
    monkeypatch.setattr(type(fsspec.filesystem("memory")), "find", stall)
    with pytest.raises(
        ShardError, match=r"does not answer, or refuses \(TimeoutError: read timed out; tried for 0 s\)"
    ):
        make(url, COUNT)
    assert f"{url}: no answer for 0 s; still trying, and Ctrl-C stops" in caplog.text


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": 1}, "made with seed=0, asked for seed=1: use the same or another folder"),
        ({"config": MakeConfig(stage="mesh", bodies="both")}, "made with design=.*, asked for design={}"),
    ],
)
def test_another_data_set_is_refused(options: dict[str, Any], message: str, copy: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=message):
        make(copy, COUNT, **options)
    for path in copy.glob("*.json"):  # without its notes, the samples tell
        path.unlink()
    with pytest.raises(ConfigError, match=message):
        make(copy, COUNT, **options)
    stopped(partial(make, tmp_path / "draft", COUNT), after=1)  # no shard is finished: its sample tells
    with pytest.raises(ConfigError, match=message):
        make(tmp_path / "draft", COUNT, **options)


def test_other_kinds_counts_versions_formats_and_tars_are_refused(copy: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"a data set of 23 samples, asked for 7: choose .*--count 23 resumes"):
        make(copy, 7)
    with pytest.raises(ConfigError, match="kind='garments', asked for kind='bodies'"):
        generate_people(copy, 3)
    shutil.copy(copy / "train-00000.tar", copy / "train-00012.tar")
    with pytest.raises(ConfigError, match=r"train-00012\.tar: not a shard of this data set: move it elsewhere"):
        make(copy, COUNT)
    path = copy / "train-00000.json"
    path.write_text(path.read_text().replace('"generator":"', '"generator":"7.'))
    with pytest.raises(ConfigError, match=r"made by gcd_dataset 7\..*: choose another folder, or install 7\."):
        make(copy, COUNT)
    (tmp_path / "index-train.npz").write_bytes(b"")
    with pytest.raises(ConfigError, match="a data set of an earlier version: choose another folder"):
        make(tmp_path, COUNT)
    with pytest.raises(ShardError, match=r"of schema 2.*reads schema 3 alone"):
        ShardReader(tmp_path)


def test_jobs_and_urls_that_are_none_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for text in ("8/8", "-1/8", "1", "a/b", "1/0"):
        assert main(["generate", str(tmp_path / "out"), "--count", "4", f"--job={text}"]) == 2
        assert "give I/N, such as 0/8" in capsys.readouterr().err
    for out in ("http://server/set", "hf://org/set", "zip://a::http://b", "nothing://bucket"):
        with pytest.raises(ConfigError, match=r"cannot be written to: give a folder, or a URL such as s3://BUCKET/PRE"):
            make(out, COUNT)


def test_each_rejected_attempt_has_a_line_with_its_figures(whole: dict[str, bytes], first: Path) -> None:
    lines = [json.loads(line) for line in whole["rejects.jsonl"].splitlines()]
    assert len(lines) > 2
    assert list(lines[0]) == ["seed", "design", "attempt", "index", "rule", "reason", "figures"]
    attempts = [(line["design"], line["attempt"]) for line in lines]
    assert attempts == sorted(set(attempts))
    for line in lines:
        assert line["index"] // 2 == line["design"]
        assert 0 < line["figures"]["cuff_cm"] < line["figures"]["limb_cm"]
        assert f"a cuff of {line['figures']['cuff_cm']:.1f} cm round a leg of" in line["reason"]
    split = (read_manifest(first) or pytest.fail("no manifest")).splits["train"]
    assert split.rejects == {"tight_cuff": sum(2 if 2 * design + 1 < COUNT else 1 for design, _ in attempts)}
    redraws = Counter[str]()
    for sample in made_once(0, range(COUNT), CUFFED, finished=lambda sample: sample):
        redraws.update(sample.provenance.redraws)
    assert split.redraws == redraws


RENAMES = ("replace", "unlink", "mkdir", "rmdir")
"""The functions of ``os`` between which the files of a data set change."""


@cache
def encoded(index: int) -> dict[str, bytes]:
    return encode_sample(fake_sample(0, index))


def make_fake(folder: Path, count: int) -> None:
    """Make garments with pictures, on two bodies each; every third is a failed drape."""

    def maker(wanted: run.Wanted) -> Iterator[run.Made]:
        for number in (number for _, left in wanted for number in left):
            yield run.Made(number, encoded(number), failed=number % 3 == 1)

    plan = Plan("garments", 0, {"fake": True}, count, 1)
    run.run(Work(Place(folder), plan, {"train": range(count)}, 2), maker)


def killed_at(work: Callable[[], Any], number: int) -> bool:
    """Run ``work`` in a forked process that kills itself before its ``number``-th call of ``RENAMES``."""
    calls = itertools.count()

    def counted(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            if next(calls) == number:
                os.kill(os.getpid(), signal.SIGKILL)
            return function(*arguments, **options)

        return call

    def patched() -> None:
        for name in RENAMES:
            setattr(os, name, counted(getattr(os, name)))
        work()

    return exit_codes(patched) == [-signal.SIGKILL]


@pytest.fixture(scope="module")
def fakes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("whole")
    make_fake(folder, 5)
    return contents(folder)


@pytest.mark.parametrize("every", [3, pytest.param(1, marks=pytest.mark.long)])
def test_a_run_killed_anywhere_goes_on_to_the_same_bytes(every: int, tmp_path: Path, fakes: dict[str, bytes]) -> None:
    """Before every call, or every third one."""
    for number in range(0, 1000, every):
        folder = tmp_path / str(number)
        folder.mkdir()
        was_killed = killed_at(lambda folder=folder: make_fake(folder, 5), number)  # type: ignore[misc]
        make_fake(folder, 5)
        assert contents(folder) == fakes, f"killed before call {number}"
        if not was_killed:
            break
    assert 30 < number < 999
