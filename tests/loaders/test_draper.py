"""The draping process: the same garments as without it, and what happens when it fails or is killed."""

import multiprocessing
import os
import shutil
import signal
import socket
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from gcd_dataset.errors import DrapeError
from gcd_dataset.generator.drape import DrapeJob
from gcd_dataset.generator.drapers import DrapeReply, DrapeRequest, SharedDraper, address_for
from gcd_dataset.generator.drapers.process import ClientConnection, RequestQueue
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.pipeline import sample_key
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.loaders import FreshGarments, GarmentLoader, GeneratedGarments, collate_list
from gcd_dataset.records import Outcome, Sample
from tests.loaders.draping import COUNT, OPTIONS, SKIRTS, Apart, drape_request, drapers, items, kill_drapers
from tests.loaders.test_shards import assert_all_same


@pytest.fixture(scope="module")
def made() -> list[dict[str, Any]]:
    return items()


def test_all_workers_share_one_draping_process(
    made: list[dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ds = Apart(COUNT, address_for("cpu"), cache_dir=tmp_path)
    loader = GarmentLoader(ds, 1, shuffle=False, num_workers=2, collate_fn=collate_list)
    assert_all_same(loader, [[item] for item in made])
    assert len(drapers(address_for("cpu"))) == 1
    monkeypatch.setattr(SharedDraper, "send", lambda draper, request: pytest.fail("draped again"))
    cached = GarmentLoader(ds, 1, shuffle=False, num_workers=2, collate_fn=collate_list)
    assert_all_same(cached, [[item] for item in made])


def test_workers_take_the_draping_processes_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    ds = Apart(COUNT, address_for("cpu"))
    ds._addresses = (address_for("cpu"), replace(address_for("cpu"), folder=Path("other")))
    found = []
    for number in range(3):
        monkeypatch.setattr("gcd_dataset.loaders.generated.get_worker_info", lambda worker=number: Mock(id=worker))
        found.append(ds._address)
    assert found == [*ds._addresses, ds._addresses[0]]


def test_a_stream_is_in_the_order_of_its_indices(made: list[dict[str, Any]]) -> None:
    ds = Apart(COUNT, address_for("cpu"))
    assert_all_same(ds.stream([2, 0, 2, 1]), [made[2], made[0], made[2], made[1]])


def made_ahead(
    indices: Iterable[int], config: MakeConfig, *, ahead: int, at_once: int | None = None
) -> Iterator[Sample]:
    with SharedDraper(address_for("cpu"), at_once=at_once or ahead) as draper:
        yield from produce(5, indices, config, draper=draper, ahead=ahead)


def test_the_bodies_of_a_design_are_draped_once(monkeypatch: pytest.MonkeyPatch) -> None:
    sent, send = [], SharedDraper.send

    def counted_send(draper: SharedDraper, request: DrapeRequest) -> None:
        sent.append(request.number)
        send(draper, request)

    monkeypatch.setattr(SharedDraper, "send", counted_send)
    ds = Apart(4, address_for("cpu"), bodies="both", fields=["verts", "front", "meta"])
    one_by_one = [ds[0], ds[1]]
    assert sent == [0, 1]
    assert_all_same(one_by_one, Apart(4, address_for("cpu"), bodies="both", fields=ds.fields).__getitems__([0, 1]))
    sent.clear()
    made = made_ahead([2, 3, 3, 2], ds.config, ahead=1)
    assert [sample.key for sample in made] == [sample_key(index) for index in (2, 3, 3, 2)]
    assert sent == [0, 1]


def test_a_failed_drape_is_retried_as_the_next_attempt(monkeypatch: pytest.MonkeyPatch) -> None:
    receive, numbers = SharedDraper.receive, []

    def failing_once(draper: SharedDraper) -> DrapeReply:
        reply = receive(draper)
        numbers.append(reply.number)
        fails = reply.number == 1
        # All others settle: the real outcomes of such a coarse mesh do not matter here.
        outcome = Outcome.NOT_SETTLED if fails else Outcome.SETTLED
        return replace(reply, drape=replace(reply.drape, outcome=outcome))

    monkeypatch.setattr(SharedDraper, "receive", failing_once)
    config = MakeConfig(resolution=10.0, device="cpu", picture=0, points=16, design=SKIRTS)
    made = made_ahead(range(3), config, ahead=2)
    rejects = [sample.provenance.rejects for sample in made]
    assert rejects[1][0] == "drape: not_settled"
    assert len(numbers) == sum(1 + len(reasons) for reasons in rejects)


def test_a_slow_drape_does_not_hold_up_later_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Up to ``ahead`` and ``at_once`` later drapes. The first request is answered once no other is pending."""
    sent, received, in_flight = set[int](), set[int](), []
    send, receive = SharedDraper.send, SharedDraper.receive
    slow: list[DrapeReply] = []

    def counted_send(draper: SharedDraper, request: DrapeRequest) -> None:
        sent.add(request.number)
        in_flight.append(len(sent - received))
        send(draper, request)

    def first_last(draper: SharedDraper) -> DrapeReply:
        if slow and sent - received == {0}:
            reply = slow.pop()
        else:
            reply = receive(draper)
            if reply.number == 0 and sent - received != {0}:
                slow.append(reply)
                return first_last(draper)
        received.add(reply.number)
        if reply.number == 0:
            assert sent == {0, 1, 2, 3, 4}
        return reply

    monkeypatch.setattr(SharedDraper, "send", counted_send)
    monkeypatch.setattr(SharedDraper, "receive", first_last)
    monkeypatch.setattr(SharedDraper, "poll", lambda draper: False)
    config = MakeConfig(resolution=10.0, device="cpu", picture=0, points=16, design=SKIRTS, on_fail="keep")
    made = made_ahead(range(6), config, ahead=5, at_once=3)
    assert [sample.key for sample in made] == [sample_key(index) for index in range(6)]
    assert max(in_flight) == 3


def test_the_next_request_is_sent_before_a_sample_is_yielded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Even if all earlier requests have replies: else the draper would run out of requests."""
    in_flight, send, receive = set[int](), SharedDraper.send, SharedDraper.receive

    def counted_send(draper: SharedDraper, request: DrapeRequest) -> None:
        in_flight.add(request.number)
        send(draper, request)

    def counted_receive(draper: SharedDraper) -> DrapeReply:
        reply = receive(draper)
        in_flight.discard(reply.number)
        return reply

    monkeypatch.setattr(SharedDraper, "send", counted_send)
    monkeypatch.setattr(SharedDraper, "receive", counted_receive)
    monkeypatch.setattr(SharedDraper, "poll", lambda draper: bool(in_flight))
    config = MakeConfig(resolution=10.0, device="cpu", picture=0, points=16, design=SKIRTS, on_fail="keep")
    made = made_ahead(range(4), config, ahead=3)
    assert [bool(in_flight) for _ in made] == [True, True, True, False]


def test_a_retry_is_draped_first() -> None:
    """Later samples wait for the retry."""
    queue, (ours, theirs) = RequestQueue(), multiprocessing.Pipe()
    connection = ClientConnection(ours, queue)
    one = drape_request(0)
    for number, retry in enumerate([False, False, True, False]):
        queue.put(connection, replace(one, number=number, retry=retry))
    jobs = queue._jobs()
    assert all(next(jobs) for _ in range(4))
    assert [request.number for _, request in queue._draping.values()] == [2, 0, 1, 3]
    theirs.close()


def test_a_connection_is_not_closed_while_it_is_read() -> None:
    """Else the OS reuses the descriptor for the next connection, and the reader reads from that connection."""
    ours, theirs = multiprocessing.Pipe()
    connection = ClientConnection(ours, RequestQueue())
    os.write(theirs.fileno(), b"half")
    with socket.socket(fileno=os.dup(theirs.fileno())) as half:
        half.shutdown(socket.SHUT_RD)  # the client reads no replies, but stays connected
    connection.reply("a reply")
    connection.finish()
    assert not ours.closed
    theirs.close()


def test_a_process_that_outlives_the_owner_creates_its_own_address(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gcd_dataset.generator.drapers.address._addresses", {})
    address = address_for("cpu")
    assert address_for("cpu") == address
    shutil.rmtree(address.folder)
    assert address_for("cpu").folder.is_dir()


def test_an_unknown_device_is_an_error_of_one_line() -> None:
    fresh = FreshGarments(GeneratedGarments(2, **{**OPTIONS, "device": "cuda:77"}), workers=1)
    with pytest.raises(DrapeError) as raised:
        next(iter(fresh))
    assert str(raised.value).startswith("unknown device 'cuda:77': choose one of auto, cpu")
    assert "Traceback" not in str(raised.value)


# The last two end the draping process that the tests above share.


def test_a_failing_draper_reports_the_error_and_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    """Even if another client does not read its replies."""
    address = address_for("cpu")
    monkeypatch.setattr(DrapeJob, "require_drapeable", lambda job: None)  # this process sends what it would refuse
    with SharedDraper(address) as deaf, SharedDraper(address) as draper:
        deaf.send(replace(drape_request(0), picture=400))
        assert deaf._connection.poll(120)  # its reply has begun; the unread rest blocks the draper's writer
        good = drape_request(1)
        torn = replace(good.job.box_mesh, labels={"strapless_top": np.array([10**6])})
        draper.send(replace(good, job=replace(good.job, box_mesh=torn)))
        with pytest.raises(
            DrapeError, match=r"draping on cpu: index 1000000 is out of bounds .*; start again, on other"
        ):
            draper.receive()
        with SharedDraper(address) as other:
            other.send(good)
            assert other.receive().number == 1


def test_a_killed_draper_is_an_error_and_the_next_client_starts_another() -> None:
    address = address_for("cpu")
    with SharedDraper(address) as draper:
        kill_drapers(address, signal.SIGSTOP)  # else the draper might reply before it is killed
        draper.send(drape_request(0))
        kill_drapers(address)
        with pytest.raises(DrapeError, match="drapes on cpu has ended"):
            draper.receive()
        with pytest.raises(DrapeError, match="drapes on cpu has ended"):
            draper.send(drape_request(1))
    with SharedDraper(address) as draper:
        draper.send(drape_request(7))
        assert draper.receive().number == 7
