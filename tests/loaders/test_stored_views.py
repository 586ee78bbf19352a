"""Views in shards: one field for all of them, sizes, caches, downloads and other readers."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import datasets
import numpy as np
import pytest
import torch
from PIL import Image

from gcd_dataset import generate
from gcd_dataset.cli import main
from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.generator.drawing import jpeg_bytes, sample_sheet
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.generator.views import MISSING_VIEW
from gcd_dataset.loaders import GarmentDataset, GeneratedGarments
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import Sample, StoredView
from tests.shards.folders import write_samples


def facts(number: int) -> dict[str, Any]:
    camera = {**MISSING_VIEW.facts["camera"], "k": (number * np.eye(3)).tolist(), "rt": np.full((3, 4), 0.5).tolist()}
    return {**MISSING_VIEW.facts, "camera": camera}


def jpeg(shade: int, size: int = 16) -> bytes:
    return jpeg_bytes(np.full((size, size, 3), shade, np.uint8))


def viewed(index: int, sizes: tuple[int, ...] = (16, 16)) -> Sample:
    views = (StoredView(jpeg(40 * index + 20 * number, size), facts(number + 1)) for number, size in enumerate(sizes))
    return replace(fake_sample(0, index), views=tuple(views))


@pytest.mark.parametrize("streaming", [False, True])
def test_all_views_are_one_field(tmp_path: Path, streaming: bool) -> None:
    folder = write_samples(tmp_path, [viewed(index) for index in range(3)])
    ds = GarmentDataset(folder, fields=["camera_rt", "views", "camera_k"], streaming=streaming)
    assert ds.fields == ("views", "camera_k", "camera_rt")
    for index, item in enumerate(ds):
        assert item["views"].shape == (2, 16, 16, 3)
        assert item["views"].dtype == torch.uint8
        assert item["views"][:, 8, 8, 0].tolist() == pytest.approx([40 * index, 40 * index + 20], abs=1)
        assert torch.equal(item["camera_k"], torch.stack([torch.eye(3), 2 * torch.eye(3)]))
        assert item["camera_rt"].tolist() == torch.full((2, 3, 4), 0.5).tolist()
    assert {"view_0", "view_1_json"} <= set(GarmentDataset(folder).fields)
    assert "views" not in GarmentDataset(folder).fields
    if not streaming:
        assert torch.equal(ds[1:][0]["views"], ds[1]["views"])


def test_views_that_are_no_array_are_reported(tmp_path: Path) -> None:
    folder = write_samples(tmp_path / "sizes", [viewed(0, (16, 24))])
    with pytest.raises(ShardError, match="views have the sizes 16 x 16, 24 x 24, and one array needs equal sizes"):
        GarmentDataset(folder, fields=["views"])[0]
    item: Any = GarmentDataset(folder, fields=["view_1"])[0]
    assert item["view_1"].shape == (3, 24, 24)
    sample = replace(fake_sample(0, 0), views=(StoredView(jpeg(1), {"fov": 40.0}),))
    with pytest.raises(ShardError, match=r"sample gcd_000000000.*view_0\.json: no camera matrix k"):
        GarmentDataset(write_samples(tmp_path / "camera", [sample]), fields=["camera_k"])[0]
    with pytest.raises(ConfigError, match="no field views"):
        GarmentDataset(write_samples(tmp_path / "none", [fake_sample(0, 0)]), fields=["views"])


def test_options_of_views_leave_other_recipes_alone() -> None:
    assert recipe_of(MakeConfig(view_size=64)) == recipe_of(MakeConfig())
    assert not {"views", "view_size"} & recipe_of(MakeConfig()).keys()
    asked = recipe_of(MakeConfig(views=2, view_size=64))
    assert (asked["views"], asked["view_size"]) == (2, 64)
    with pytest.raises(ConfigError, match="views is 2, but stage mesh drapes nothing"):
        MakeConfig(views=2, stage="mesh")


def test_datasets_reads_views_behind_diverged_drapes(tmp_path: Path) -> None:
    """It infers types from the first five samples."""
    lost = [replace(fake_sample(0, index), views=(MISSING_VIEW,)) for index in range(5)]
    folder = write_samples(tmp_path / "data", [*lost, viewed(5, (16,))], shard_size=6)
    options = {"data_files": {"train": str(folder / "views" / "train-00000.tar")}, "split": "train"}
    rows = list(datasets.load_dataset("webdataset", cache_dir=str(tmp_path / "cache"), **options))
    assert rows[5]["view_0.json"]["camera"]["k"] == np.eye(3).tolist()
    assert rows[5]["view_0.jpg"].size == (16, 16)


def test_a_sheet_shows_the_views_below_the_sample() -> None:
    plain, sheet = sample_sheet(fake_sample(0, 1), size=32), sample_sheet(viewed(1), size=32)
    assert sheet.shape == (plain.shape[0] + 32 + 6, *plain.shape[1:])
    assert np.array_equal(sheet[: len(plain)], plain)
    assert np.abs(sheet[-16, [16, 16 + 32 + 6], 0].astype(int) - [40, 60]).max() <= 1


def test_generated_views_are_stored_cached_and_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options: dict[str, Any] = {"resolution": 8.0, "picture": 16, "views": 2, "view_size": 24, "device": "cpu"}
    folder, sheet = tmp_path / "data", tmp_path / "sheet.png"
    generate(folder, 1, seed=5, config=MakeConfig(**options))
    stored = GarmentDataset(folder, fields=["views", "camera_k"])[0]
    assert stored["views"].shape == (2, 24, 24, 3)
    for _ in range(2):  # made, then cached
        ds = GeneratedGarments(1, seed=5, fields=["views", "camera_k"], cache_dir=tmp_path / "cache", **options)
        assert torch.equal(ds[0]["views"], stored["views"])
        assert torch.equal(ds[0]["camera_k"], stored["camera_k"])
    assert main(["info", str(folder)]) == 0
    assert "views: 2 of each garment, 24 x 24 pixels" in capsys.readouterr().out
    assert main(["show", str(folder), "--png", str(sheet)]) == 0
    with Image.open(sheet) as picture:
        assert picture.height > 512
    assert main(["verify", str(folder), "--full"]) == 0
