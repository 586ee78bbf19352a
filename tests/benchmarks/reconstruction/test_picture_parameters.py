"""The network of task T2: what their batches hold, and that they learn from pictures."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.reconstruction import picture_model
from benchmarks.reconstruction.derived import FIRST_PANEL
from benchmarks.reconstruction.design_codes import PARAMETERS, encode_design
from benchmarks.reconstruction.garments import GarmentSet, Ragged
from benchmarks.reconstruction.picture_model import MOST_GROWTH, MOST_SHIFT, MOST_TURN, STRIDE, PictureTokens, distorted
from benchmarks.reconstruction.point_net import EncoderConfig
from gcd_dataset.records import BodyPart
from gcd_dataset.scoring.inputs import PICTURE_SIZE, PICTURES
from tests.benchmarks.reconstruction.toys import small

CPU = torch.device("cpu")
PATHS = [leaf.path for leaf in PARAMETERS]


@pytest.fixture(scope="module")
def painted(six: GarmentSet) -> GarmentSet:
    """Six garments whose pictures are shades of grey: no two garments and no two pictures are alike."""
    shape = (PICTURES, PICTURE_SIZE, PICTURE_SIZE, 3)
    shades = [
        np.broadcast_to(10 * k + 60 * np.arange(PICTURES), shape[::-1]).T.astype(np.uint8) for k in range(len(six))
    ]
    shown = [picture[..., 0] // 10 for picture in shades]
    return replace(six, ragged={**six.ragged, "pictures": Ragged.of(shades), "shown": Ragged.of(shown)})


def shades(pictures: torch.Tensor) -> list[int]:
    return pictures[0, :, 0, 0, 0].tolist()


def test_each_step_draws_other_pictures(painted: GarmentSet, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture_model, "distorted", lambda pictures, shown, numbers: (pictures, shown))
    examples: Any = small("picture_parameters", views=3).prepare(painted, device=CPU)
    assert np.shares_memory(examples.whole.pictures.numpy(), painted.ragged["pictures"].rows)  # 786 kB a garment
    assert shades(examples.batch(torch.tensor([2])).pictures) == [20, 80, 140]
    drawn = [examples.batch(torch.tensor([2]), torch.Generator().manual_seed(k)).pictures for k in (1, 1, 2, 3, 4)]
    assert torch.equal(drawn[0], drawn[1])
    assert len({tuple(shades(pictures)) for pictures in drawn}) > 1
    assert all(len(set(shades(pictures)) & {20, 80, 140, 200}) == 3 for pictures in drawn)


def test_mirrored_garments_have_mirrored_pictures(painted: GarmentSet, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every second one, with the labels of the other side and the parameters of the mirror image."""
    monkeypatch.setattr(picture_model, "distorted", lambda pictures, shown, numbers: (pictures, shown))
    picture = np.zeros((PICTURES, PICTURE_SIZE, PICTURE_SIZE, 3), np.uint8)
    picture[:, :, :10] = 200
    shown = np.where(picture[..., 0] > 0, np.uint8(BodyPart.LEFT_ARM.value), np.uint8(FIRST_PANEL))
    code = encode_design({"meta": {"bottom": "PencilSkirt"}, "pencil-skirt": {"low_angle": 12, "left_slit": 0.5}})
    count = len(painted)
    halves = encode_design({"meta": {"upper": "Shirt"}, "left": {"enable_asym": True}})
    designs = [code[None]] * 4 + [halves[None]] * (count - 4)
    ragged = {"pictures": [picture] * count, "shown": [shown] * count, "design": designs}
    made = replace(painted, ragged={**painted.ragged, **{name: Ragged.of(rows) for name, rows in ragged.items()}})
    examples = small("picture_parameters", augmented=1).prepare(made, device=CPU)
    batch = examples.batch(torch.arange(count), torch.Generator().manual_seed(0))
    mirrored = batch.pictures[:, 0, 0, 0, 0] == 0
    assert 0 < mirrored[:4].sum() < 4
    assert not mirrored[4:].any()  # whose halves differ
    angle, left, right = (PATHS.index(f"pencil-skirt.{name}") for name in ("low_angle", "left_slit", "right_slit"))
    for k, is_mirrored in enumerate(mirrored[:4].tolist()):
        expected = (picture[:2, :, ::-1], shown[:2, :, ::-1]) if is_mirrored else (picture[:2], shown[:2])
        assert np.array_equal(batch.pictures[k], expected[0])
        arm = (BodyPart.RIGHT_ARM if is_mirrored else BodyPart.LEFT_ARM).value
        assert np.array_equal(batch.shown[k], np.where(expected[1] == BodyPart.LEFT_ARM.value, arm, FIRST_PANEL))
        assert batch.codes[k, angle] == (-12 if is_mirrored else 12)
        assert batch.codes[k, right if is_mirrored else left] == 0.5
        assert torch.equal(batch.measures[k], torch.from_numpy(made.measures[k]))


