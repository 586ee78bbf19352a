"""``GarmentDataset`` on a folder of shards: by index and as a stream."""

import tarfile
from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import webdataset as wds
from hypothesis import given
from hypothesis import strategies as st
from torch.utils.data import DataLoader, IterableDataset

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.loaders import FakeGarments, GarmentDataset, collate_list
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.loaders.shards import SplitPart, parse_splits
from gcd_dataset.records import Grade, Outcome, Sample, StoredView
from gcd_dataset.shards import FIELDS
from gcd_dataset.shards.tar import BLOCK
from tests.shards.folders import fill, write_samples

COUNT = 10


def same(a: Any, b: Any) -> bool:
    """Whether two values agree recursively in every element and data type."""
    if isinstance(a, torch.Tensor):
        return isinstance(b, torch.Tensor) and a.dtype == b.dtype and torch.equal(a, b)
    if isinstance(a, Mapping):
        return isinstance(b, Mapping) and a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return bool(a == b)


def assert_all_same(items: Iterable[Any], others: Iterable[Any]) -> None:
    assert all(same(a, b) for a, b in zip(items, others, strict=True))


def test_a_shard_returns_the_written_samples(folder: Path) -> None:
    ds = GarmentDataset(folder)
    assert (len(ds), set(ds[0])) == (COUNT, set(FIELDS))
    assert_all_same([ds[i] for i in range(COUNT)], [FakeGarments(COUNT)[i] for i in range(COUNT)])
    assert ds.recipe(7) == FakeGarments(COUNT).recipe(7)
    assert set(GarmentDataset(folder, fields=("verts", "faces"))[0]) == {"verts", "faces"}
    with pytest.raises(ConfigError, match="no field vertices: there are meta"):
        GarmentDataset(folder, fields=("vertices",))


@pytest.mark.parametrize("indexed", [True, False])
def test_settled_only_and_quality_leave_out_the_others(tmp_path: Path, indexed: bool) -> None:
    """``paper`` includes ``clean``; a garment without a grade has neither."""
    outcomes = [Outcome.NOT_SETTLED, Outcome.SETTLED, None, Outcome.DIVERGED, Outcome.SETTLED, Outcome.SLID_OFF]
    grades = [Grade.PAPER, Grade.CLEAN, None, Grade.FAILED, None, Grade.CLEAN]
    samples = (ended(fake_sample(0, index), outcome) for index, outcome in enumerate(outcomes))
    write_samples(tmp_path, (replace(one, grade=grade) for one, grade in zip(samples, grades, strict=True)))
    if not indexed:
        (tmp_path / "train.index").unlink()
    cases: list[tuple[dict[str, Any], list[int]]] = [
        ({"settled_only": True}, [1, 4]), ({"quality": "clean"}, [1, 5]), ({"quality": "paper"}, [0, 1, 5]),
        ({"settled_only": True, "quality": "paper"}, [1]), ({}, [0, 1, 2, 3, 4, 5]),
    ]  # fmt: skip
    for options, numbers in cases:
        ds, expected = GarmentDataset(tmp_path, **options), [GarmentDataset(tmp_path)[k] for k in numbers]
        assert [ds.recipe(position)["index"] for position in range(len(ds))] == numbers
        assert_all_same([ds[position] for position in range(len(ds))], expected)
        for verify in ("lazy", "off"):
            assert_all_same(GarmentDataset(tmp_path, streaming=True, verify=verify, **options), expected)


def ended(sample: Sample, outcome: Outcome | None) -> Sample:
    assert sample.drape is not None
    return replace(sample, drape=None if outcome is None else replace(sample.drape, outcome=outcome))


def test_a_quality_that_no_garment_has_is_refused(tmp_path: Path) -> None:
    folder = fill(tmp_path, range(2))
    with pytest.raises(ShardError, match="none of the 2 samples of split train has the grade clean: leave out quality"):
        GarmentDataset(folder, quality="clean")
    with pytest.raises(ConfigError, match="quality='good': choose from clean, paper, or None for all"):
        GarmentDataset(folder, quality="good")  # type: ignore[arg-type]


