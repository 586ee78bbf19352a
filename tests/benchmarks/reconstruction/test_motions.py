"""Garments in motion: cloth that moves with the skin, what the model adds to it, and how both are counted."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.reconstruction.drapes import DrapedVertices, asked, counted, truth_of
from benchmarks.reconstruction.garments import GarmentSet, generated
from benchmarks.reconstruction.judging import judge_of
from benchmarks.reconstruction.models.baselines import frozen, skinned
from benchmarks.reconstruction.tasks import TASKS
from benchmarks.reconstruction.wearers import box_mesh_of, measurements_of, wearer_of
from gcd_dataset.generator.body.pose import pose_body
from gcd_dataset.generator.drape import DrapeJob
from gcd_dataset.loaders import GeneratedGarments
from gcd_dataset.scoring.draping import crossings_of
from gcd_dataset.scoring.inputs import EVERY, poses_of
from tests.benchmarks.reconstruction.toys import small

CPU = torch.device("cpu")
TROUSERS = {"meta": {"upper": "none", "bottom": "Pants"}}


@pytest.fixture(scope="module")
def making(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Options of trousers on a body that walks."""
    making = {"resolution": 8.0, "design": TROUSERS, "device": "cpu", "picture": 0, "points": 1, "on_fail": "keep"}
    return {**TASKS["T8"].options, **making, "cache_dir": tmp_path_factory.mktemp("walking")}


@pytest.fixture(scope="module")
def walking(making: dict[str, Any]) -> GarmentSet:
    return generated(1, 0, extra=TASKS["T8"].extra, **making)


def test_trousers_move_with_the_skin(walking: GarmentSet, tmp_path: Path) -> None:
    """The truth has no error, trousers that stay as they were a large one, those moved with the skin a smaller one."""
    judge, true = judge_of(TASKS["T8"], watching=True), truth_of(walking, 0)
    answers = [DrapedVertices(true, 0.0), *frozen(walking, walking, device=CPU), *skinned(walking, walking, device=CPU)]
    exact, still, moved = (judge.scores([answer], walking)[0].error_cm for answer in answers)
    assert exact == 0
    assert moved < 0.7 * still
    np.testing.assert_allclose(answers[2].vertices[0], true[0], atol=1e-3)  # the first frame is given
    judge.write(answers[2:], walking, tmp_path)
    with np.load(next((tmp_path / "predictions").iterdir())) as file:
        assert file["vertices"].shape == true.shape
    assert judge.picture(answers[2:], walking).ndim == 3


def test_an_untrained_model_answers_as_the_skin_moves(walking: GarmentSet) -> None:
    model = small("motion_residual").eval()
    [answer] = model.answers(model.prepare(walking, device=CPU), 1, batch=1)
    [moved] = skinned(walking, walking, device=CPU)
    np.testing.assert_allclose(answer.vertices, moved.vertices, atol=1e-3)


def test_a_whole_turn_of_the_wearer_turns_the_cloth(walking: GarmentSet) -> None:
    """A body that turns without a bend carries the garment with it."""
    turns = walking.ragged["turns"]
    rows = np.repeat(turns.rows[:1], len(turns.rows), axis=0)
    rows[1:, 0] += [0.0, 0.0, 0.5]  # the pelvis, on which all bones turn
    turned = replace(walking, ragged={**walking.ragged, "turns": replace(turns, rows=rows)})
    [moved] = skinned(walking, turned, device=CPU)
    first, last = moved.vertices[0], moved.vertices[-1]
    spans = [np.linalg.norm(place[:, None] - place[None], axis=2) for place in (first, last)]
    assert np.abs(spans[1] - spans[0]).max() < 1e-2
    assert np.linalg.norm(last - first, axis=1).max() > 2.0


def test_crossings_of_a_motion_are_those_of_its_frames(walking: GarmentSet) -> None:
    """The moved skin counts as a body that was built in the pose does."""
    [still] = frozen(walking, walking, device=CPU)
    [counts] = counted([still.vertices], walking, device="cpu")
    body = pose_body(wearer_of(walking, 0), poses_of(walking.ragged["turns"][0].astype(float))[-1])
    job = DrapeJob(box_mesh_of(walking, 0), body, measurements_of(walking, 0))
    assert [counts[-1]] == list(crossings_of([job], asked(still.vertices)[-1:], device="cpu"))
    assert sum(counts[-1]) > 0


def test_generated_garments_hold_whole_motions(walking: GarmentSet, making: dict[str, Any]) -> None:
    found = GeneratedGarments(1, 0, fields=("motion_verts", "motion_pose"), dtype=None, **making)[0]
    np.testing.assert_array_equal(found["motion_verts"][::EVERY], truth_of(walking, 0))
    assert found["motion_pose"].shape == (len(found["motion_verts"]), 21, 3)
    assert "motion_verts" not in GeneratedGarments(1, 0, **making).fields
