"""Answers as scores, pictures and files."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.reconstruction.garments import GarmentSet, generated
from benchmarks.reconstruction.judging import Patterns, draw_mesh, intervals, judge_of, means_of, score_measures
from benchmarks.reconstruction.models import baselines
from benchmarks.reconstruction.models.baselines import box_mesh, mean_measures, nearest_labels, nearest_measures
from benchmarks.reconstruction.models.measures import build, scans_of
from benchmarks.reconstruction.scoring.bodies import wearers_of
from benchmarks.reconstruction.scoring.distances import read_shape
from benchmarks.reconstruction.tasks import task_named
from benchmarks.reconstruction.vertex_labels import VertexLabels
from gcd_dataset.generator.lay_plan import PALETTE
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.measurements import ANGLES, MEASURES
from gcd_dataset.metrics import PatternScore, bootstrap_interval, mean_scores, score_pattern
from gcd_dataset.spec import read_pattern
from tests.benchmarks.reconstruction.conftest import SKIRTS

CPU = torch.device("cpu")


def test_means_and_intervals_are_those_of_the_metrics(six: GarmentSet) -> None:
    scores = [score_pattern(six.pattern(k), six.pattern(0)) for k in range(len(six))]
    low, high = bootstrap_interval(scores, np.random.default_rng(0))
    means = mean_scores(scores)
    assert means_of(scores) == pytest.approx(vars_of(means))
    found = intervals(scores)
    for name in PatternScore.__dataclass_fields__:
        assert found[name] == pytest.approx([getattr(score, name) for score in (means, low, high)])


def vars_of(score: PatternScore) -> dict[str, float]:
    return {name: getattr(score, name) for name in PatternScore.__dataclass_fields__}


def files_in(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def test_labels_are_drawn_and_written(draped: GarmentSet, tmp_path: Path) -> None:
    answers, judge = nearest_labels(draped, draped, device=CPU), judge_of(task_named("T4"))
    right, wrong = (
        judge.picture(answers, draped),
        judge.picture(
            [VertexLabels(answer.panels * 0, answer.classes, answer.seams, answer.edges) for answer in answers], draped
        ),
    )
    assert right.shape == wrong.shape
    assert not np.array_equal(right, wrong)
    judge.write(answers, draped, tmp_path)
    assert sorted(judge.files(draped)) == files_in(tmp_path)
    stored = np.load(tmp_path / "predictions" / f"{draped.keys[0]}.npz")
    assert np.array_equal(stored["panels"], answers[0].panels)


def test_measures_are_drawn_and_written(draped: GarmentSet, tmp_path: Path) -> None:
    answers, judge = mean_measures(draped, draped, device=CPU), judge_of(task_named("T5"))
    assert judge.picture(answers, draped).ndim == 3
    judge.write(answers, draped, tmp_path)
    assert sorted(judge.files(draped)) == files_in(tmp_path)
    stored = json.loads((tmp_path / "predictions" / f"{draped.keys[1]}.json").read_text())
    assert list(stored) == list(MEASURES)
    assert [score.error_cm for score in judge.scores(answers, draped)] == pytest.approx(
        [score.error_cm for score in judge.scores(answers[::-1], draped)]
    )


def test_drapes_are_drawn_and_written(draped: GarmentSet, tmp_path: Path) -> None:
    answers, judge = box_mesh(draped, draped, device=CPU), judge_of(task_named("T6"), watching=True)
    assert judge.picture(answers, draped).ndim == 3
    judge.write(answers, draped, tmp_path)
    assert sorted(judge.files(draped)) == files_in(tmp_path)
    stored = np.load(tmp_path / "predictions" / f"{draped.keys[0]}.npz")
    assert np.allclose(stored["vertices"], draped.ragged["box"][0])
    assert {score.self_crossings for score in judge.scores(answers, draped)} == {0}


def test_the_nearer_of_two_faces_is_seen() -> None:
    low, high = np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0]], float), np.array([[0, 0, 5], [9, 0, 5], [0, 9, 5]], float)
    vertices, faces = np.concatenate([low, high]), np.array([[0, 1, 2], [3, 4, 5]])
    picture = draw_mesh(vertices, faces, np.array([0, 1]), frame=vertices, size=60)
    assert np.allclose(picture[35, 25] / 255, PALETTE[1], atol=0.02)


def test_the_evaluator_reads_inputs_and_bodies_of_draped_garments(tmp_path: Path) -> None:
    garments = generated(2, 0, points=512, extra=("pose",), drape=None, resolution=8.0, design=SKIRTS)
    truth = [garments.pattern(k) for k in range(2)]
    Patterns(draped=True).write(truth, garments, tmp_path)
    assert sorted(Patterns(draped=True).files(garments)) == files_in(tmp_path)
    wearers = wearers_of(str(tmp_path / "bodies"))
    for key, pattern in zip(garments.keys, truth, strict=True):
        assert read_pattern(tmp_path / "truth" / f"{key}.json").extra["properties"]["kind"] == "skirt"
        points = read_shape(tmp_path / "inputs" / f"{key}.npy").samples
        places = build_box_mesh(pattern, spacing=8.0).vertices
        assert np.abs(np.ptp(points, axis=0) - np.ptp(places, axis=0)).max() < 5.0
        assert np.abs(points.max(axis=0) - places.max(axis=0)).max() < 5.0
        assert 140.0 < wearers.wearer(key, legs_apart=False)[1].height < 210.0
    Patterns().write(truth, garments, tmp_path / "flat")
    assert not (tmp_path / "flat" / "inputs").exists()
    assert sorted(Patterns().files(garments)) == files_in(tmp_path / "flat")


def test_lengths_and_angles_have_errors_of_their_own() -> None:
    true = np.full(len(MEASURES), 40.0)
    answer = true + [3.0 if name in ANGLES else -2.0 for name in MEASURES]
    score = score_measures(answer, true)
    assert (score.error_cm, score.error_degrees, score.waist) == (2, 3, 2)
    with pytest.raises(ValueError, match="25 measures"):
        score_measures(answer[1:], true)


def test_the_references_answer_from_known_bodies(draped: GarmentSet, monkeypatch: pytest.MonkeyPatch) -> None:
    scans = scans_of(draped)
    monkeypatch.setattr(baselines, "scans_of", lambda garments, workers: scans)
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


def test_persons_grow_with_their_lengths(draped: GarmentSet) -> None:
    examples = build(smoke=True, options={"augmented": 1}).prepare(draped, device=CPU)
    rows = torch.arange(2)
    plain, grown = examples.batch(rows), examples.batch(rows, torch.Generator().manual_seed(1))
    growth = grown.measures / plain.measures
    angles = torch.tensor([name in ANGLES for name in MEASURES])
    assert torch.allclose(growth[:, angles], torch.ones(()))
    lengths = growth[:, ~angles]
    assert torch.allclose(lengths, lengths[:, :1].expand_as(lengths))
    for k in range(2):
        tall, short = (float((batch.points[k, :, 1] + 1).max()) for batch in (grown, plain))
        assert tall / short == pytest.approx(float(lengths[k, 0]), abs=0.02)


def test_answers_start_at_the_mean_of_the_training_set(draped: GarmentSet) -> None:
    learner = build(smoke=True, options={})
    examples = learner.prepare(draped, device=CPU)
    for part in learner.head.parameters():
        torch.nn.init.zeros_(part)
    assert np.allclose(learner.predict(examples.batch(torch.arange(2))), draped.measures.mean(axis=0), atol=1e-2)
    learner.prepare(draped.select([0]), device=CPU)  # later sets change nothing
    assert np.allclose(learner.mean.numpy(), draped.measures.mean(axis=0), atol=1e-2)


def test_a_scan_depends_on_its_garment_alone(draped: GarmentSet) -> None:
    assert torch.equal(scans_of(draped.select([1]))[0], scans_of(draped)[1])
