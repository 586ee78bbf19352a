"""``GarmentDataset`` on a folder of shards: by index and as a stream."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.loaders import FakeGarments, GarmentDataset, collate_list
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import Grade, Outcome, Sample
from gcd_dataset.shards import FIELDS, ShardReader, ShardWriter
from gcd_dataset.shards.reader import Quality
from tests.shards.folders import RECIPE, fill, forbidden, open_writer, public_folder

COUNT = 10


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fill(tmp_path_factory.mktemp("data"), range(COUNT))


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
    assert len(ds) == COUNT
    assert_all_same([ds[i] for i in range(COUNT)], [FakeGarments(COUNT)[i] for i in range(COUNT)])


def test_random_access_equals_reading_in_order(folder: Path) -> None:
    in_order = [GarmentDataset(folder)[i] for i in range(COUNT)]
    ds = GarmentDataset(folder)
    for i in np.random.default_rng(0).permutation(COUNT):
        assert same(ds[i], in_order[i])


def test_an_item_holds_the_selected_fields_only(folder: Path) -> None:
    ds = GarmentDataset(folder, fields=("verts", "faces"))
    assert set(ds[0]) == {"verts", "faces"}
    assert ds[0]["verts"].dtype == torch.float32
    assert ds[0]["faces"].dtype == torch.int32
    with pytest.raises(ConfigError, match="no field vertices: there are meta"):
        GarmentDataset(folder, fields=("vertices",))


def test_indices_count_from_both_ends(folder: Path) -> None:
    ds = GarmentDataset(folder, fields=["meta"])
    assert ds[-1]["meta"]["index"] == COUNT - 1
    for beyond in (COUNT, -COUNT - 1):
        with pytest.raises(IndexError):
            ds[beyond]


def test_a_transform_sees_every_item(folder: Path) -> None:
    ds: Any = GarmentDataset(folder, fields=["verts"], transform=lambda item: len(item["verts"]))
    assert ds[3] == len(FakeGarments(COUNT)[3]["verts"])


def test_the_recipe_suffices_to_make_the_garment_again(folder: Path) -> None:
    recipe = GarmentDataset(folder).recipe(7)
    assert (recipe["seed"], recipe["index"], recipe["recipe"]) == (0, 7, RECIPE)
    assert recipe == FakeGarments(COUNT).recipe(7)
    assert same(FakeGarments(COUNT, seed=recipe["seed"])[recipe["index"]], GarmentDataset(folder)[7])


def test_an_unreadable_folder_is_named() -> None:
    message = r"data: cannot be read \(Permission denied\)"
    with public_folder() as place:
        folder = fill(place / "data", range(3))
        for streaming in (False, True):
            with forbidden(place, 0), pytest.raises(ShardError, match=message):
                GarmentDataset(folder, streaming=streaming)


@pytest.mark.parametrize("indexed", [True, False])
def test_settled_only_leaves_out_the_others(tmp_path: Path, indexed: bool) -> None:
    outcomes = [Outcome.NOT_SETTLED, Outcome.SETTLED, None, Outcome.DIVERGED, Outcome.SETTLED, Outcome.SLID_OFF]
    with open_writer(tmp_path) as writer:
        for index, outcome in enumerate(outcomes):
            writer.write(ended(fake_sample(0, index), outcome))
    if not indexed:
        (tmp_path / "train.index").unlink()
    ds = GarmentDataset(tmp_path, settled_only=True)
    assert (len(ds), ds.recipe(1)["index"]) == (2, 4)
    assert_all_same([ds[0], ds[-1]], [GarmentDataset(tmp_path)[i] for i in (1, 4)])
    for verify in ("lazy", "off"):
        assert_all_same(GarmentDataset(tmp_path, settled_only=True, streaming=True, verify=verify), [ds[0], ds[1]])


def ended(sample: Sample, outcome: Outcome | None) -> Sample:
    assert sample.drape is not None
    return replace(sample, drape=None if outcome is None else replace(sample.drape, outcome=outcome))


@pytest.mark.parametrize("indexed", [True, False])
def test_quality_leaves_out_lower_grades(tmp_path: Path, indexed: bool) -> None:
    """``paper`` includes ``clean``; a garment without a grade has neither."""
    grades = [Grade.PAPER, Grade.CLEAN, None, Grade.FAILED, Grade.CLEAN]
    with open_writer(tmp_path) as writer:
        for index, grade in enumerate(grades):
            writer.write(replace(fake_sample(0, index), grade=grade))
    if not indexed:
        (tmp_path / "train.index").unlink()
    cases: list[tuple[Quality | None, list[int]]] = [("clean", [1, 4]), ("paper", [0, 1, 4]), (None, [0, 1, 2, 3, 4])]
    for quality, expected in cases:
        ds = GarmentDataset(tmp_path, quality=quality)
        assert [meta["index"] for meta in (ds[i]["meta"] for i in range(len(ds)))] == expected
        streamed = GarmentDataset(tmp_path, quality=quality, streaming=True)
        assert [item["meta"]["index"] for item in streamed] == expected


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
    with ShardWriter(tmp_path, seed=0, recipe=RECIPE, count=400) as writer:
        for index in range(3):
            writer.write(fake_sample(0, index))
    ds = GarmentDataset(tmp_path, "train[:1]+train[1:]", **options)
    assert len(list(DataLoader(ds, 2, num_workers=2, collate_fn=collate_list))) == 2
    (message,) = caplog.messages
    assert message.startswith(f"{tmp_path}: the data set is unfinished: 3 of 400 samples are made: ")
    assert "400 samples" not in "".join(capfd.readouterr())  # nor printed by a worker
    GarmentDataset(tmp_path, partial=True, **options)
    assert caplog.messages == [message]


@pytest.mark.parametrize("recipe", [{"fake": True}, {"stage": "mesh"}])
def test_garments_without_a_drape_neither_settle_nor_have_a_grade(tmp_path: Path, recipe: dict[str, Any]) -> None:
    with ShardWriter(tmp_path, seed=0, recipe=recipe) as writer:
        writer.write(ended(fake_sample(0, 0), None))
    assert len(GarmentDataset(tmp_path)) == 1
    reason = f"they {'end with stage mesh' if 'stage' in recipe else 'have no drapes'}, and only drapes settle and have"
    with pytest.raises(ShardError, match=f"none of the 1 samples of split train has settled: {reason} a grade: leave"):
        GarmentDataset(tmp_path, settled_only=True)
    with pytest.raises(ShardError, match=f"has the grade paper: {reason} a grade: leave out quality, or make garments"):
        GarmentDataset(tmp_path, quality="paper", streaming=True)


def test_verify_finds_a_flipped_bit(tmp_path: Path) -> None:
    ds = GarmentDataset(fill(tmp_path, range(3)), verify="off")
    ds.verify(1)
    shard = tmp_path / "train-00000.tar"
    content = bytearray(shard.read_bytes())
    content[int(ShardReader(tmp_path).index.start[1]) + 517] ^= 1
    shard.write_bytes(content)
    ds.verify(0)
    with pytest.raises(ShardError, match=r"gcd_000000001, member meta\.json"):
        ds.verify(1)


def test_options_for_servers_are_refused_for_a_folder(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="revision='main' is for repositories of the Hub"):
        GarmentDataset(folder, revision="main")
    with pytest.raises(ConfigError, match="patience is for URLs and the Hub"):
        GarmentDataset(folder, patience=3)
    with pytest.raises(ConfigError, match="nowhere: no such folder, and neither a URL nor a repository"):
        GarmentDataset(tmp_path / "nowhere")


def test_collate_list_leaves_items_unchanged() -> None:
    ds = FakeGarments(3)
    (batch,) = DataLoader(ds, batch_size=3, collate_fn=collate_list)
    assert_all_same(batch, [ds[i] for i in range(3)])
    assert set(batch[0]) == set(FIELDS)
