"""Files, box meshes, bodies and drapes of the evaluator."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.reconstruction.garments import GarmentSet, generated
from benchmarks.reconstruction.judging import Patterns, draw_mesh, judge_of
from benchmarks.reconstruction.models.baselines import box_mesh, mean_measures, nearest_labels, nearest_measures
from benchmarks.reconstruction.models.measures import scans_of
from benchmarks.reconstruction.tasks import task_named
from gcd_dataset.generator.lay_plan import PALETTE
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.measurements import ANGLES, MEASURES
from gcd_dataset.metrics import score_measures
from gcd_dataset.scoring.bodies import wearers_of
from gcd_dataset.scoring.distances import read_shape
from gcd_dataset.spec import read_pattern
from tests.benchmarks.reconstruction.conftest import SKIRTS
from tests.benchmarks.reconstruction.toys import small

CPU = torch.device("cpu")


@pytest.mark.parametrize(("task", "answer"), [("T4", nearest_labels), ("T5", mean_measures), ("T6", box_mesh)])
def test_answers_are_drawn_and_written(
    task: str, answer: Callable[..., list[Any]], draped: GarmentSet, tmp_path: Path
) -> None:
    answers, judge = answer(draped, draped, device=CPU), judge_of(task_named(task), watching=True)
    assert judge.picture(answers, draped).ndim == 3
    judge.write(answers, draped, tmp_path)
    assert {path.stem for path in (tmp_path / "predictions").iterdir()} == set(draped.keys)
    assert len(judge.scores(answers, draped)) == len(draped)


def test_the_nearer_of_two_faces_is_seen() -> None:
    low, high = np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0]], float), np.array([[0, 0, 5], [9, 0, 5], [0, 9, 5]], float)
    vertices, faces = np.concatenate([low, high]), np.array([[0, 1, 2], [3, 4, 5]])
    picture = draw_mesh(vertices, faces, np.array([0, 1]), frame=vertices, size=60)
    assert np.allclose(picture[35, 25] / 255, PALETTE[1], atol=0.02)


def test_the_evaluator_reads_inputs_and_bodies_of_draped_garments(tmp_path: Path) -> None:
    garments = generated(2, 0, points=512, extra=("pose",), drape=None, resolution=8.0, design=SKIRTS)
    truth = [garments.pattern(k) for k in range(2)]
    Patterns(draped=True).write(truth, garments, tmp_path)
    wearers = wearers_of(str(tmp_path / "bodies"))
    for key, pattern in zip(garments.keys, truth, strict=True):
        assert read_pattern(tmp_path / "truth" / f"{key}.json").extra["properties"]["kind"] == "skirt"
        shape = read_shape(tmp_path / "inputs" / f"{key}.npy")
        assert shape is not None
        points = shape.samples
        places = build_box_mesh(pattern, spacing=8.0).vertices
        assert np.abs(np.ptp(points, axis=0) - np.ptp(places, axis=0)).max() < 5.0
        assert np.abs(points.max(axis=0) - places.max(axis=0)).max() < 5.0
        assert 140.0 < wearers.wearer(key, legs_apart=False)[1].height < 210.0
    Patterns().write(truth, garments, tmp_path / "flat")
    assert not (tmp_path / "flat" / "inputs").exists()


def test_lengths_and_angles_have_errors_of_their_own() -> None:
    true = np.full(len(MEASURES), 40.0)
    answer = true + [3.0 if name in ANGLES else -2.0 for name in MEASURES]
    score = score_measures(answer, true)
    assert (score.error_cm, score.error_degrees, score.waist) == (2, 3, 2)
    with pytest.raises(ValueError, match="25 measures"):
        score_measures(answer[1:], true)


def test_the_references_answer_from_known_bodies(draped: GarmentSet) -> None:
    mean = mean_measures(draped, draped, device=CPU)
    assert np.allclose(mean[0], draped.measures.mean(axis=0), atol=1e-3)
    for k, answer in enumerate(nearest_measures(draped, draped, device=CPU)):
        assert np.allclose(answer, draped.measures[k])


def test_scans_show_cloth_and_skin(draped: GarmentSet) -> None:
    for scan in scans_of(draped):
        heights = 100 * scan[:, 1] + 100
        on_cloth = scan[:, 6] > 0
        assert 0.05 < on_cloth.float().mean() < 0.95
        assert heights.min() > -2
        assert heights[~on_cloth].max() > heights[on_cloth].max()  # skirts end below the head


def test_measures_are_answered_from_all_points_of_a_scan(draped: GarmentSet) -> None:
    net: Any = small("measures", augmented=1)
    batch = net.prepare(draped, device=CPU).batch(torch.arange(2))
    moved = batch.points.clone()
    moved[:, net.config.points :, 1] += 0.5
    assert not np.allclose(net.predict(batch), net.predict(replace(batch, points=moved)))
