"""Task T7: the truth of size and ease, and its network."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.reconstruction.derived import FIRST_PANEL, FIT
from benchmarks.reconstruction.garments import GarmentSet, Ragged, generated
from benchmarks.reconstruction.judging import FitScore, judge_of, score_fit
from benchmarks.reconstruction.models.baselines import mean_measures, nearest_fit
from benchmarks.reconstruction.options import Config
from benchmarks.reconstruction.tasks import MISFIT, task_named
from benchmarks.reconstruction.train import train
from gcd_dataset.scoring.inputs import PICTURE_SIZE, PICTURES
from tests.benchmarks.reconstruction.toys import small

CPU = torch.device("cpu")
SHIRTS: dict[str, Any] = {"meta": {"upper": "FittedShirt", "bottom": "none"}, "left": {"enable_asym": False}}


def test_each_size_more_adds_the_ease_of_a_size() -> None:
    """Sizes of the chart differ by about 4 cm in bust and waist."""
    options = {**MISFIT, "drape": None, "resolution": 5.0, "design": SHIRTS}
    fits = [
        generated(3, 0, points=0, extra=("fit",), **{**options, "misfit": step}).ragged["fit"].rows
        for step in ("0:0", "3:3")
    ]
    assert [fit[:, 0].tolist() for fit in fits] == [[0, 0, 0], [2, 3, 3]]  # the first wearer has the last size but two
    more = (fits[1] - fits[0])[:, 1:] / fits[1][:, :1]
    assert np.isfinite(more).sum() >= 3
    assert np.nanmin(more) > 2.5
    assert np.nanmax(more) < 5.5


@pytest.fixture
def painted(six: GarmentSet) -> GarmentSet:
    """Six garments with grey pictures: the lighter, the larger; none has cloth at the hips."""
    shape = (PICTURES, PICTURE_SIZE, PICTURE_SIZE)
    pictures = [np.full((*shape, 3), 40 * k, np.uint8) for k in range(6)]
    fits = [np.array([[k - 3, 2.0 * k, np.nan if k == 1 else 10 - k, np.nan]], np.float32) for k in range(6)]
    ragged: dict[str, list[np.ndarray]] = {
        "pictures": pictures,
        "shown": [np.full(shape, FIRST_PANEL, np.uint8)] * 6,
        "fit": fits,
    }
    return replace(six, ragged={**six.ragged, **{name: Ragged.of(rows) for name, rows in ragged.items()}})


@pytest.mark.long
def test_the_network_learns_size_and_ease(painted: GarmentSet) -> None:
    """Rings without cloth teach nothing, and an answer has a number for each ring."""
    learner = small("fit", views=1, width=32, heads=2)
    examples = learner.prepare(painted, device=CPU)
    config = Config(steps=60, batch=6, lr=3e-3, weight_decay=0.0, ema=0.9)
    trained = train(learner, examples, config, device=CPU).learner
    answers = list(trained.answers(examples, 6, batch=6))
    scores = judge_of(task_named("T7")).scores(answers, painted)
    mean = judge_of(task_named("T7")).scores(mean_measures(painted, painted, device=CPU), painted)
    assert all(np.isfinite(answer).all() for answer in answers)
    assert np.mean([score.error_cm for score in scores]) < 0.8 * np.mean([score.error_cm for score in mean])
    assert np.mean([score.error_sizes for score in scores]) < 0.8 * np.mean([score.error_sizes for score in mean])


def test_the_nearest_pictures_answer(painted: GarmentSet) -> None:
    """For a ring that their garment lacks, the mean of the known ones."""
    known, unseen = painted.select([0, 1, 4]), painted.select([2, 5])
    assert nearest_fit(known, unseen, device=CPU)[1].tolist() == [1, 8, 6, 0]
    assert nearest_fit(known, painted.select([1]), device=CPU)[0].tolist() == [-2, 2, 8, 0]


def test_only_rings_with_cloth_are_scored() -> None:
    true = np.array([-1.0, 3.0, np.nan, 7.0])
    assert score_fit(np.array([1.0, 5.0, 99.0, 7.0]), true) == FitScore(error_cm=1.0, error_sizes=2.0)
    with pytest.raises(ValueError, match=f"give 4 numbers: {', '.join(FIT)}"):
        score_fit(np.array([1.0, np.nan, 2.0, 3.0]), true)
