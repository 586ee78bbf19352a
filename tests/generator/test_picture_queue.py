"""Each reply has the pictures of its own garment."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gcd_dataset.generator.body import walk
from gcd_dataset.generator.drape import DrapeJob
from gcd_dataset.generator.drapers import DrapeReply, DrapeRequest
from gcd_dataset.generator.drapers.draper import make_reply
from gcd_dataset.generator.drapers.pictures import PictureQueue
from gcd_dataset.generator.pipeline import prepare
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.generator.render import render_garment
from gcd_dataset.records import Drape, Outcome
from gcd_dataset.shards import decode_sample, encode_sample
from gcd_dataset.shards.layout import garments_layout
from tests.generator.drape.garments import still
from tests.loaders import rendered

GARMENTS = MakeConfig(stage="mesh", bodies="both", resolution=10.0)


@pytest.fixture(scope="module")
def jobs() -> list[DrapeJob]:
    worn = [worn for number in range(2) for worn in prepare(1, number, GARMENTS).dressed]
    return [DrapeJob(one.box_mesh, one.body, one.size) for one in worn if one.box_mesh]


def assert_own_pictures(replies: list[DrapeReply], requests: list[DrapeRequest]) -> None:
    """One reply for each request, with its garment from front and back."""
    by_number = {reply.number: reply for reply in replies}
    assert len(by_number) == len(replies) == len(requests)
    for request in requests:
        mesh, body, reply = request.job.box_mesh, request.job.body, by_number[request.number]
        assert np.array_equal(reply.drape.vertices, rendered.start_of(request).vertices)
        if not request.picture:
            assert reply.pictures is None
            continue
        alone = render_garment(reply.drape.vertices, mesh, body, size=request.picture, device="cpu")
        assert reply.pictures is not None
        assert all(map(np.array_equal, reply.pictures, alone))


def replies_to(requests: list[DrapeRequest], drapes: list[Drape]) -> list[DrapeReply]:
    replies: list[DrapeReply] = []
    queue = PictureQueue("cpu")
    for request, drape in zip(requests, drapes, strict=True):
        queue.add(request, drape, replies.append)
    queue.flush()
    return replies


@pytest.mark.parametrize("batch_size", [1, 3])
def test_every_garment_gets_its_own_pictures(
    jobs: list[DrapeJob], batch_size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For any batch size; picture sizes vary, and some requests ask for no pictures."""
    monkeypatch.setattr(PictureQueue, "_batch_size", lambda *_: batch_size)
    sizes = [24, 24, 32, 0, 24, 24, 24, 0]
    requests = [DrapeRequest(number, jobs[number % len(jobs)], picture=size) for number, size in enumerate(sizes)]
    replies = replies_to(requests, list(map(rendered.start_of, requests)))
    assert_own_pictures(replies, requests)
    pictured = [reply.number for reply in replies if reply.pictures]
    assert pictured == sorted(pictured)


def test_pictures_do_not_wait_for_a_full_batch(jobs: list[DrapeJob]) -> None:
    """``advance`` renders and replies while other garments drape."""
    replies: list[DrapeReply] = []
    queue, request = PictureQueue("cpu"), DrapeRequest(7, jobs[0], picture=24)
    queue.add(request, rendered.start_of(request), replies.append)
    for _ in range(2):
        queue.advance()
    assert_own_pictures(replies, [request])
    queue.advance()
    queue.flush()
    assert len(replies) == 1


@pytest.mark.parametrize("size", [0, 24])
def test_a_garment_in_motion_goes_on_from_its_drape(
    jobs: list[DrapeJob], monkeypatch: pytest.MonkeyPatch, size: int
) -> None:
    """With pictures and without."""
    monkeypatch.setattr("gcd_dataset.generator.drape.drape.drape_on", still)
    request = DrapeRequest(7, jobs[0], picture=size, motion=tuple(walk()[:3]))
    [reply] = replies_to([request], [rendered.start_of(request)])
    assert reply.motion and reply.motion.poses == request.motion
    assert (reply.pictures is None) == (size == 0)


