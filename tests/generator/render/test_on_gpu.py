"""Pictures, scans and sketches of a GPU agree with those of the CPU, through the transforms of the loaders.

Skipped without a GPU: ``python -m pytest tests/generator/render/test_on_gpu.py``.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp
from scipy.spatial import cKDTree

from gcd_dataset.generator.render import MAPS, NOISELESS
from gcd_dataset.generator.render.pictures import VERTEX_MAPS
from gcd_dataset.loaders import VIEW_FIELDS, GarmentDataset, GarmentLoader, Scan, Sketch, Views
from gcd_dataset.loaders.base import Item
from tests.loaders.rendered import samples, write, write_mapped

GPU = "cuda"
COUNT = 3
SIZE = 128

pytestmark = pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device")


@pytest.fixture(scope="module")
def items(tmp_path_factory: pytest.TempPathFactory) -> list[Item]:
    folder = write_mapped(tmp_path_factory.mktemp("shards"), samples(COUNT))
    return list(GarmentDataset(folder, fields=(*VIEW_FIELDS, *VERTEX_MAPS)))


def both(items: list[Item], made: Callable[[str], Any]) -> list[tuple[dict[str, np.ndarray], dict[str, np.ndarray]]]:
    """The new entries of each item, on the GPU and on the CPU."""
    transforms = [made(device) for device in (GPU, "cpu")]
    found = []
    for item in items:
        here, there = ({k: v.numpy() for k, v in make(item).items() if k not in item} for make in transforms)
        assert here.keys() == there.keys()
        found.append((here, there))
    return found


def test_masks_and_maps_agree(items: list[Item]) -> None:
    """Masks on 99.9 % of the pixels; depth, normals, uv and gap where both see the same panel or part."""
    for gpu, cpu in both(items, lambda device: Views(n=4, size=SIZE, maps=(*MAPS, *VERTEX_MAPS), device=device)):
        for name in ("silhouette", "part", "panel_id"):
            assert np.mean(gpu[f"{name}_map"] == cpu[f"{name}_map"]) >= 0.999, name
        assert np.mean(gpu["seam_map"] == cpu["seam_map"]) >= 0.99
        assert np.mean(gpu["lit_map"] == cpu["lit_map"]) >= 0.98
        same = (gpu["panel_id_map"] == cpu["panel_id_map"]) & (gpu["part_map"] == cpu["part_map"])
        for name, tolerance in (("depth", 0.05), ("normals", 0.02), ("uv", 0.05), ("gap", 0.05)):
            apart = np.abs(gpu[f"{name}_map"][same] - cpu[f"{name}_map"][same])
            assert np.nanmean(np.nan_to_num(apart) <= tolerance) >= 0.999, name
        assert np.allclose(gpu["camera_rt"], cpu["camera_rt"])
        assert np.mean(gpu["panel_corner_visible"] == cpu["panel_corner_visible"]) >= 0.95
        assert np.mean(gpu["landmark_visible"] == cpu["landmark_visible"]) >= 0.95


def test_colours_agree(items: list[Item]) -> None:
    """Levels of 255: most pixels within 1, all but 1 % within 8; shadows' edges may fall on other pixels."""
    for gpu, cpu in both(items, lambda device: Views(n=4, size=SIZE, maps=(), device=device)):
        apart = np.abs(gpu["views"].astype(int) - cpu["views"].astype(int))
        assert np.median(apart) <= 1
        assert np.mean(apart <= 8) >= 0.99
        assert apart.mean() < 1.0


def test_pictures_of_a_gpu_do_not_depend_on_the_batch(items: list[Item]) -> None:
    views = Views(n=2, size=SIZE, maps=("depth",), device=GPU)
    together = views.add_to_items(items, [0] * len(items))
    for item, other in zip(items, together, strict=True):
        alone = views(item)
        assert np.array_equal(alone["views"].numpy(), other["views"].numpy())
        assert np.array_equal(alone["depth_map"].numpy(), other["depth_map"].numpy())


@pytest.mark.skipif(len(wp.get_cuda_devices()) < 2, reason="needs two CUDA devices")
def test_every_gpu_renders_the_same(items: list[Item]) -> None:
    """Also GPUs that are not Warp's default device."""
    last = f"cuda:{len(wp.get_cuda_devices()) - 1}"
    for transform in (Views, Scan, Sketch):
        first, other = (transform(size=64, device=device)(items[0]) for device in ("cuda:0", last))
        for name, value in first.items():
            if name not in items[0]:
                assert np.array_equal(value.numpy(), other[name].numpy(), equal_nan=value.is_floating_point()), name


def test_a_loader_renders_in_the_background(tmp_path: Path) -> None:
    garments = GarmentDataset(write(tmp_path, samples(COUNT)), fields=VIEW_FIELDS)
    views = Views(n=2, size=SIZE, device=GPU)
    alone = {item["meta"]["index"]: views(item)["views"] for item in garments}
    for workers in (0, 2):
        for batch in GarmentLoader(garments, 2, num_workers=workers, views=views):
            for meta, pictures in zip(batch["meta"], batch["views"], strict=True):
                assert np.array_equal(pictures.numpy(), alone[meta["index"]].numpy())


def test_scans_agree(items: list[Item]) -> None:
    """The same pixels are measured, with the same noise: nearly all points are the same."""
    for gpu, cpu in both(items, lambda device: Scan(n=2, points=2000, size=SIZE, device=device)):
        assert np.allclose(gpu["scan_camera_rt"], cpu["scan_camera_rt"])
        assert share_near(gpu["scan"], cpu["scan"]) > 0.95
        assert abs(np.mean(gpu["scan_panel_id"] == 0) - np.mean(cpu["scan_panel_id"] == 0)) < 0.03


def test_noiseless_depths_agree(items: list[Item]) -> None:
    for gpu, cpu in both(items, lambda device: Scan(points=2000, size=SIZE, noise=NOISELESS, device=device)):
        assert share_near(gpu["scan"], cpu["scan"]) > 0.99


def share_near(points: np.ndarray, others: np.ndarray) -> float:
    """Share of the points of a scan that lie within 1 cm of one of the others."""
    return float(np.mean(cKDTree(others[:, :3]).query(points[:, :3])[0] < 1.0))


def test_sketches_agree(items: list[Item]) -> None:
    for gpu, cpu in both(items, lambda device: Sketch(size=256, device=device)):
        assert np.allclose(gpu["sketch_rt"], cpu["sketch_rt"])
        assert np.mean(np.abs(gpu["sketch"].astype(int) - cpu["sketch"].astype(int)) <= 32) >= 0.99