@pytest.mark.parametrize("streaming", [False, True])
def test_an_unfinished_run_is_warned_of_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str], streaming: bool
) -> None:
    options: dict[str, Any] = {"streaming": streaming, "fields": ["meta"]}
    fill(tmp_path, range(3), count=400, recipe=recipe_of(MakeConfig(stage="pattern")))
    ds = GarmentDataset(tmp_path, "train[:1]+train[1:]", **options)
    assert len(list(DataLoader(ds, 2, num_workers=2, collate_fn=collate_list))) == 2
    (message,) = caplog.messages
    command = f"gcd generate {tmp_path} --count 400 --seed 0 --"
    assert message.startswith(f"{tmp_path}: the data set is unfinished: 3 of 400 samples are made: {command}")
    assert "400 samples" not in "".join(capfd.readouterr())  # nor printed by a worker
    GarmentDataset(tmp_path, partial=True, **options)
    assert caplog.messages == [message]


@pytest.mark.parametrize("recipe", [{"fake": True}, {"stage": "mesh"}])
def test_garments_without_a_drape_neither_settle_nor_have_a_grade(tmp_path: Path, recipe: dict[str, Any]) -> None:
    write_samples(tmp_path, [ended(fake_sample(0, 0), None)], recipe=recipe)
    assert len(GarmentDataset(tmp_path)) == 1
    reason = f"they {'end with stage mesh' if 'stage' in recipe else 'have no drapes'}, and only drapes settle and have"
    with pytest.raises(ShardError, match=f"none of the 1 samples of split train has settled: {reason} a grade: leave"):
        GarmentDataset(tmp_path, settled_only=True)
    with pytest.raises(ShardError, match=f"has the grade paper: {reason} a grade: leave out quality, or make garments"):
        GarmentDataset(tmp_path, quality="paper", streaming=True)


def test_options_for_servers_are_refused_for_a_folder(folder: Path) -> None:
    with pytest.raises(ConfigError, match="revision='main' is for repositories of the Hub"):
        GarmentDataset(folder, revision="main")
    with pytest.raises(ConfigError, match="patience is for URLs and the Hub"):
        GarmentDataset(folder, patience=3)


