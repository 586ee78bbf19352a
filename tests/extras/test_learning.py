"""Every network learns, and several processes make what one makes: half a minute."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.reconstruction.garments import GarmentSet, generated
from benchmarks.reconstruction.models import load_model
from benchmarks.reconstruction.picture_inputs import Input, rendering
from benchmarks.reconstruction.tasks import NAMED
from benchmarks.reconstruction.training import TrainConfig, train
from gcd_dataset.generator.garments.overlay import Overlay
from tests.benchmarks.reconstruction.conftest import SKIRTS
from tests.benchmarks.test_pictures_matter import stored_garments

CPU = torch.device("cpu")
FEW = {"points": 128, "stored_points": 512, "tokens": 16}


@pytest.fixture(scope="module")
def skirts() -> GarmentSet:
    """Six skirts with pictures."""
    extra = (*NAMED, "box_labels", "pictures", "shown")
    return generated(6, 0, points=512, extra=extra, drape="warp", resolution=6.0, design=SKIRTS)


@pytest.mark.parametrize(
    ("model", "options"),
    [
        ("panel_set", FEW),
        ("edge_tokens", FEW),
        ("parameters", {**FEW, "labelled": 1}),
        ("picture_set", {"views": 1}),
        ("picture_parameters", {"views": 1}),
    ],
)
def test_the_loss_falls(model: str, options: dict[str, int], skirts: GarmentSet) -> None:
    torch.manual_seed(0)
    learner = load_model(model).build(smoke=True, options=options)
    config = TrainConfig(steps=30, batch=6, lr=4e-3, log_every=5, weight_decay=0.0)
    curve = train(learner, learner.prepare(skirts, device=CPU), config, device=CPU).curve
    assert curve[-1]["loss"] < 0.9 * curve[0]["loss"]


@pytest.mark.parametrize("model", ["panel_set", "picture_set"])
def test_processes_encode_the_same_targets(model: str, skirts: GarmentSet) -> None:
    learner = load_model(model).build(smoke=True, options={})
    one, two = (learner.prepare(skirts, device=CPU, workers=workers).whole for workers in (0, 2))
    assert all(torch.equal(value, getattr(two, name)) for name, value in vars(one).items())


def test_drapes_that_workers_make_ahead_are_the_same_set() -> None:
    options: dict[str, Any] = {"points": 64, "drape": "warp", "resolution": 8.0, "design": Overlay.from_dict(SKIRTS)}
    options |= {"device": "cpu", "extra": ("pose", "verts")}
    ahead, alone = generated(3, 0, workers=2, **options), generated(3, 0, **options)
    assert ahead.patterns_hash == alone.patterns_hash
    assert np.array_equal(ahead.points, alone.points)
    assert all(np.array_equal(ahead.ragged["verts"][k], alone.ragged["verts"][k]) for k in range(len(alone)))


def test_processes_render_the_same_pictures_as_a_thread(tmp_path: Path) -> None:
    folder, by_count = str(stored_garments(tmp_path)), []
    for processes in (1, 2):
        options: dict[str, Any] = {"seed": 0, "size": 16, "device": "cpu", "processes": processes, "readings": 1}
        with rendering(folder, range(3), [Input.DRAWN], **options) as batches:
            by_count.append({k: p for b in batches for k, p in zip(b.positions.tolist(), b.pictures, strict=True)})
    assert set(by_count[0]) == set(by_count[1]) == {0, 1, 2}
    assert all((by_count[0][k] == by_count[1][k]).all() for k in range(3))