def test_motions_begin_together(jobs: list[DrapeJob], monkeypatch: pytest.MonkeyPatch) -> None:
    """A garment without a motion, and one that fell, do not wait for them; the last ones do not wait for more."""
    monkeypatch.setattr("gcd_dataset.generator.drape.drape.drape_on", still)
    monkeypatch.setattr(PictureQueue, "_most_moving", lambda _: 2)
    moving = DrapeRequest(0, jobs[0], motion=tuple(walk()[:3]))
    replies: list[DrapeReply] = []
    queue, rest = PictureQueue("cpu"), rendered.start_of(moving)
    queue.add(moving, rest, replies.append)
    queue.add(replace(moving, number=1), replace(rest, outcome=Outcome.FELL), replies.append)
    queue.add(replace(moving, number=2, motion=()), rest, replies.append)
    assert [(reply.number, reply.motion and len(reply.motion.poses)) for reply in replies] == [(1, 0), (2, None)]
    for number in (3, 4):
        queue.add(replace(moving, number=number), rest, replies.append)
    assert [reply.number for reply in replies[2:]] == [0, 3]
    queue.flush()
    assert replies[-1].number == 4
    assert all(reply.motion and reply.motion.poses == moving.motion for reply in replies[2:])


def test_a_motion_does_not_wait_for_ever(jobs: list[DrapeJob], monkeypatch: pytest.MonkeyPatch) -> None:
    """While the garments of others, which do not move, arrive without end."""
    monkeypatch.setattr("gcd_dataset.generator.drape.drape.drape_on", still)
    monkeypatch.setattr(PictureQueue, "_most_moving", lambda _: 2)
    monkeypatch.setattr("gcd_dataset.generator.drapers.pictures.PATIENCE", 3)
    replies: list[DrapeReply] = []
    queue = PictureQueue("cpu")
    for number in range(5):
        request = DrapeRequest(number, jobs[0], motion=tuple(walk()[:3]) if number == 1 else ())
        queue.add(request, rendered.start_of(request), replies.append)
    assert [reply.number for reply in replies] == [0, 2, 3, 4, 1]


def test_every_garment_gets_its_own_views(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also beside a diverged drape, which has none, and beside garments that ask for none."""
    monkeypatch.setattr(PictureQueue, "_batch_size", lambda *_: 2)
    asked = rendered.requests(3)
    asked += [replace(asked[0], number=3, picture=24), replace(asked[1], number=4, views=None)]
    drapes = [rendered.start_of(request) for request in asked]
    drapes[1] = rendered.diverged(asked[1])
    by_number = {reply.number: reply for reply in replies_to(asked, drapes)}
    for request, drape in zip(asked, drapes, strict=True):
        alone, reply = make_reply(request, drape, "cpu"), by_number[request.number]
        assert len(reply.views) == len(alone.views) == (2 if request.number in (0, 2, 3) else 0)
        for view, other in zip(reply.views, alone.views, strict=True):
            assert np.array_equal(view.rgb, other.rgb)
            assert view.facts == other.facts
        assert (reply.pictures is None) == (not request.picture)
    assert len({view.rgb.tobytes() for number in (0, 2) for view in by_number[number].views}) == 4


def test_a_diverged_drape_has_members_of_the_same_kind() -> None:
    [request, other] = rendered.requests(2)
    pairs = (request, rendered.diverged(request)), (other, rendered.start_of(other))
    lost, shown = (rendered.sample_of(make_reply(*pair, "cpu")) for pair in pairs)
    members = garments_layout(views=2, sides=False).members
    assert tuple(encode_sample(lost)) == tuple(encode_sample(shown)) == members
    assert kinds(lost.views[0].facts) == kinds(shown.views[0].facts)
    assert decode_sample(encode_sample(lost)).views == lost.views


def kinds(value: Any) -> Any:
    """The types of a JSON value; of a list those of its first entry."""
    if isinstance(value, Mapping):
        return {name: kinds(entry) for name, entry in value.items()}
    return [kinds(value[0])] if isinstance(value, list) else type(value)
