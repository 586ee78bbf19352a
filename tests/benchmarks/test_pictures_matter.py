"""The benchmark of picture inputs on a few coarse garments: held-out ranges, pictures, pool, training, report."""

import argparse
import csv
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from benchmarks.cases.render import embree_maps
from benchmarks.reconstruction.derived import FIRST_PANEL, SHOWN_CLASSES
from benchmarks.reconstruction.panel_net import NetConfig
from benchmarks.reconstruction.picture_inputs import (
    HELD_OUT,
    SIDES,
    TRAINING,
    Input,
    Rendered,
    Share,
    load_garment,
    rendered,
    views_of,
)
from benchmarks.reconstruction.picture_model import PictureNet
from benchmarks.reconstruction.picture_training import Pool, add_arguments, completed, gaps, load, pool_of, run, train
from benchmarks.run import main
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.maker import make
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.generator.render import Ranges, look_at
from gcd_dataset.generator.render.materials import LOOKS
from gcd_dataset.metrics import PatternScore
from gcd_dataset.records import Drape, Outcome
from gcd_dataset.shards import ShardReader, ShardWriter
from gcd_dataset.tensors import PANEL_LABELS

SIZE, SEED = 16, 5


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return stored_garments(tmp_path_factory.mktemp("garments"))


def stored_garments(where: Path) -> Path:
    """Five coarse garments at their start positions, stored as settled."""
    config = MakeConfig(resolution=8.0, picture=0, points=0, stage="mesh", device="cpu")
    with ShardWriter(where, seed=SEED, recipe=recipe_of(replace(config, stage="drape"))) as writer:
        for index in range(5):
            sample = make(SEED, index, config)
            assert sample.box_mesh is not None
            drape = Drape(sample.box_mesh.vertices, Outcome.SETTLED, 1, 0, 0, 1.0, 1.0)
            writer.write(replace(sample, drape=drape))
    return where


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def options(folder: Path, **changes: object) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    small = {"garments": str(folder), "size": SIZE, "device": "cpu", "width": 32, "layers": 1, "count": 5, "steps": 4}
    return completed(argparse.Namespace(**{**vars(parser.parse_args([])), **small, **changes}))


def share(folder: Path, *inputs: Input, readings: int = 1) -> Share:
    return Share(str(folder), (0, 1, 2), inputs, 0, SIZE, "cpu", readings, at_once=2)


# ---------------------------------------------------------------------------------------------------------- the inputs


INTERVALS: dict[str, Callable[[Ranges], tuple[float, float]]] = {
    "yaw": lambda ranges: ranges.camera.yaw,
    "pitch": lambda ranges: ranges.camera.pitch,
    "focal": lambda ranges: ranges.camera.focal,
    "azimuth": lambda ranges: ranges.lights.azimuth,
    "kelvin": lambda ranges: ranges.lights.kelvin,
    "contrast": lambda ranges: ranges.lights.contrast,
}


@pytest.mark.parametrize("name", INTERVALS)
def test_no_held_out_camera_or_light_is_drawn_in_training(name: str) -> None:
    (low, high), (least, most) = INTERVALS[name](TRAINING), INTERVALS[name](HELD_OUT)
    assert low < high
    assert least < most
    assert high <= least or most <= low


def test_no_held_out_cloth_skin_or_place_is_drawn_in_training() -> None:
    ours, theirs = TRAINING.appearance, HELD_OUT.appearance
    for name in ("prints", "looks", "tones"):
        assert not set(getattr(ours, name)) & set(getattr(theirs, name))
    weights = np.array([TRAINING.environment.weights, HELD_OUT.environment.weights])
    assert (weights.sum(axis=1) > 0).all()
    assert (weights.min(axis=0) == 0).all()
    # All kinds of cloth are used, and each held-out one may have a held-out print.
    assert set(ours.looks) | set(theirs.looks) == set(LOOKS)
    assert all(set(LOOKS[name].prints) & set(theirs.prints) for name in theirs.looks)


