"""Fields, types and indices of items of every data set, and their error messages."""

import importlib
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn
from torch.utils.data import DataLoader, Dataset

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.loaders import (
    Augmented,
    BodyDataset,
    Chain,
    FakeGarments,
    FreshGarments,
    GarmentDataset,
    Garments,
    GeneratedGarments,
    Hdf5Garments,
    MixedDataset,
    PickCaption,
    PublishedBodies,
    PublishedGarmentCodeData,
    Yaw,
    collate_list,
    collate_packed,
    collate_padded,
)
from gcd_dataset.loaders.base import tensor_of
from gcd_dataset.shards import FIELDS, ShardReader
from gcd_dataset.shards.hdf5 import write_hdf5
from tests.loaders.test_shards import assert_all_same, same
from tests.release.published import publish as published
from tests.shards.folders import fill, write_samples
from tests.shards.people import fill as people_in_shards

COUNT = 4
FIRST = 3  # number of the first stored sample, so that keys differ from positions
PATTERN = ("meta", "spec", "design", "measures", "panels", "edges", "stitches", "closures", "lines", "body")
DRAPED = ("verts", "front", "back")


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Stage to a folder of generated garments of that stage."""
    folders = {}
    for stage in ("pattern", "mesh"):
        folders[stage] = tmp_path_factory.mktemp(stage)
        config = MakeConfig(stage=stage, resolution=6.0, points=512)
        samples = produce(2, range(FIRST, FIRST + COUNT), config)
        write_samples(folders[stage], samples, seed=2, recipe=recipe_of(config), shard_size=2)
        list(write_hdf5(ShardReader(folders[stage]), folders[stage] / "train.h5"))
    return folders


def opened(sets: dict[str, Path], stage: Any) -> dict[str, Callable[..., Any]]:
    """The same garments, opened by each data set class."""
    folder = sets[stage]
    return {
        "folder": lambda **options: GarmentDataset(folder, **options),
        "stream": lambda **options: GarmentDataset(folder, streaming=True, **options),
        "hdf5": lambda **options: Hdf5Garments(folder / "train.h5", **options),
        "generated": lambda **options: GeneratedGarments(COUNT, stage=stage, resolution=6.0, **options),
    }


WAYS = ("folder", "stream", "hdf5", "generated")


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    ("stage", "field"), [("pattern", "points"), ("pattern", "faces"), ("mesh", "verts"), ("mesh", "front")]
)
def test_a_field_of_a_later_stage_is_refused_at_once(sets: dict[str, Path], way: str, stage: str, field: str) -> None:
    """Otherwise a training would run on empty arrays."""
    later = "drape" if field in DRAPED else "mesh"
    reason = f"these garments end with stage {stage}, and {field} comes? with stage {later}"
    message = f"no field {field}: {reason}: choose among"
    with pytest.raises(ConfigError, match=message):
        opened(sets, stage)[way](fields=["panels", field])
    with pytest.raises(ConfigError, match="no field vertz: there are ") as unknown:
        opened(sets, stage)[way](fields=["vertz"])
    assert field not in re.findall(r"\w+", str(unknown.value))


@pytest.mark.parametrize("way", WAYS)
def test_all_fields_means_all_that_the_garments_hold(sets: dict[str, Path], way: str) -> None:
    assert opened(sets, "pattern")[way]().fields == PATTERN
    mesh = opened(sets, "mesh")[way]()
    assert set(mesh.fields) == set(FIELDS) - set(DRAPED)
    item = next(iter(mesh))
    assert all(len(item[f]) for f in mesh.fields if isinstance(item[f], torch.Tensor) and f != "lines")


def test_pictures_that_are_not_rendered_are_refused() -> None:
    with pytest.raises(ConfigError, match="no field front: these garments have no pictures"):
        GeneratedGarments(1, picture=0, fields=["front", "verts"])
    assert set(GeneratedGarments(1, picture=0).fields) == set(FIELDS) - {"front", "back"}


def test_published_garments_have_no_body_field(examples: Path) -> None:
    """Reference patterns in the published layout, draped by another solver."""
    root = examples / "published" / "GarmentCodeData_v2"
    with pytest.raises(ConfigError, match="no field body: these garments have no shape weights"):
        PublishedGarmentCodeData(root, "all", fields=["body"])
    ds = PublishedGarmentCodeData(root, "all", fields=["measures", "meta"])
    assert ds[0]["measures"]["_leg_length"] == pytest.approx(85.0, abs=10)
    assert same(ds[ds.names[1]], ds[1])
    assert same(ds[ds[1]["meta"]["key"]], ds[1])


@pytest.mark.parametrize("way", WAYS)
def test_floating_fields_are_float32_by_default(sets: dict[str, Path], way: str) -> None:
    fields = ("panels", "edges", "points", "box", "uv", "body")
    item = next(iter(opened(sets, "mesh")[way](fields=fields)))
    for field in fields:
        assert nn.Linear(item[field].shape[-1], 2)(item[field]).dtype == torch.float32
    stored = next(iter(opened(sets, "mesh")[way](fields=fields, dtype=None)))
    assert {stored["panels"].dtype, stored["edges"].dtype} == {torch.float64}
    half = next(iter(opened(sets, "mesh")[way](fields=(*fields, "faces"), dtype=torch.bfloat16)))
    assert {half[field].dtype for field in fields} == {torch.bfloat16}
    assert half["faces"].dtype == torch.int32
    for field in fields:
        assert torch.equal(item[field], stored[field].float())
        assert torch.equal(half[field], stored[field].to(torch.bfloat16))


def test_types_that_are_not_floating_and_batches_of_several_types_are_refused(sets: dict[str, Path]) -> None:
    for dtype in (torch.int64, "float32", np.float32):
        with pytest.raises(ConfigError, match=r"dtype=.*: give a floating type, such as torch\.float32"):
            GarmentDataset(sets["mesh"], dtype=dtype)  # type: ignore[arg-type]
    items = [GarmentDataset(sets["mesh"], fields=["panels", "body"], dtype=dtype)[0] for dtype in (torch.float32, None)]
    for collate in (collate_packed, collate_padded):
        with pytest.raises(ConfigError, match=r"panels has types torch\.float32, torch\.float64 in one batch"):
            collate(items)


def wrapped(ds: Garments, count: int = COUNT) -> list[Garments]:
    return [ds, Augmented(ds, Yaw(0.0)), ds.select(range(count)), ds[:]]


class OneOfEach(Dataset):
    """The second item of each data set, and whether Warp is initialised: with a GPU that takes a CUDA context."""

    def __init__(self, *kinds: Any) -> None:
        self.kinds = kinds

    def __len__(self) -> int:
        return len(self.kinds)

    def __getitem__(self, index: int) -> Any:
        return self.kinds[index][1], importlib.import_module("warp._src.context").runtime is not None


def test_a_spawned_worker_gets_the_same_from_every_kind_of_data_set_and_reading_initialises_no_warp(
    sets: dict[str, Path], few: Path, tmp_path: Path
) -> None:
    made = opened(sets, "mesh")["generated"]()  # last: panels are filled by a kernel
    stored = [*(opened(sets, "mesh")[way]() for way in ("folder", "hdf5")), opened(sets, "pattern")["generated"]()]
    fake = FakeGarments(2)
    people = [PublishedBodies(few), BodyDataset(people_in_shards(tmp_path / "people", range(2)))]
    kinds = OneOfEach(
        *stored,
        *people,
        *wrapped(fake, 2),
        MixedDataset([fake], [1]),
        PublishedGarmentCodeData(published(tmp_path)),
        made,
    )
    loader = DataLoader(kinds, batch_size=1, num_workers=1, multiprocessing_context="spawn", collate_fn=collate_list)
    items, initialised = zip(*(entry for [entry] in loader), strict=True)
    assert_all_same(items, [kind[1] for kind in kinds.kinds])
    assert not any(initialised[:-1])


@pytest.mark.parametrize("way", ["folder", "hdf5", "generated"])
def test_a_list_of_indices_gives_a_list_of_items(sets: dict[str, Path], way: str) -> None:
    whole = opened(sets, "pattern")[way](fields=["meta", "panels"])
    for ds in [whole] if way == "generated" else wrapped(whole):
        several = [ds[1], ds[-1], ds[1]]
        for indices in ([1, -1, 1], (1, -1, 1), np.array([1, -1, 1]), torch.tensor([1, -1, 1], dtype=torch.int16)):
            assert_all_same(ds[indices], several)
        assert ds[[]] == []
        assert same(ds[np.int32(2)], ds[2])
        assert same(ds[torch.tensor(2)], ds[2])
        assert_all_same(ds[1:3], [ds[1], ds[2]])
        for beyond in (COUNT, [0, COUNT], -COUNT - 1):
            with pytest.raises(IndexError, match=f"of {COUNT}: give -{COUNT} to {COUNT - 1}"):
                ds[beyond]


def test_values_that_are_no_index_are_refused(sets: dict[str, Path]) -> None:
    ds: Any = GarmentDataset(sets["pattern"], fields=["meta"])
    mixed: Any = MixedDataset([ds], [1])
    for index in (True, np.bool_(True), torch.tensor(True), 1.0, None, [True, False], ds):
        for garments in (ds, mixed, ds.select([0])):
            with pytest.raises(TypeError, match="give a whole number"):
                garments[index]
    with pytest.raises(ConfigError, match=r"int64 of shape .* give whole numbers in one row"):
        ds[np.eye(2, dtype=int)]


@pytest.mark.parametrize("way", ["folder", "hdf5"])
def test_garments_are_found_by_key(sets: dict[str, Path], way: str) -> None:
    for ds in wrapped(opened(sets, "pattern")[way](fields=["meta"])):
        keys = [item["meta"]["key"] for item in ds]
        assert keys == [f"gcd_{FIRST + number:09d}" for number in range(COUNT)]
        assert [ds[key]["meta"]["key"] for key in keys] == keys
        assert [item["meta"]["key"] for item in ds[keys[::-1]]] == keys[::-1]
        assert ds.recipe(keys[2])["index"] == FIRST + 2
        with pytest.raises(KeyError) as missing:
            ds["gcd_5"]
        assert str(missing.value) == (
            "no garment 'gcd_5': did you mean gcd_000000005? keys are gcd_000000003 to gcd_000000006"
        )
        with pytest.raises(ConfigError, match="keys are gcd_000000003 to"):
            ds["gcd_000000000"]


def test_generated_garments_are_found_by_key() -> None:
    ds = GeneratedGarments(10**9, stage="pattern", fields=["meta"])
    assert ds["gcd_000000002"]["meta"]["index"] == 2
    for key in ("gcd_1000000000", "gcd_12", "2", ""):
        with pytest.raises(KeyError, match="keys are gcd_000000000 to gcd_999999999"):
            ds[key]


def test_a_key_in_two_splits_is_refused(tmp_path: Path) -> None:
    for split in ("train", "test"):
        fill(tmp_path, range(2), split=split)
    both = GarmentDataset(tmp_path, "train+test", fields=["meta"])
    with pytest.raises(KeyError, match="gcd_000000001 is in train and in test: open one split"):
        both["gcd_000000001"]
    again = GarmentDataset(tmp_path, "train[1:]+train", fields=["meta"])
    assert same(again["gcd_000000001"], again[0])
    with pytest.raises(KeyError, match="a mix has no keys"):
        MixedDataset([both], [1])["gcd_000000001"]


def test_a_field_that_is_not_loaded_is_named(sets: dict[str, Path]) -> None:
    ds = GarmentDataset(sets["mesh"], fields=["panels", "body"])
    message = "the {} has no 'points': it holds panels, .*body.*: .*fields="
    with pytest.raises(KeyError, match=message.format("garment").replace(": .*", "; ")):
        ds[0]["points"]
    with pytest.raises(KeyError, match="the batch has no 'points'"):
        collate_packed([ds[0]])["points"]


@pytest.mark.parametrize("workers", [0, 1])
def test_the_error_of_default_collate_names_collate_packed(sets: dict[str, Path], workers: int) -> None:
    for transform in (None, lambda item: {**item}):
        ds = GarmentDataset(sets["mesh"], fields=["body", "box"], transform=transform)
        with pytest.raises(ConfigError, match=r"box differs in size or kind .* collate_fn=collate_packed"):
            next(iter(DataLoader(ds, batch_size=2, num_workers=workers)))
    stacked = next(iter(DataLoader(GarmentDataset(sets["mesh"], fields=["body", "points"]), batch_size=2)))
    assert stacked["points"].shape == (2, 512, 6)


def test_a_transform_that_is_no_function_is_refused(sets: dict[str, Path]) -> None:
    makers: list[Callable[[], Any]] = [
        lambda: GarmentDataset(sets["mesh"], transform=3),  # type: ignore[arg-type]
        lambda: GeneratedGarments(1, transform="yaw"),  # type: ignore[arg-type]
        lambda: FreshGarments(FakeGarments(1), augment=3),  # type: ignore[arg-type]
        lambda: Augmented(FakeGarments(1), 3),  # type: ignore[arg-type]
    ]
    for make in makers:
        with pytest.raises(ConfigError, match=r"(transform|augment)=.*: give a function of item"):
            make()


@pytest.mark.parametrize("transform", [Yaw(), Chain(Yaw()), PickCaption(), lambda item, rng: item])
def test_a_transform_that_needs_a_random_stream_is_refused_at_once(few: Path, transform: Any) -> None:
    makers: list[Callable[..., Any]] = [
        FakeGarments,
        partial(GeneratedGarments, drape=None),
        lambda n, **options: MixedDataset([FakeGarments(n)], [1], **options),
        lambda n, **options: PublishedBodies(few, **options),
    ]
    for make in makers:
        with pytest.raises(ConfigError, match=r"transform=.* with \(item\): give it to Augmented\(dataset, augment\)"):
            make(1, transform=transform)


def test_select_takes_any_iterable_of_indices_and_refuses_others_in_one_sentence() -> None:
    ds: Any = FakeGarments(4, fields=["meta"])
    for indices in ([1, 3], (1, 3), np.array([1, 3]), torch.tensor([1, -1]), iter([1, 3]), range(1, 4, 2)):
        assert [item["meta"]["index"] for item in ds.select(indices)] == [1, 3]
    several = r"select\(.*give indices or keys in a list, .* select by a condition with"
    none: list[Any] = [lambda item: True, "gcd_000000003", 1, 1.5, None, slice(2), torch.tensor(1), {}]
    for one in none:
        with pytest.raises(ConfigError, match=several):
            ds.select(one)
    for wrong in ([True] * 4, np.ones(3, bool), torch.ones(4, dtype=torch.bool), [4], [-5], [0.5], ["gcd_000000009"]):
        with pytest.raises(ConfigError, match=r"^[^\n]+: [^\n]+$"):
            ds.select(wrong)


def test_the_sample_of_a_garment_is_whole_whatever_the_fields(sets: dict[str, Path], tmp_path: Path) -> None:
    expected = ShardReader(sets["mesh"]).sample(1)
    options: dict[str, Any] = {"fields": ["panels"], "stage": "mesh", "resolution": 6.0, "points": 512}
    ds = GarmentDataset(sets["mesh"], fields=["panels"])
    assert ds.sample(1 - COUNT) == expected
    ways: list[Garments] = [
        *(ds, ds.select([2, 1]), Augmented(ds, Yaw())[1:], GarmentDataset(sets["mesh"], streaming=True)),
        Hdf5Garments(sets["mesh"] / "train.h5", fields=["panels"]),
        *2 * [GeneratedGarments(FIRST + 2, 2, cache_dir=tmp_path, **options)],
    ]
    assert [garments.sample(expected.key) for garments in ways] == len(ways) * [expected]
    assert MixedDataset([ds[1:2]], [1]).sample(0) == expected
    assert FakeGarments(2, fields=["meta"]).sample(1).drape is not None


def test_a_design_overlay_may_be_a_dict() -> None:
    wanted = {"meta": {"upper": "none", "bottom": "Pants"}}
    ds = GeneratedGarments(2, stage="pattern", design=wanted, fields=["design"])
    assert [item["design"]["meta"]["bottom"] for item in ds] == ["Pants", "Pants"]
    assert ds.recipe(0)["recipe"]["design"]["meta"]["bottom"] == {"options": ["Pants"]}
    with pytest.raises(ConfigError, match=r"called meta\.botom: did you mean meta\.bottom\?"):
        GeneratedGarments(2, design={"meta": {"botom": "Pants"}})
    for design in (3, "pants.toml"):
        with pytest.raises(ConfigError, match=r"design=.*: give a dict such as .*, or read_overlay"):
            GeneratedGarments(2, design=design)  # type: ignore[arg-type]


def test_a_number_beyond_float32_is_refused() -> None:
    large = np.array([1.0, 1e300])
    with pytest.raises(ShardError, match="dtype=None keeps the stored type"):
        tensor_of(large, torch.float32)
    assert tensor_of(large, None).tolist() == [1.0, 1e300]


def test_a_tilde_is_the_home_folder(
    sets: dict[str, Path], few: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").symlink_to(sets["pattern"])
    people_in_shards(tmp_path / "people", range(2))
    published(tmp_path / "release")
    assert len(GarmentDataset("~/data")) == len(GarmentDataset(Path("~/data"))) == COUNT
    assert len(Hdf5Garments("~/data/train.h5")) == COUNT
    assert len(BodyDataset("~/people")) == len(PublishedBodies(f"~/{few.name}")) == 2
    assert len(PublishedGarmentCodeData("~/release", cache_dir="~/kept")) == 4
    assert not Path("~").exists()
