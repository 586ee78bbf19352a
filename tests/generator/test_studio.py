"""Garments at rest are answered with the pictures that were ordered."""

import numpy as np
import pytest

from gcd_dataset.generator.drape import DrapeJob
from gcd_dataset.generator.drapers import DrapeReply, DrapeRequest
from gcd_dataset.generator.drapers.studio import Studio
from gcd_dataset.generator.pipeline import prepare
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.generator.render import render_garment
from gcd_dataset.records import Drape, Outcome

GARMENTS = MakeConfig(stage="mesh", bodies="both", resolution=10.0)


@pytest.fixture(scope="module")
def jobs() -> list[DrapeJob]:
    worn = [worn for number in range(2) for worn in prepare(1, number, GARMENTS).dressed]
    return [DrapeJob(one.box_mesh, one.body, one.size) for one in worn if one.box_mesh]


def at_rest(job: DrapeJob) -> Drape:
    """As if it had settled where it was dressed."""
    return Drape(job.box_mesh.vertices.astype(np.float32), Outcome.SETTLED, 1, 0, 0, 1.0, 1.0)


def assert_answers(answers: list[DrapeReply], orders: list[DrapeRequest]) -> None:
    """Each with its own garment, from both sides."""
    by_number = {answer.number: answer for answer in answers}
    assert len(by_number) == len(answers) == len(orders)
    for order in orders:
        mesh, body, answer = order.job.box_mesh, order.job.body, by_number[order.number]
        assert np.array_equal(answer.drape.vertices, mesh.vertices.astype(np.float32))
        if not order.picture:
            assert answer.pictures is None
            continue
        alone = render_garment(answer.drape.vertices, mesh, body, size=order.picture, device="cpu")
        assert answer.pictures is not None
        assert all(map(np.array_equal, answer.pictures, alone))


@pytest.mark.parametrize("together", [1, 2, 3])
def test_every_garment_gets_its_own_pictures(
    jobs: list[DrapeJob], together: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However many are taken together, and though sizes change and some want none."""
    monkeypatch.setattr(Studio, "_together", lambda *_: together)
    sizes = [24, 24, 32, 0, 24, 24, 24, 0]
    orders = [DrapeRequest(number, jobs[number % len(jobs)], picture=size) for number, size in enumerate(sizes)]
    answers: list[DrapeReply] = []
    studio = Studio("cpu")
    for order in orders:
        studio.take(order, at_rest(order.job), answers.append)
    studio.finish()
    assert_answers(answers, orders)
    pictured = [answer.number for answer in answers if answer.pictures]
    assert pictured == sorted(pictured)


def test_a_garment_need_not_wait_for_the_next(jobs: list[DrapeJob]) -> None:
    """While others are draped, the pictures of those at rest are taken and handed out."""
    answers: list[DrapeReply] = []
    studio, order = Studio("cpu"), DrapeRequest(7, jobs[0], picture=24)
    studio.take(order, at_rest(order.job), answers.append)
    for _ in range(2):
        studio.go_on()
    assert_answers(answers, [order])
    studio.go_on()
    studio.finish()
    assert len(answers) == 1
