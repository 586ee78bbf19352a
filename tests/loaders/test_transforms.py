"""Augmentations: geometry, and draws by seed, index and epoch."""

import math
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders import (
    Augmented,
    Chain,
    FakeGarments,
    GarmentLoader,
    MixedDataset,
    PartialView,
    PointNoise,
    Yaw,
)
from gcd_dataset.loaders.base import Item
from tests.loaders.test_shards import assert_all_same, same


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def ball(radius: float = 40.0) -> Item:
    """Points of a sphere centred 100 cm above the ground."""
    shape = trimesh.creation.icosphere(subdivisions=4)
    points = np.concatenate([radius * shape.vertices + [0, 100, 0], shape.vertices], axis=1)
    return {"points": torch.from_numpy(points.astype(np.float16))}


def test_yaw_keeps_heights_and_distances_and_rotates_normals_with_the_surface() -> None:
    item = FakeGarments(1)[0]
    turned = Yaw()(item, rng())
    for field in ("verts", "box", "points"):
        before, after = item[field].float(), turned[field].float()
        assert not torch.allclose(before, after, atol=0.1)
        assert torch.allclose(before[:, 1], after[:, 1], atol=1e-3)
        radius = (before[:, [0, 2]].norm(dim=1), after[:, [0, 2]].norm(dim=1))
        assert torch.allclose(*radius, atol=0.03)
        assert turned[field].dtype == item[field].dtype
    assert same(item, FakeGarments(1)[0])
    points = Yaw()(ball(), rng())["points"].float()
    assert torch.allclose((points[:, :3] - torch.tensor([0.0, 100.0, 0.0])) / 40, points[:, 3:], atol=2e-3)


def test_yaw_turns_scans_and_cameras_with_the_figure() -> None:
    """Every camera sees the turned points where it saw them before; what was not measured stays so."""
    points = torch.cat([ball()["points"][::40].float(), torch.full((2, 6), torch.nan)])
    rotation = torch.from_numpy(Rotation.from_euler("xyz", [[0.3, 1.0, -0.5], [2.0, -0.4, 1.2]]).as_matrix()).float()
    rt = torch.cat([rotation, torch.ones(2, 3, 1)], dim=2)
    facts = {
        "camera": {"rt": rt[0].tolist(), "size": 9},
        "light": {"key_direction": rotation[0, 2].tolist(), "fill_direction": [0.0, 1.0, 0.0], "sky": 1.0},
    }
    item: dict[str, Any] = {
        "scan": points, "scan_camera_rt": rt, "camera_rt": rt, "sketch_rt": rt.half(), "view_0_json": facts
    }  # fmt: skip
    turned = Yaw()(item, rng())
    assert turned["scan"].isnan().any(dim=1).tolist() == points.isnan().any(dim=1).tolist()
    assert not torch.allclose(turned["scan"][:-2], points[:-2], atol=1.0)
    for field in ("scan_camera_rt", "camera_rt", "sketch_rt"):
        assert turned[field].dtype == item[field].dtype
        for before, after in zip(item[field].float(), turned[field].float(), strict=True):
            for columns in (slice(0, 3), slice(3, 6)):  # points, normals
                seen, now = points[:-2, columns] @ before[:, :3].T, turned["scan"][:-2, columns] @ after[:, :3].T
                assert torch.allclose(seen, now, atol=0.2 if field == "sketch_rt" else 1e-3)
            assert torch.equal(before[:, 3], after[:, 3])
    stored = turned["view_0_json"]
    assert torch.allclose(torch.tensor(stored["camera"]["rt"]), turned["camera_rt"][0])
    # the light still shines along the optical axis of the first camera
    assert stored["light"]["key_direction"] == pytest.approx(turned["camera_rt"][0, 2, :3].tolist(), abs=1e-6)
    assert (stored["light"]["sky"], stored["camera"]["size"]) == (1.0, 9)
    assert facts["camera"]["rt"] == rt[0].tolist()


def test_yaw_stays_within_its_limit() -> None:
    angles = []
    for seed in range(50):
        x, _, z = Yaw(0.5)({"verts": torch.tensor([[0.0, 0.0, 1.0]])}, rng(seed))["verts"][0].tolist()
        angles.append(np.arctan2(x, z))
    assert 0.4 < max(angles) <= 0.5
    assert -0.5 <= min(angles) < -0.4


def test_noise_has_the_given_standard_deviation() -> None:
    before, after = ball()["points"].float(), PointNoise(2.0)(ball(), rng())["points"].float()
    assert (after - before)[:, :3].std().item() == pytest.approx(2.0, rel=0.05)
    assert torch.equal(after[:, 3:], before[:, 3:])


@pytest.mark.parametrize("value", [-1, math.nan, math.inf, "0.2", None, True])
def test_sizes_of_augmentations_are_finite_numbers_from_zero(value: Any) -> None:
    for make in (PointNoise, Yaw, PartialView, partial(PartialView, 300.0)):
        with pytest.raises(ConfigError, match=r"(sigma|most|distance|reach)=.*: give a finite number, [01]"):
            make(value)


def test_a_view_shows_the_half_that_faces_the_camera() -> None:
    view = PartialView(distance=4000.0)(ball(), rng())["points"]
    assert view.shape == ball()["points"].shape
    seen = view.float().unique(dim=0)
    assert 0.4 < len(seen) / len(ball()["points"]) < 0.55
    toward = seen[:, 3:].mean(dim=0)
    facing = seen[:, 3:] @ (toward / toward.norm())
    assert (facing > -0.15).all()
    assert abs(toward[1]) < 0.05


def test_absent_fields_are_skipped() -> None:
    item = FakeGarments(1, fields=["meta"])[0]
    assert Chain(Yaw(), PointNoise(1.0), PartialView())(item, rng()) == item


def test_draws_depend_on_seed_index_and_epoch() -> None:
    def changed(seed: int = 0, epoch: int = 0) -> Augmented:
        ds = Augmented(FakeGarments(4, fields=["points"]), PointNoise(1.0), seed=seed)
        ds.set_epoch(epoch)
        return ds

    assert_all_same(changed(), changed())
    assert_all_same(changed().__getitems__([2, 0, -1]), [changed()[2], changed()[0], changed()[3]])
    assert_all_same(changed().stream([2, 0]), [changed()[2], changed()[0]])
    assert not same(changed()[0], changed(seed=1)[0])
    assert not same(changed()[0], changed(epoch=1)[0])


def test_augmented_garments_keep_state_recipe_and_slices() -> None:
    plain = FakeGarments(6, fields=["points"])
    ds = Augmented(plain, Yaw())
    GarmentLoader(ds, 2).load_state_dict(GarmentLoader(plain, 2).state_dict())
    assert ds.recipe(3) == plain.recipe(3)
    assert len(ds[2:]) == 4
    with pytest.raises(ConfigError, match="MixedDataset"):
        Augmented(MixedDataset([plain], [1]), Yaw())
