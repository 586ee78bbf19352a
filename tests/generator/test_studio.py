"""The studio replies to each request with the draped garment and the requested pictures."""

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
    dressed = [wearer for number in range(2) for wearer in prepare(1, number, GARMENTS).dressed]
    return [DrapeJob(wearer.box_mesh, wearer.body, wearer.size) for wearer in dressed if wearer.box_mesh]


def at_rest(job: DrapeJob) -> Drape:
    """A drape that settled in its start position."""
    return Drape(job.box_mesh.vertices.astype(np.float32), Outcome.SETTLED, 1, 0, 0, 1.0, 1.0)


def assert_replies(replies: list[DrapeReply], requests: list[DrapeRequest]) -> None:
    """Each request has one reply, with its own garment from both sides."""
    by_number = {reply.number: reply for reply in replies}
    assert len(by_number) == len(replies) == len(requests)
    for request in requests:
        mesh, body, reply = request.job.box_mesh, request.job.body, by_number[request.number]
        assert np.array_equal(reply.drape.vertices, mesh.vertices.astype(np.float32))
        if not request.picture:
            assert reply.pictures is None
            continue
        alone = render_garment(reply.drape.vertices, mesh, body, size=request.picture, device="cpu")
        assert reply.pictures is not None
        assert all(map(np.array_equal, reply.pictures, alone))


@pytest.mark.parametrize("together", [1, 2, 3])
def test_every_garment_gets_its_own_pictures(
    jobs: list[DrapeJob], together: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For any batch size, with changing picture sizes and requests without pictures."""
    monkeypatch.setattr(Studio, "_together", lambda *_: together)
    sizes = [24, 24, 32, 0, 24, 24, 24, 0]
    requests = [DrapeRequest(number, jobs[number % len(jobs)], picture=size) for number, size in enumerate(sizes)]
    replies: list[DrapeReply] = []
    studio = Studio("cpu")
    for request in requests:
        studio.take(request, at_rest(request.job), replies.append)
    studio.finish()
    assert_replies(replies, requests)
    pictured = [reply.number for reply in replies if reply.pictures]
    assert pictured == sorted(pictured)


def test_a_garment_need_not_wait_for_the_next(jobs: list[DrapeJob]) -> None:
    """While others are draped, the pictures of settled garments are rendered and sent."""
    replies: list[DrapeReply] = []
    studio, request = Studio("cpu"), DrapeRequest(7, jobs[0], picture=24)
    studio.take(request, at_rest(request.job), replies.append)
    for _ in range(2):
        studio.go_on()
    assert_replies(replies, [request])
    studio.go_on()
    studio.finish()
    assert len(replies) == 1
