"""Scans and sketches made when garments are read: the same for any order and worker. The pages, also of pictures."""

import math
import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gcd_dataset.errors import ConfigError, TransformError
from gcd_dataset.generator.render import HAND, MAPS, NOISELESS, CameraRanges, LightRanges, ScanRanges
from gcd_dataset.generator.render.pictures import VERTEX_MAPS
from gcd_dataset.loaders import VIEW_FIELDS, Augmented, FakeGarments, GarmentDataset, GarmentLoader, Scan, Sketch, Views
from gcd_dataset.records import Sample
from tests.loaders.rendered import write_mapped
from tests.loaders.test_views import dataset, small

DOCS = Path(__file__).resolve().parent.parent.parent / "docs"


def scan(**options: Any) -> Scan:
    return Scan(**{"n": 2, "points": 500, "size": 64, **options})


def sketch(**options: Any) -> Sketch:
    return Sketch(**{"size": 32, "yaws": (0.0,), **options})


@pytest.mark.parametrize(("make", "field"), [(scan, "scan"), (partial(sketch, style=HAND, turn=30.0), "sketch")])
def test_entries_are_a_function_of_seed_epoch_and_garment(worn_folder: Path, make: Any, field: str) -> None:
    drawn = make()
    item = dataset(worn_folder)[0]
    alone = drawn(item)[field]
    [batch] = GarmentLoader(dataset(worn_folder, transform=drawn)[:1], 1, seed=1, num_workers=1)
    assert torch.equal(batch[field][0], alone)
    of_another_data_set = {**item, "meta": {**item["meta"], "seed": item["meta"]["seed"] + 1}}
    assert not torch.equal(drawn(of_another_data_set)[field], alone)
    assert not torch.equal(make(seed=1)(item)[field], alone)
    drawn.set_epoch(1)
    assert not torch.equal(drawn(item)[field], alone)


@pytest.mark.parametrize(
    ("make", "field", "stays"), [(scan, "scan", False), (sketch, "sketch", True), (small, "views", False)]
)
def test_as_an_augmentation_each_epoch_is_drawn_anew(worn_folder: Path, make: Any, field: str, stays: bool) -> None:
    """A clean flat from a fixed side has nothing to draw."""
    garments: Any = Augmented(dataset(worn_folder), make())
    first = garments[1][field]
    assert torch.equal(first, garments[1][field])
    garments.set_epoch(1)
    assert torch.equal(first, garments[1][field]) == stays