@pytest.fixture(scope="module")
def two_splits(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten garments in ``train``, three different ones in ``test``."""
    place = tmp_path_factory.mktemp("splits")
    for split, indices in (("train", range(COUNT)), ("test", range(20, 23))):
        fill(place, indices, split=split)
    return place


@pytest.mark.parametrize("streaming", [False, True])
@pytest.mark.parametrize(
    ("split", "expected"),
    [
        ("train", range(10)),
        ("train[:10%]", [0]),
        ("train[3:5]", [3, 4]),
        ("train[-2:]", [8, 9]),
        ("train[50%:]+test", [5, 6, 7, 8, 9, 20, 21, 22]),
        ("test[1:] + train[:2]", [21, 22, 0, 1]),
        ("train[90:]+test[:1]", [20]),
    ],
)
def test_a_split_may_be_sliced_and_added(two_splits: Path, split: str, expected: list[int], streaming: bool) -> None:
    garments = GarmentDataset(two_splits, split, fields=["meta"], streaming=streaming)
    assert [item["meta"]["index"] for item in garments] == list(expected)


@pytest.mark.parametrize(
    "split",
    [
        *("train[", "train[1]", "train[:1:2]", "train++test", "train[:200%]", "", "../train"),
        *(f"train[:{5000 * '9'}]", f"train[-{20 * '9'}%:]", 3, None, ["train"]),
    ],
)
def test_the_error_for_an_invalid_split_is_one_short_line(split: Any) -> None:
    with pytest.raises(ConfigError, match=r"write train, |give -100%") as raised:
        parse_splits(split)
    assert len(str(raised.value)) < 200


@given(st.integers(0, 10_000), st.lists(st.integers(0, 100), max_size=5))
def test_adjacent_slices_cover_the_split_once(count: int, cuts: list[int]) -> None:
    ends = [0, *sorted(cuts), 100]
    parts = [SplitPart("train", f"{a}%", f"{b}%").range_of(count) for a, b in pairwise(ends)]
    assert [position for part in parts for position in part] == list(range(count))


def test_slices_and_selections_are_data_sets(two_splits: Path) -> None:
    ds = GarmentDataset(two_splits, fields=["meta", "verts"])
    assert_all_same(ds[2:6], [ds[i] for i in range(2, 6)])
    assert_all_same(ds[::-3], [ds[9], ds[6], ds[3], ds[0]])
    some = ds.select([7, 0, -1])
    assert (len(some), some.fields) == (3, ds.fields)
    assert_all_same(some[1:], [ds[0], ds[9]])
    assert some.recipe(0) == ds.recipe(7)
    some.verify(2)
    assert_all_same(DataLoader(some, batch_size=None), [ds[7], ds[0], ds[9]])
    assert_all_same(FakeGarments(5)[3:], [FakeGarments(5)[3], FakeGarments(5)[4]])


def test_a_stream_holds_the_same_garments(folder: Path) -> None:
    stream = GarmentDataset(folder, streaming=True)
    assert isinstance(stream, IterableDataset)
    ds = GarmentDataset(folder)
    for _ in range(2):  # two epochs
        assert_all_same(stream, [ds[i] for i in range(COUNT)])
    assert (len(stream), stream.recipe(7)) == (COUNT, ds.recipe(7))
    for wrong in (lambda: stream[0], lambda: stream.select([0]), lambda: stream[1:]):
        with pytest.raises(ConfigError, match="a stream has no indices: leave out streaming=True"):
            wrong()


def test_pictures_come_from_their_own_tars(tmp_path: Path) -> None:
    samples = [fake_sample(0, index) for index in range(6)]
    facts = {"camera": {"k": np.eye(3).tolist(), "rt": np.eye(4)[:3].tolist()}}
    views = [StoredView(sample.back or b"", facts) for sample in samples]
    write_samples(
        tmp_path, (replace(one, views=(view,), caption=one.key) for one, view in zip(samples, views, strict=True))
    )
    for fields in (["front"], ["verts", "view_0_json", "caption"], ["view_0"], ["views", "camera_k"], None):
        ds = GarmentDataset(tmp_path, "train[2:]", fields)
        assert_all_same(GarmentDataset(tmp_path, "train[2:]", fields, streaming=True), [ds[i] for i in range(4)])
    (tmp_path / "views" / "train-00001.tar").unlink()
    assert len(list(GarmentDataset(tmp_path, fields=["verts"], streaming=True))) == 6
    with pytest.raises(ShardError, match=r"views/train-00001\.tar: no such file, but manifest\.json lists it"):
        list(GarmentDataset(tmp_path, fields=["front"], streaming=True))


def test_damage_in_a_stream_is_named(tmp_path: Path) -> None:
    shard = fill(tmp_path, range(3)) / "train-00000.tar"
    with tarfile.open(shard) as tar:
        entry = tar.getmember("gcd_000000001.verts.z")
    content = shard.read_bytes()
    faults = (
        (entry.offset_data + 100, r": sample gcd_000000001, member verts\.z: bytes differ from the written ones: copy"),
        (entry.offset + 5, r": sample gcd_000000001: damaged \(no tar header at byte \d+\): copy"),
    )
    for place, fault in faults:
        shard.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        with pytest.raises(ShardError, match=rf"train-00000\.tar{fault}"):
            list(GarmentDataset(tmp_path, fields=["verts"], streaming=True))
    stream = GarmentDataset(tmp_path, fields=["meta"], streaming=True)
    half = len(content) // 2
    for broken in (b"\1" + content[1:], content[:half], content[: half // BLOCK * BLOCK], b""):
        shard.write_bytes(broken)
        with pytest.raises(ShardError, match=r"train-00000\.tar: .*: copy"):
            list(stream)


@pytest.mark.parametrize("name", ["thing-000000.tar", "train-00000.tar", "train.tar"])
@pytest.mark.parametrize("streaming", [False, True])
def test_tars_of_other_programs_are_left_to_webdataset(tmp_path: Path, name: str, streaming: bool) -> None:
    with wds.TarWriter(str(tmp_path / name)) as writer:
        writer.write({"__key__": "a1", "txt": "hi", "json": {"a": 1}})
    with pytest.raises(ShardError, match=rf"^{tmp_path}/?: tars of another program: read them with webdataset"):
        GarmentDataset(tmp_path, streaming=streaming)
