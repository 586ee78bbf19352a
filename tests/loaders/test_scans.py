"""Scans measured when garments are read: the same for any order and worker."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gcd_dataset.errors import ConfigError, TransformError
from gcd_dataset.generator.render import NOISELESS, ScanRanges
from gcd_dataset.loaders import VIEW_FIELDS, Augmented, GarmentDataset, GarmentLoader, Scan
from tests.loaders.rendered import COUNT, of_another_data_set


def dataset(worn_folder: Path, **options: Any) -> GarmentDataset:
    return GarmentDataset(worn_folder, fields=VIEW_FIELDS, **options)


def small(**options: Any) -> Scan:
    return Scan(**{"n": 2, "points": 500, "size": 64, **options})


def test_a_garment_is_seen_from_one_side(worn_folder: Path) -> None:
    """Noiseless points of one camera in front face it, and lie on the garment."""
    item = dataset(worn_folder)[0]
    front = ScanRanges(yaw=(0.0, 0.0))
    made = small(n=1, noise=NOISELESS, cameras=front)(item)
    scan, rt = made["scan"].double().numpy(), made["scan_camera_rt"][0].double().numpy()
    eye = -rt[:, :3].T @ rt[:, 3]
    assert (np.einsum("nc,nc->n", scan[:, 3:], eye - scan[:, :3]) > 0).all()
    vertices = item["verts"].double().numpy()
    panels = set(made["scan_panel_id"].tolist())
    assert -1 not in panels
    assert len(panels) < len(item["meta"]["panel_names"])
    seen = [np.linalg.norm(scan[:, :3] - vertex, axis=1).min() < 3.0 for vertex in vertices]
    assert 0.1 < np.mean(seen) < 0.9


def test_the_rows_point_to_the_panels_of_the_garment(worn_folder: Path) -> None:
    item = dataset(worn_folder)[0]
    made = small(noise=NOISELESS)(item)
    middle = item["verts"].double()[item["faces"].long()].mean(dim=1)
    distance = torch.cdist(made["scan"][:, :3].double(), middle)
    nearest = item["panel_id"].long()[distance.argmin(dim=1)]
    assert (nearest == made["scan_panel_id"]).double().mean() > 0.85  # others lie near a seam


def test_scans_are_a_function_of_seed_epoch_and_garment(worn_folder: Path) -> None:
    alone = {item["meta"]["index"]: item["scan"] for item in map(small(), dataset(worn_folder))}
    scan = small()
    for workers, batch_size in ((0, 2), (1, 1)):
        loader = GarmentLoader(dataset(worn_folder, transform=scan), batch_size, seed=workers, num_workers=workers)
        for batch in loader:
            assert batch["scan"].shape[1:] == (500, 6)
            for meta, points in zip(batch["meta"], batch["scan"], strict=True):
                assert torch.equal(points, alone[meta["index"]])
    item = dataset(worn_folder)[0]
    scan.set_epoch(1)
    later = scan(item)["scan"]
    assert not torch.equal(later, alone[0])
    assert not torch.equal(small(seed=1)(item)["scan"], alone[0])
    scan.set_epoch(0)
    assert torch.equal(scan(item)["scan"], alone[0])


def test_other_data_sets_have_other_scans_at_the_same_number(worn_folder: Path) -> None:
    item = dataset(worn_folder)[0]
    assert not torch.equal(small()(of_another_data_set(item))["scan"], small()(item)["scan"])


def test_as_an_augmentation_each_epoch_has_another_scan(worn_folder: Path) -> None:
    garments = Augmented(dataset(worn_folder), small())
    first = garments[1]["scan"]
    assert torch.equal(first, garments[1]["scan"])
    garments.set_epoch(1)
    assert not torch.equal(first, garments[1]["scan"])


def test_skin_is_measured_on_demand(worn_folder: Path) -> None:
    made = small(body=True)(dataset(worn_folder)[0])
    assert (made["scan_panel_id"] == -1).any()
    assert (made["scan_panel_id"] >= 0).any()
    assert torch.isfinite(made["scan"]).all()


def test_unusable_items_and_options_are_refused(worn_folder: Path) -> None:
    with pytest.raises(TransformError, match=r"Scan needs .*VIEW_FIELDS"):
        GarmentDataset(worn_folder, fields=("meta", "verts"), transform=small())[0]
    for options, words in (
        ({"points": 0}, "points"),
        ({"noise": 0.5}, r"noise=0\.5: give DepthNoise"),
        ({"cameras": ScanRanges(distance=(math.inf, 300.0))}, "distance of cameras=inf: give a finite number"),
    ):
        with pytest.raises(ConfigError, match=words):
            small(**options)


PAGE = Path(__file__).resolve().parent.parent.parent / "docs" / "scans.md"


def test_the_page_runs_and_lists_every_entry(
    worn_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "garments").symlink_to(worn_folder)
    monkeypatch.chdir(tmp_path)
    (program,) = re.findall(r'```python title="\w+\.py"\n(.*?)```', PAGE.read_text(), re.DOTALL)
    exec(compile(program.replace("batch_size=8", f"batch_size={COUNT}"), str(PAGE), "exec"), {})
    assert capsys.readouterr().out.strip() == f"torch.Size([{COUNT}, 4096, 6])"
    plain = dataset(worn_folder)[0]
    entries = small()(plain).keys() - plain.keys()
    assert set(re.findall(r"^\| `(scan\w*)`", PAGE.read_text(), re.MULTILINE)) == entries