@pytest.mark.parametrize("what", [Input.GREY, Input.DRAWN, Input.HELD_OUT])
def test_the_first_view_shows_the_front_and_the_second_the_back(what: Input, folder: Path) -> None:
    garment = load_garment(ShardReader(folder, settled_only=True), 1)
    for epoch in range(5):
        _, (front, back) = views_of(what, 0, garment, 0, epoch)
        assert front.camera.eye[2] > 100 > -100 > back.camera.eye[2]  # the wearer faces +z
        assert front.appearance is back.appearance or what is Input.GREY


def test_every_reading_of_drawn_pictures_differs_and_plain_ones_are_the_same(folder: Path) -> None:
    batches = list(rendered(share(folder, Input.PLAIN, Input.DRAWN, readings=2)))
    seen: dict[tuple[Input, int], list[np.ndarray]] = {}
    for batch in batches:
        for position, pictures in zip(batch.positions.tolist(), batch.pictures, strict=True):
            seen.setdefault((batch.what, position), []).append(pictures)
    assert set(seen) == {(what, k) for what in (Input.PLAIN, Input.DRAWN) for k in (0, 1, 2)}
    for (what, _), (one, other) in seen.items():
        assert one.shape == (SIDES, SIZE, SIZE, 3)
        assert one.std() > 5
        assert (one == other).all() == (what is Input.PLAIN)


