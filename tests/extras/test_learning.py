"""Networks of other options learn, several processes make what one makes, and slow figures of single cases."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensorMode

from benchmarks.cloth_tests import drape_coefficient
from benchmarks.reconstruction.derived import FIRST_PANEL
from benchmarks.reconstruction.garments import GarmentSet, generated, read_folder
from benchmarks.reconstruction.models import panel_set
from benchmarks.reconstruction.options import Config
from benchmarks.reconstruction.tasks import NAMED
from benchmarks.reconstruction.train import train
from gcd_dataset.cli import main as gcd
from gcd_dataset.generator.body import build_body, measure, neutral_shape
from gcd_dataset.generator.drape import Fabric
from gcd_dataset.generator.garments import design_from_dict, draw_garment
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.scoring.inputs import PICTURE_SIZE, PICTURES
from gcd_dataset.tensors import PANEL_LABELS
from tests.benchmarks.reconstruction.conftest import SKIRTS
from tests.benchmarks.reconstruction.test_networks import SIZES, network
from tests.benchmarks.reconstruction.toys import small
from tests.benchmarks.test_draping import parity_figures
from tests.scoring.test_score import figures, save

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def skirts() -> GarmentSet:
    """Three skirts with pictures."""
    extra = (*NAMED, "box_labels", "pictures", "shown")
    return generated(3, 0, points=512, extra=extra, drape="warp", resolution=8.0, design=SKIRTS)


def test_the_loss_falls(skirts: GarmentSet) -> None:
    torch.manual_seed(0)
    learner = small("picture_parameters", views=1)
    config = Config(steps=30, batch=3, lr=4e-3, log_every=5, weight_decay=0.0)
    curve = train(learner, learner.prepare(skirts, device=CPU), config, device=CPU).curve
    assert curve[-1]["loss"] < 0.9 * curve[0]["loss"]


@pytest.mark.parametrize("model", SIZES)
def test_a_step_reads_no_value_of_the_device(model: str, skirts: GarmentSet, monkeypatch: pytest.MonkeyPatch) -> None:
    """Reading one would wait for a GPU; fake tensors have no values, and no memory for Warp."""
    learner = network(model)
    batch = learner.prepare(skirts, device=CPU).batch(torch.arange(2))
    monkeypatch.setattr(panel_set, "least_cost", lambda cost, asked: torch.zeros(asked.shape, dtype=torch.int64))
    with FakeTensorMode(allow_non_fake_inputs=True):
        assert all(part.shape == () for part in learner.loss(batch).values())


def test_published_garments_are_scanned_and_shown(examples: Path, tmp_path: Path) -> None:
    """On the bodies of the release; a skirt of two panels, draped from 52.6 to 108.6 cm."""
    folder, published = tmp_path / "published", examples / "published"
    shutil.copytree(
        published / "GarmentCodeData_v2_unpacked", folder, ignore=shutil.ignore_patterns("random_body", "neutral_body")
    )
    shutil.copytree(published / "GarmentCodeData_v2" / "neutral_body", folder / "neutral_body")
    found = read_folder(str(folder), points=8192, extra=("pose", "scan", "pictures", "shown"), split="test")
    height = found.points[0, :, 1].astype(float) + 100
    assert (height.min(), height.max()) == pytest.approx((52.6, 108.6), abs=3)
    shown = found.ragged["shown"][0]
    assert set(((shown[shown >= FIRST_PANEL] - FIRST_PANEL) // len(PANEL_LABELS)).tolist()) == {0, 1}


def test_garments_are_seen_in_drawn_pictures() -> None:
    one = generated(1, 0, points=0, extra=("pictures", "shown"), resolution=8.0, design=SKIRTS)
    pictures, shown = one.ragged["pictures"][0], one.ragged["shown"][0]
    panels = (shown[shown >= FIRST_PANEL] - FIRST_PANEL) // len(PANEL_LABELS)
    assert shown.shape == pictures.shape[:-1]
    assert set(panels.tolist()) == set(range(len(one.pattern(0).panels)))
    assert pictures.shape == (PICTURES, PICTURE_SIZE, PICTURE_SIZE, 3)
    assert pictures.dtype == np.uint8
    assert all(picture.std() > 5 for picture in pictures)
    assert not np.array_equal(pictures[0], pictures[1])


@pytest.mark.parametrize("model", ["panel_set", "picture_parameters"])
def test_processes_encode_the_same_targets(model: str, skirts: GarmentSet) -> None:
    learner = small(model)
    one, two = (vars(learner.prepare(skirts, device=CPU, workers=workers))["whole"] for workers in (0, 2))
    torch.testing.assert_close(vars(one), vars(two), rtol=0, atol=0, equal_nan=True)


def test_drapes_that_workers_make_ahead_are_the_same_set() -> None:
    options: dict[str, Any] = {"points": 64, "drape": "warp", "resolution": 8.0, "design": Overlay.from_dict(SKIRTS)}
    options |= {"device": "cpu", "extra": ("pose", "verts")}
    ahead, alone = generated(3, 0, workers=2, **options), generated(3, 0, **options)
    assert ahead.patterns_hash == alone.patterns_hash
    assert np.array_equal(ahead.points, alone.points)
    assert all(np.array_equal(ahead.ragged["verts"][k], alone.ragged["verts"][k]) for k in range(len(alone)))


def test_the_drape_coefficient_of_a_rigid_disc_is_100() -> None:
    rigid = Fabric(density=0.2, tensile=1e4, bending=1.0)
    assert drape_coefficient(rigid, spacing=2.0, edge=2.0) == pytest.approx(100.0, abs=0.2)


def test_several_processes_score_alike_and_the_headline_counts_right_drapes_of_all_garments(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A copy, a copy without one seam, and no prediction: a third."""
    skirt = draw_garment(measure(build_body(neutral_shape())), design_from_dict({"meta": {"bottom": "PencilSkirt"}}))
    true = save(tmp_path / "true", dict.fromkeys("abc", skirt))
    ours = save(tmp_path / "ours", {"a": skirt, "b": replace(skirt, seams=skirt.seams[:-1])})
    printed = []
    for workers in (1, 2):
        assert gcd(["score", str(ours), str(true), "--quiet", "--workers", str(workers)]) == 0
        printed.append(capsys.readouterr().out)
    assert printed[0] == printed[1]
    json_file = tmp_path / "out.json"
    options = ["--drape", "--resolution", "8", "--device", "cpu", "--quiet", "--json", str(json_file)]
    assert gcd(["score", str(ours), str(true), *options]) == 0
    found = figures(capsys.readouterr().out)
    assert found["strict_within_1cm"] == found["combinatorial"] == pytest.approx(1 / 3, abs=1e-4)
    rows = {row["name"]: row for row in json.loads(json_file.read_text())["garments"]}
    assert rows["a"]["redrape_cd_cm"] == pytest.approx(0, abs=1e-6)
    assert rows["b"]["redrape_cd_cm"] < rows["c"]["redrape_cd_cm"] == 100


def test_all_patterns_agree_with_the_reference(examples: Path) -> None:
    found = parity_figures(examples / "patterns")
    assert found["designs"] == 24
    assert found["same"] == found["outline"] == found["placement"] == 1.0
