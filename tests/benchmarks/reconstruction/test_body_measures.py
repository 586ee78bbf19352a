"""Measures from scans of dressed persons: scores, references, and what the augmentation keeps."""

import numpy as np
import pytest
import torch

from benchmarks.reconstruction.garments import GarmentSet
from benchmarks.reconstruction.judging import score_measures
from benchmarks.reconstruction.models import baselines
from benchmarks.reconstruction.models.baselines import mean_measures, nearest_measures
from benchmarks.reconstruction.models.measures import build, scans_of
from gcd_dataset.errors import ConfigError
from gcd_dataset.measurements import ANGLES, MEASURES

CPU = torch.device("cpu")


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


def test_unknown_sizes_are_refused() -> None:
    with pytest.raises(ConfigError, match="no size depth of measures"):
        build(smoke=True, options={"depth": 3})