def test_pictures_are_distorted_alike_in_any_batch(painted: GarmentSet) -> None:
    examples = small("picture_parameters").prepare(painted, device=CPU)
    whole, part = (examples.batch(torch.tensor(rows), torch.Generator().manual_seed(0)) for rows in ([4, 1, 2], [1]))
    assert torch.equal(whole.pictures[1:2], part.pictures)
    assert not torch.equal(part.pictures, examples.batch(torch.tensor([1]), torch.Generator().manual_seed(1)).pictures)


def test_a_distortion_moves_a_dot_as_said() -> None:
    pictures = torch.zeros(1, 1, 100, 100, 3, dtype=torch.uint8)
    pictures[0, 0, 48:52, 58:62] = 200  # 10 pixels to the right of the middle
    still = torch.zeros(1, 1, 6)
    labels = pictures[..., 1] // 10
    assert torch.equal(distorted(pictures, labels, still)[0], pictures)
    ways = [still.index_fill(2, torch.tensor(k), 1.0) for k in (0, 1, 2, 4)]
    both = [distorted(pictures, labels, way) for way in ways]
    turned, grown, moved, red = (found for found, _ in both)

    def place(found: torch.Tensor) -> tuple[float, float]:
        weight = found[0, 0, :, :, 1].double()
        at = (torch.arange(100) - 49.5).double()
        return float((weight.sum(0) * at).sum() / weight.sum()), float((weight.sum(1) * at).sum() / weight.sum())

    assert place(turned) == pytest.approx((10 * np.cos(MOST_TURN), -10 * np.sin(MOST_TURN)), abs=0.1)
    assert place(grown) == pytest.approx((10 / np.exp(MOST_GROWTH), 0.0), abs=0.1)
    assert place(moved) == pytest.approx((10 - 50 * MOST_SHIFT, 0.0), abs=0.1)
    for found, shown in both:  # labels move with the pictures
        assert ((found[..., 1] > 100) != (shown == 20)).sum() <= 6
        assert set(shown.flatten().tolist()) == {0, 20}
    assert red[0, 0, 50, 60, 0] == 255
    assert red[0, 0, 50, 60, 1] < 200


def test_losses_of_seen_cells_are_those_of_their_pixels() -> None:
    torch.manual_seed(0)
    network = PictureTokens(EncoderConfig(width=32, heads=2, layers=1), views=2, size=4 * STRIDE, seen=5)
    labels = torch.randint(250, (3, 2, 4 * STRIDE, 4 * STRIDE), dtype=torch.uint8)
    labels[1:] = 0  # borders of others do not matter
    _, rows = network.seen_cells(torch.zeros(*labels.shape, 3, dtype=torch.uint8))
    assert all(len(set(some)) == 5 for some in rows.tolist())
    network.of_pixels.bias.data.normal_()
    flat = torch.zeros(3, 32, 32)
    seen, every = network.pixel_losses(flat[:, :5], labels, rows), network.pixel_losses(flat, labels)
    chosen = [network.pixel_losses(flat[:, :1], labels, rows[:, k : k + 1]) for k in range(5)]
    for name, loss in seen.items():
        assert loss.item() == pytest.approx(sum(one[name].item() for one in chosen) / 5, rel=1e-4)
        assert loss.item() != pytest.approx(every[name].item(), rel=1e-4)