@pytest.mark.parametrize("what", Input)
def test_labels_tell_the_garment_in_a_picture(what: Input, folder: Path) -> None:
    batch = next(rendered(share(folder, what)))
    sample = ShardReader(folder, settled_only=True).sample(int(batch.positions[0]))
    is_cloth = batch.labels[0] >= FIRST_PANEL
    seen = {((label - FIRST_PANEL) // len(PANEL_LABELS)) for label in batch.labels[0][is_cloth].tolist()}
    assert len(seen) > 1
    assert seen <= set(range(len(sample.pattern.panels)))
    if what is Input.PLAIN:  # skin has one hue in the plain pictures, each panel its own
        is_skin = batch.labels[0] < FIRST_PANEL - 2
        rgb = batch.pictures[0].astype(float)
        hue = rgb / rgb.sum(axis=-1, keepdims=True)
        assert np.median(np.abs(hue[is_skin] - np.median(hue[is_skin], axis=0))) < 0.01
        assert 0.02 < np.mean(is_cloth) < 0.9


def test_pixel_losses_are_least_for_the_truth() -> None:
    net = PictureNet(NetConfig(width=32, heads=2, layers=1), views=1, size=8)
    labels = torch.full((1, 1, 8, 8), FIRST_PANEL, dtype=torch.uint8)
    labels[..., :4] = 0  # the trunk; neither it nor one panel alone has a border
    found = []
    for shown in (0, FIRST_PANEL):
        with torch.no_grad():
            net.of_pixels.weight.zero_()
            net.of_pixels.bias.copy_(torch.full_like(net.of_pixels.bias, -4.0))
            of_parts = net.of_pixels.bias.view(2, 2, SHOWN_CLASSES + 1)
            of_parts[:, 0, 0] = of_parts[:, 1, shown] = 4.0
            found.append(net.pixel_losses(torch.zeros(1, 1, 32), labels))
    assert found[1]["shown"] < 0.1 < 1.0 < found[0]["shown"]
    assert found[1]["borders"] < 0.1
    other = labels.clone()
    other[..., 4:, :] += len(PANEL_LABELS) * (other[..., 4:, :] > 0)  # the lower half of the cloth is another panel
    assert net.pixel_losses(torch.zeros(1, 1, 32), other)["borders"] > 2 * found[1]["borders"]


# ------------------------------------------------------------------------------------------------ pool, model, training


def test_a_pool_holds_the_latest_readings(folder: Path) -> None:
    def batches() -> Iterator[Rendered]:
        for k in range(0, 100, 2):
            pictures = np.zeros((2, SIDES, 8, 8, 3), np.uint8)
            pictures[:] = np.array([k, k + 1])[:, None, None, None, None]
            yield Rendered(Input.DRAWN, np.array([k, k + 1]), pictures, pictures[..., 0])

    targets = load(folder, options(folder)).targets[torch.zeros(100, dtype=torch.long)]
    pool = Pool(batches(), replace(targets, slimness=torch.arange(100.0)), 4, 8, fresh=2)
    pool.receive(3)
    assert pool.added == 4
    pool.receive(1)
    assert pool.added == 4
    pool.advance(0)
    batch = pool.batch(torch.zeros(64))
    assert set(batch.slimness.tolist()) == {2, 3, 4, 5}
    assert torch.equal(batch.pictures[:, 1, 0, 0, 2].float(), batch.slimness)
    assert torch.equal(batch.shown[:, 1, 0, 0].float(), batch.slimness)


def test_the_same_seed_trains_the_same_network(folder: Path) -> None:
    args = options(folder, steps=2)
    data = load(folder, args)
    assert sorted([*data.known, *data.unseen]) == [0, 1, 2, 3, 4]
    runs = []
    for _ in range(2):
        with pool_of(Input.PLAIN, data, args) as pool:
            runs.append([row["loss"] for row in train(pool, data, args.steps, args)[1]])
    assert runs[0] == runs[1]


# ----------------------------------------------------------------------------------------------------------- the report


def test_gaps_are_differences_in_points() -> None:
    def score(iou: float) -> PatternScore:
        return PatternScore(1, 1, 0.5, iou, *[0.0] * 15)

    mean, low, high = gaps([score(0.8), score(0.6)], [score(0.5), score(0.4)])
    assert mean == pytest.approx({"panel_count_acc": 0.0, "edge_count_acc": 0.0, "iou": 25.0})
    assert low["iou"] == pytest.approx(20.0)
    assert high["iou"] == pytest.approx(30.0)


@pytest.mark.long
def test_the_case_reports_and_a_repeated_call_continues(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, report = tmp_path / "out", tmp_path / "report.md"
    flags = ["--garments", str(folder), "--out", str(out), "--count", "4", "--steps", "1", "--size", "8"]
    flags += ["--device", "cpu", "--width", "32", "--layers", "1", "--report", str(report)]
    assert main(["pictures_matter", "--inputs", "drawn", *flags]) == 0
    assert main(["pictures_matter", "--inputs", "drawn,plain", *flags]) == 0
    said = capsys.readouterr()
    assert "drawn: read from" in said.err
    for name in ("gap_to_plain_on_held_out_iou", "drawn_on_grey_panel_count_acc", "drawn_waiting"):
        assert f"pictures_matter.{name} " in said.out
    with (out / "curves.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["input"] for row in rows] == ["drawn", "plain"]
    assert len(json.loads((out / "plain.json").read_text())["scores"]["held_out"]) == 1
    assert "gap_to_plain_on_drawn_iou," in (out / "figures.csv").read_text()
    assert (out / "inputs.jpg").stat().st_size > 1000
    assert "| held_out | drawn |" in report.read_text()
    with pytest.raises(ConfigError, match="results of other options: give another --out"):
        run(options(folder, out=str(out), count=4, steps=3, size=8))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"size": 60}, "--size 60: give a multiple of 8"),
        ({"inputs": "plain,blue"}, "--inputs plain,blue: give some of drawn,plain,grey"),
        ({"count": 2}, "--count of 4 or more"),
    ],
)
def test_invalid_options_are_refused(changes: dict[str, object], expected: str, folder: Path) -> None:
    with pytest.raises(ConfigError, match=expected):
        options(folder, **changes)


# --------------------------------------------------------------------------------------------------------------- render


def test_embrees_depth_and_shadow_of_a_ball() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=20.0)
    camera = look_at(np.array([0.0, 0.0, 200.0]), np.zeros(3), focal=4.0)
    light = np.array([1.0, 0.0, 0.0])
    depth, lit = embree_maps(np.asarray(ball.vertices), np.asarray(ball.faces), camera, light, 65)
    assert depth[32, 32] == pytest.approx(180.0, abs=0.05)
    assert np.isinf(depth[0, 0])
    assert lit[32, 45] and not lit[32, 20]
