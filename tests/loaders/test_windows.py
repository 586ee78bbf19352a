"""Windows of garments in motion: consecutive frames, by garment and first frame, in batches of different garments."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.body import walk
from gcd_dataset.generator.recipe import recipe_of
from gcd_dataset.loaders import (
    GarmentDataset,
    GarmentLoader,
    GeneratedGarments,
    Hdf5Garments,
    collate_packed,
    collate_padded,
)
from gcd_dataset.records import FPS, MOTION_STEP, GarmentMotion, Outcome, Sample
from gcd_dataset.shards import ShardReader
from gcd_dataset.shards.hdf5 import write_hdf5
from gcd_dataset.shards.motion import NO_FRAMES, motion_as_stored
from tests.generator.drape.garments import still
from tests.loaders.rendered import CONFIG
from tests.shards.folders import write_samples

WALK = replace(CONFIG, views=0, poses="walk")
FRAMES = (6, 0, 4)
"""Of each garment, of six asked for."""


def risen(sample: Sample, frames: int) -> Sample:
    """A garment that rises with a speed that grows by a centimetre a frame."""
    assert sample.drape and sample.box_mesh and sample.shape
    poses, rise = tuple(walk()[:frames]), 0.5 * np.arange(frames) * np.arange(1, frames + 1)
    shape = replace(sample.shape, pose=walk()[0])
    motion = replace(NO_FRAMES, asked=6, ended=Outcome.FELL)
    if frames:
        vertices = motion_as_stored(sample.drape.vertices + rise[:, None, None] * [0.0, 1.0, 0.0])
        counts = np.zeros((frames, 3), int)
        motion = GarmentMotion(vertices, sample.box_mesh.faces, poses, FPS, counts, 6, Outcome.FELL)
    return replace(sample, shape=shape, motion=motion, views=())


@pytest.fixture(scope="module")
def moving(worn: list[Sample]) -> list[Sample]:
    return [risen(sample, frames) for sample, frames in zip(worn, FRAMES, strict=True)]


@pytest.fixture(scope="module")
def folder(moving: list[Sample], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_samples(tmp_path_factory.mktemp("moving"), moving, seed=4, recipe=recipe_of(WALK), shard_size=2)


def test_items_are_windows_of_consecutive_frames(folder: Path, moving: list[Sample]) -> None:
    ds = GarmentDataset(folder, frames=3, cache_dir=folder / "cache")
    assert len(ds) == 4 + 0 + 2
    firsts = [(item["meta"]["index"], int(item["motion_first"])) for item in ds]
    assert firsts == [(0, 0), (0, 1), (0, 2), (0, 3), (2, 0), (2, 1)]
    for item, (index, first) in zip(ds, firsts, strict=True):
        motion = moving[index].motion
        assert motion and item["meta"]["motion"]["ended"] == "FELL"
        np.testing.assert_array_equal(item["motion_verts"], motion.vertices[first : first + 3])
        pose = [pose.array for pose in motion.poses[first : first + 3]]
        np.testing.assert_allclose(item["motion_pose"], np.array(pose), atol=1e-6)
        np.testing.assert_array_equal(item["verts"], motion.vertices[0])
        speeds = FPS * np.arange(first, first + 3)[:, None, None] * [0.0, 1.0, 0.0]
        np.testing.assert_allclose(
            item["motion_velocities"], np.broadcast_to(speeds, item["motion_verts"].shape), atol=FPS * MOTION_STEP
        )
    assert ds._key(5) == "gcd_000000002" and ds["gcd_000000002"]["motion_first"] == 0
    assert sum(ds.shard_lengths()) == len(ds)
    sample = ds.sample(5).motion
    assert sample and len(sample.poses) == 4


def test_a_cache_without_room_for_columns_gives_the_same_windows(folder: Path, tmp_path: Path) -> None:
    ds = GarmentDataset(folder, frames=3, cache_dir=folder / "cache")
    small = GarmentDataset(folder, frames=3, cache_dir=tmp_path, max_cache_size=150_000)
    item: Any
    same: Any
    for item, same in zip(ds, small, strict=True):
        assert item.keys() == same.keys()
        assert all(torch.equal(item[name], same[name]) for name in item if name.startswith("motion_"))


@pytest.mark.parametrize("workers", [0, 1])
def test_batches_hold_windows_of_different_garments(folder: Path, workers: int) -> None:
    """Packed along the vertices; what a garment of a batch holds is its item."""
    fields = ["verts", "faces", "motion_verts", "motion_velocities", "motion_pose", "motion_first"]
    ds = GarmentDataset(folder, fields=fields, frames=3, cache_dir=folder / "cache")
    [batch] = GarmentLoader(ds, 6, shuffle=False, num_workers=workers)
    items: list[Any] = list(ds)
    assert batch.motion_verts.shape == batch.motion_velocities.shape == (3, len(batch.verts), 3)
    assert batch.motion_pose.shape == (6, 3, 21, 3)
    assert batch.motion_first.tolist() == [0, 1, 2, 3, 0, 1]
    assert torch.equal(batch["motion_verts_ptr"], batch["verts_ptr"])
    values, starts, _ = batch.varlen("motion_verts")
    assert torch.equal(values[starts[4] : starts[5]].swapaxes(0, 1), items[4]["motion_verts"])
    assert torch.equal(batch.garment(4)["motion_velocities"], items[4]["motion_velocities"])
    alone = collate_packed([{name: item[name] for name in ("faces", "motion_verts")} for item in items])
    assert torch.equal(alone.faces, batch.faces)
    padded = collate_padded(items)
    vertices = [len(item["verts"]) for item in items]
    assert padded.motion_verts.shape == (6, 3, max(vertices), 3)
    assert torch.equal(padded.motion_verts[4, :, : vertices[4]], items[4]["motion_verts"])
    assert padded["motion_verts_mask"].sum(dim=1).tolist() == vertices


def test_garments_without_frames_hold_no_motion(folder: Path, worn_folder: Path) -> None:
    plain = GarmentDataset(folder, cache_dir=folder / "cache")
    assert len(plain) == 3 and not [field for field in plain.fields if field.startswith("motion_")]
    assert len(collate_packed([plain[0], plain[2]]).verts)
    with pytest.raises(ConfigError, match=r"no field motion_verts: .*frames=8 reads garments in motion"):
        GarmentDataset(folder, fields=["motion_verts"])
    with pytest.raises(ConfigError, match=r"frames=7: the longest motion of .* has 6 frames"):
        GarmentDataset(folder, frames=7)
    with pytest.raises(ConfigError, match="frames is for garments in motion"):
        GarmentDataset(worn_folder, frames=3)
    with pytest.raises(ConfigError, match="frames=0"):
        GarmentDataset(folder, frames=0)
    with pytest.raises(ConfigError, match="streaming=True reads whole garments"):
        GarmentDataset(folder, frames=3, streaming=True)


def test_made_garments_hold_their_motion_in_the_sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gcd_dataset.generator.drape.drape.drape_on", still)
    short = {"meta": {"upper": "none", "bottom": "SkirtCircle"}, "flare-skirt": {"length": 0.2}}
    options = {"resolution": 10.0, "picture": 0, "device": "cpu", "poses": "walk", "design": short}
    made = GeneratedGarments(1, cache_dir=tmp_path, **options)  # type: ignore[arg-type]
    assert "pose" in made.fields and "motion_verts" not in made.fields
    for _ in range(2):  # made, and from the cache
        motion = made.sample(0).motion
        assert motion and motion.asked == len(motion.poses) == len(walk())


def test_hdf5_keeps_poses_and_leaves_motions_out(folder: Path, moving: list[Sample], tmp_path: Path) -> None:
    assert list(write_hdf5(ShardReader(folder), tmp_path / "train.h5")) == [0, 1, 2]
    assert Hdf5Garments(tmp_path / "train.h5").sample(0).motion is None
    pose = moving[0].shape.pose if moving[0].shape else None
    assert pose is not None
    np.testing.assert_allclose(Hdf5Garments(tmp_path / "train.h5", fields=["pose"])[0]["pose"], pose.array, atol=1e-6)
