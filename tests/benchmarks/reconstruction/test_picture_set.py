"""The network of task T2: what its batches hold, and that it learns from pictures."""

from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.reconstruction import garments
from benchmarks.reconstruction.derived import PICTURE_SIZE, PICTURES, picture_views
from benchmarks.reconstruction.garments import GarmentSet, Ragged, fresh_garments, generated
from benchmarks.reconstruction.models.picture_set import PictureSet, build
from benchmarks.reconstruction.training import TrainConfig, train
from gcd_dataset.errors import ConfigError
from tests.benchmarks.reconstruction.conftest import SKIRTS

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def painted(six: GarmentSet) -> GarmentSet:
    """Six garments whose pictures are shades of grey: no two garments and no two pictures are alike."""
    shape = (PICTURES, PICTURE_SIZE, PICTURE_SIZE, 3)
    shades = [
        np.broadcast_to(10 * k + 60 * np.arange(PICTURES), shape[::-1]).T.astype(np.uint8) for k in range(len(six))
    ]
    return replace(six, ragged={**six.ragged, "pictures": Ragged.of(shades)})


def learner(**sizes: int) -> PictureSet:
    torch.manual_seed(0)
    return build(smoke=True, options=sizes)


def shades(pictures: torch.Tensor) -> list[int]:
    return pictures[0, :, 0, 0, 0].tolist()


def test_each_step_draws_other_pictures(painted: GarmentSet) -> None:
    examples = learner(views=3).prepare(painted, device=CPU)
    assert shades(examples.batch(torch.tensor([2])).pictures) == [20, 80, 140]
    drawn = [examples.batch(torch.tensor([2]), torch.Generator().manual_seed(k)).pictures for k in (1, 1, 2, 3, 4)]
    assert torch.equal(drawn[0], drawn[1])
    assert len({tuple(shades(pictures)) for pictures in drawn}) > 1
    assert all(len(set(shades(pictures)) & {20, 80, 140, 200}) == 3 for pictures in drawn)


def test_processes_encode_the_same_targets(painted: GarmentSet) -> None:
    encoded = learner().encoder()(painted.select([0, 1]))
    whole = learner().prepare(painted, device=CPU).whole[:2]
    assert all(torch.equal(value, getattr(whole, name)) for name, value in vars(encoded).items())


def test_the_loss_falls(painted: GarmentSet) -> None:
    network = learner(views=1)
    config = TrainConfig(steps=25, batch=4, lr=3e-3, log_every=5, weight_decay=0.0)
    curve = train(network, network.prepare(painted, device=CPU), config, device=CPU).curve
    assert curve[-1]["loss"] < 0.7 * curve[0]["loss"]
    assert len(list(network.answers(network.prepare(painted, device=CPU), 6, batch=4))) == 6


def test_garments_are_seen_in_drawn_pictures() -> None:
    one = generated(1, 0, points=0, extra=("pictures",), resolution=8.0, design=SKIRTS)
    pictures = one.ragged["pictures"][0]
    assert pictures.shape == (PICTURES, PICTURE_SIZE, PICTURE_SIZE, 3)
    assert pictures.dtype == np.uint8
    assert all(picture.std() > 5 for picture in pictures)
    assert not np.array_equal(pictures[0], pictures[1])


def test_pictures_of_this_process_are_those_of_the_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    # On a GPU this process renders; here with the same code on the CPU, so that the bytes are the same.
    recipe: dict[str, Any] = {"points": 0, "extra": ("pictures",), "resolution": 8.0, "design": SKIRTS}
    rendered_by_workers = generated(2, 0, workers=1, **recipe)
    monkeypatch.setattr(garments, "TOGETHER", 1)
    monkeypatch.setattr(garments, "_views_on_gpu", lambda extra: picture_views("cpu"))
    rendered_here = generated(2, 0, workers=1, **recipe)
    streamed = fresh_garments(_whole, 0, first=0, **recipe)
    for found in (rendered_here, GarmentSet.join(list(islice(streamed, len(rendered_here))))):
        assert found.keys == rendered_by_workers.keys
        assert np.array_equal(found.ragged["pictures"].rows, rendered_by_workers.ragged["pictures"].rows)


def _whole(found: GarmentSet) -> GarmentSet:
    return found


@pytest.mark.parametrize("sizes", [{"views": 9}, {"tables": 2}])
def test_an_unknown_size_is_refused(sizes: dict[str, int]) -> None:
    with pytest.raises(ConfigError, match=r"give 1 to 4|no size tables"):
        learner(**sizes)


def test_every_trained_parameter_has_a_gradient(painted: GarmentSet) -> None:
    network = learner(views=1)
    parts = network.loss(network.prepare(painted, device=CPU).batch(torch.arange(2)))
    torch.autograd.backward(torch.stack(list(parts.values())).sum())
    assert [name for name, p in network.named_parameters() if p.requires_grad and p.grad is None] == []