@pytest.mark.parametrize(
    ("make", "options", "words"),
    [
        (scan, {"points": 0}, "points"),
        (scan, {"noise": 0.5}, r"noise=0\.5: give DepthNoise"),
        (scan, {"cameras": ScanRanges(distance=(math.inf, 300.0))}, "distance of cameras=inf: give a finite number"),
        (sketch, {"size": 0}, "size"),
        (sketch, {"size": 9999}, "4096"),
        (sketch, {"yaws": ()}, "yaws"),
        (sketch, {"turn": -1}, "turn"),
        (sketch, {"turn": math.nan}, "turn=nan: give a finite number, 0 to 180 degrees"),
        (sketch, {"yaws": 90.0}, "yaws=90.0: give one angle or more in a tuple"),
        (sketch, {"yaws": (0.0, math.inf)}, "yaws=inf: give a finite number"),
        (sketch, {"style": "hand"}, "style='hand': give SketchStyle"),
        (Views, {"n": 0}, "n=0: give a whole number, 1 or more"),
        (Views, {"size": 9000}, "size=9000: give 4096 or less"),
        (Views, {"maps": ("depht",)}, r"maps=.*give names in a tuple, of depth, normals"),
        (Views, {"maps": "depth"}, "maps='depth': give names in a tuple"),
        (Views, {"seed": -1}, "seed=-1"),
        (Views, {"device": "gpu"}, "device='gpu'"),
        (Views, {"camera": CameraRanges(fill=(0.5, math.nan))}, "fill of camera=nan: give a finite number"),
        (Views, {"lights": LightRanges(cast=-1.0)}, "cast of lights=-1.0: give a finite number, 0 or more"),
        (Views, {"appearance": {"plain": 1.0}}, r"appearance=.*: give AppearanceRanges\(…\)"),
        (Views, {"bodies": 3}, "bodies=3: give a function of name"),
        (partial(GarmentLoader, FakeGarments(2), 1), {"views": 3}, "views=3: give Views"),
    ],
)
def test_unusable_options_are_refused(make: Any, options: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        make(**options)


@pytest.mark.parametrize("made", [scan(), sketch(), Views(n=1, size=32, seed=0, device="cpu")])
def test_unusable_items_are_refused(worn_folder: Path, made: Any) -> None:
    with pytest.raises(TransformError, match=rf"{type(made).__name__} needs spec, uv, panel_id, .*VIEW_FIELDS"):
        GarmentDataset(worn_folder, fields=("meta", "verts", "faces"), transform=made)[0]


@pytest.mark.parametrize(
    ("page", "made", "smaller", "printed"),
    [
        (
            "pictures",
            Views(n=1, size=32, seed=0, device="cpu", maps=(*MAPS, *VERTEX_MAPS)),
            ("size=256", 'size=32, device="cpu"'),
            "torch.Size([1, 4, 32, 32, 3]) torch.Size([1, 4, 32, 32])",
        ),
        ("scans", scan(), ("batch_size=8", "batch_size=1"), "torch.Size([1, 4096, 6])"),
        ("sketches", sketch(), ("size=512", "size=48"), "torch.Size([1, 2, 48, 48])"),
    ],
)
def test_the_page_runs_and_lists_every_entry(
    page: str,
    made: Any,
    smaller: tuple[str, str],
    printed: str,
    worn: list[Sample],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    write_mapped(tmp_path / "garments", worn[:1])
    monkeypatch.chdir(tmp_path)
    text = (DOCS / f"{page}.md").read_text()
    for program in re.findall(r'```python title="\w+\.py"\n(.*?)```', text, re.DOTALL):
        exec(compile(program.replace(*smaller), page, "exec"), {})
    assert capsys.readouterr().out.splitlines()[0] == printed
    plain = GarmentDataset(tmp_path / "garments", fields=(*VIEW_FIELDS, "stretch", "gap", "pressure"))[0]
    assert set(re.findall(r"^\| `(\w+)` \| \w+ \(", text, re.MULTILINE)) == made(plain).keys() - plain.keys()


def test_the_rows_point_to_the_panels_of_the_garment_and_skin_is_measured_on_demand(worn_folder: Path) -> None:
    item = dataset(worn_folder)[0]
    made = scan(noise=NOISELESS)(item)
    middle = item["verts"].double()[item["faces"].long()].mean(dim=1)
    distance = torch.cdist(made["scan"][:, :3].double(), middle)
    nearest = item["panel_id"].long()[distance.argmin(dim=1)]
    assert (nearest == made["scan_panel_id"]).double().mean() > 0.85  # others lie near a seam
    made = scan(body=True)(item)
    assert (made["scan_panel_id"] == -1).any()
    assert (made["scan_panel_id"] >= 0).any()
    assert torch.isfinite(made["scan"]).all()


def test_lines_lie_on_the_border_of_the_garment(worn_folder: Path) -> None:
    """The camera projects the garment into the inked part of the picture, and fills it."""
    item = dataset(worn_folder)[0]
    made = sketch(size=256)(item)
    rt = made["sketch_rt"][0].double()
    seen = (item["verts"].double() @ rt[:, :3].T + rt[:, 3]) @ made["sketch_k"][0].double().T
    pixels = seen[:, :2] / seen[:, 2:]
    row, column = torch.nonzero(255 - made["sketch"][0].int() > 128, as_tuple=True)
    for axis, inked in ((0, column), (1, row)):
        assert inked.min().item() == pytest.approx(pixels[:, axis].min().item(), abs=2.5)
        assert inked.max().item() == pytest.approx(pixels[:, axis].max().item(), abs=2.5)


def test_turned_sketches_stay_within_their_limit(worn_folder: Path) -> None:
    turned = sketch(yaws=(90.0,), turn=40.0)(dataset(worn_folder)[0])
    away = -turned["sketch_rt"][0, 2, :3].numpy()
    assert 0 < abs(np.degrees(np.arctan2(away[0], away[2])) - 90.0) <= 40.0
