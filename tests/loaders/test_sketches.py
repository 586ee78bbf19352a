"""Sketches drawn when garments are read: the same for any order and worker."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gcd_dataset.errors import ConfigError, TransformError
from gcd_dataset.generator.render import FLAT, HAND, SketchStyle
from gcd_dataset.loaders import VIEW_FIELDS, Augmented, GarmentDataset, GarmentLoader, Sketch
from gcd_dataset.records import Sample
from tests.loaders.rendered import of_another_data_set, write


def dataset(worn_folder: Path, **options: Any) -> GarmentDataset:
    return GarmentDataset(worn_folder, fields=VIEW_FIELDS, **options)


def small(**options: Any) -> Sketch:
    return Sketch(**{"size": 64, **options})


def test_lines_lie_on_the_border_of_the_garment(worn_folder: Path) -> None:
    """The cameras project the garment into the inked part of the picture, and fill it."""
    item = dataset(worn_folder)[0]
    made = small(size=256, yaws=(0.0,))(item)
    vertices = item["verts"].double()
    for ink, k, rt in zip(
        255 - made["sketch"].int(), made["sketch_k"].double(), made["sketch_rt"].double(), strict=True
    ):
        seen = (vertices @ rt[:, :3].T + rt[:, 3]) @ k.T
        pixels = seen[:, :2] / seen[:, 2:]
        row, column = torch.nonzero(ink > 128, as_tuple=True)
        for axis, inked in ((0, column), (1, row)):
            assert inked.min().item() == pytest.approx(pixels[:, axis].min().item(), abs=2.5)
            assert inked.max().item() == pytest.approx(pixels[:, axis].max().item(), abs=2.5)


def test_sketches_by_hand_are_a_function_of_seed_epoch_and_garment(worn_folder: Path) -> None:
    options: dict[str, Any] = {"style": HAND, "turn": 30.0, "yaws": (0.0,)}
    draw = small(**options)
    item = dataset(worn_folder)[0]
    alone = draw(item)["sketch"]
    [batch] = GarmentLoader(dataset(worn_folder, transform=draw)[:1], 1, seed=1, num_workers=1)
    assert (batch["sketch"].shape, batch["sketch"].dtype) == ((1, 1, 64, 64), torch.uint8)
    assert torch.equal(batch["sketch"][0], alone)
    draw.set_epoch(1)
    assert not torch.equal(draw(item)["sketch"], alone)
    assert not torch.equal(small(seed=1, **options)(item)["sketch"], alone)
    draw.set_epoch(0)
    assert not torch.equal(draw(of_another_data_set(item))["sketch"], alone)


def test_a_flat_from_a_fixed_side_is_the_same_in_every_epoch(worn_folder: Path) -> None:
    garments = Augmented(dataset(worn_folder), small(yaws=(0.0,)))
    first = garments[0]
    garments.set_epoch(1)
    assert torch.equal(first["sketch"], garments[0]["sketch"])


def test_turned_sketches_stay_within_their_limit(worn_folder: Path) -> None:
    turned = small(turn=40.0)(dataset(worn_folder)[0])
    assert not torch.equal(turned["sketch"][0], turned["sketch"][1])
    away = -np.einsum("nij,ni->nj", turned["sketch_rt"][:, :, :3].numpy(), np.tile([0.0, 0.0, 1.0], (2, 1)))
    yaw = np.degrees(np.arctan2(away[:, 0], away[:, 2]))
    gone = np.abs((yaw - [0.0, 180.0] + 180.0) % 360.0 - 180.0)
    assert ((gone > 0) & (gone <= 40.0)).all()


def test_a_style_decides_the_lines(worn_folder: Path) -> None:
    item = dataset(worn_folder)[0]
    ink = [(255 - small(size=128, yaws=(0.0,), style=style)(item)["sketch"].int()).sum()
           for style in (SketchStyle(seams=False, hems=False, folds=False), FLAT, SketchStyle(weight=2.0))]  # fmt: skip
    assert ink[0] < ink[1] < ink[2]


def test_unusable_items_and_options_are_refused(worn_folder: Path) -> None:
    with pytest.raises(TransformError, match=r"Sketch needs .*VIEW_FIELDS"):
        GarmentDataset(worn_folder, fields=("meta", "verts"), transform=small())[0]
    for options, words in (
        ({"size": 0}, "size"),
        ({"size": 9999}, "4096"),
        ({"yaws": ()}, "yaws"),
        ({"turn": -1}, "turn"),
        ({"turn": math.nan}, "turn=nan: give a finite number, 0 to 180 degrees"),
        ({"yaws": 90.0}, "yaws=90.0: give one angle or more in a tuple"),
        ({"yaws": (0.0, math.inf)}, "yaws=inf: give a finite number"),
        ({"style": "hand"}, "style='hand': give SketchStyle"),
    ):
        with pytest.raises(ConfigError, match=words):
            small(**options)


PAGE = Path(__file__).resolve().parent.parent.parent / "docs" / "sketches.md"


def test_the_page_runs_and_lists_every_entry(
    worn: list[Sample], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "garments", worn[:1])
    monkeypatch.chdir(tmp_path)
    (program,) = re.findall(r'```python title="\w+\.py"\n(.*?)```', PAGE.read_text(), re.DOTALL)
    program = program.replace("size=512", "size=96")
    exec(compile(program, str(PAGE), "exec"), {})
    assert capsys.readouterr().out.strip() == "torch.Size([1, 2, 96, 96])"
    plain = dataset(tmp_path / "garments")[0]
    entries = small(yaws=(0.0,))(plain).keys() - plain.keys()
    assert set(re.findall(r"^\| `(sketch\w*)`", PAGE.read_text(), re.MULTILINE)) == entries
