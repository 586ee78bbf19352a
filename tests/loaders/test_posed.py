"""Items of garments on bodies in a pose: the pose as rotations of bones, and the wearer in it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.generator.body import named_pose
from gcd_dataset.generator.views import stored_body
from gcd_dataset.loaders import VIEW_FIELDS, GarmentDataset, GeneratedGarments, collate_packed
from gcd_dataset.loaders.scenes import StoredGarment, wearer_of
from gcd_dataset.records import BONES, Sample
from gcd_dataset.shards.codec import encode_sample
from gcd_dataset.shards.meta import read_meta, sealed
from tests.loaders.rendered import CONFIG, write


@pytest.fixture(scope="module")
def posed(worn: list[Sample]) -> list[Sample]:
    poses = [named_pose("t-pose"), named_pose("stride")]
    return [
        replace(sample, shape=sample.shape and replace(sample.shape, pose=pose))
        for sample, pose in zip(worn, poses, strict=False)
    ]


@pytest.fixture(scope="module")
def folder(posed: list[Sample], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("posed"), posed, replace(CONFIG, poses="standing"))


def test_items_and_batches_hold_the_rotations_of_bones(folder: Path, posed: list[Sample]) -> None:
    items = list(GarmentDataset(folder, cache_dir=folder / "cache"))
    for item, sample in zip(items, posed, strict=True):
        assert sample.shape and sample.shape.pose
        assert torch.equal(item["pose"], torch.tensor(sample.shape.pose.array, dtype=torch.float32))
        turn = item["pose"][BONES.index("left_upper_arm")]
        assert item["meta"]["pose"]["bones"]["left_upper_arm"] == pytest.approx(turn.tolist())
        assert item["meta"]["pose"]["name"] == sample.shape.pose.name
    assert collate_packed(items).pose.shape == (2, 21, 3)
    assert "pose" in GeneratedGarments(1, poses="standing", device="cpu").fields


def test_the_wearer_of_an_item_is_in_its_pose(folder: Path, posed: list[Sample]) -> None:
    read = GarmentDataset(folder, fields=VIEW_FIELDS, cache_dir=folder / "cache")
    for row, sample in enumerate(posed):
        assert sample.shape
        wearer = stored_body(sample.shape)
        seen = wearer_of(StoredGarment.of(read[row], user="Views"), None)
        np.testing.assert_array_equal(seen.vertices, wearer.vertices)
        assert read.sample(row).shape == replace(sample.shape, weights=sample.shape.weights.astype(np.float32))


def test_garments_in_the_a_pose_have_no_field_of_it(worn_folder: Path) -> None:
    with pytest.raises(ConfigError, match="no field pose"):
        GarmentDataset(worn_folder, fields=["pose"])


def test_a_pose_without_all_bones_is_refused(posed: list[Sample]) -> None:
    meta = json.loads(encode_sample(posed[0])["meta.json"])
    del meta["crc32_before"], meta["pose"]["bones"]["head"]
    with pytest.raises(ShardError, match="pose is"):
        read_meta(sealed(meta))
