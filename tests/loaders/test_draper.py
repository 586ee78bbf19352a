"""The draping process: the same garments as without it, in order, each drape once."""

import multiprocessing
import os
import socket
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import pytest

from gcd_dataset.errors import DrapeError
from gcd_dataset.generator.drapers import DrapeReply, DrapeRequest, SharedDraper, address_for
from gcd_dataset.generator.drapers.draper import make_reply
from gcd_dataset.generator.drapers.process import ClientConnection, RequestQueue
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.loaders import FreshGarments, GarmentLoader, GeneratedGarments, collate_list
from gcd_dataset.records import Outcome, Sample
from gcd_dataset.shards.layout import key_of
from tests.loaders.draping import COUNT, OPTIONS, SKIRTS, Apart, drapers, items
from tests.loaders.rendered import start_of
from tests.loaders.test_shards import assert_all_same

CONFIG = MakeConfig(resolution=10.0, device="cpu", picture=0, points=16, design=SKIRTS, on_fail="keep")


@pytest.mark.long
def test_all_workers_share_one_draping_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = items()
    ds = Apart(COUNT, address_for("cpu"), cache_dir=tmp_path)
    loader = GarmentLoader(ds, 1, shuffle=False, num_workers=2, collate_fn=collate_list)
    assert_all_same(loader, [[item] for item in made])
    assert len(drapers(address_for("cpu"))) == 1
    monkeypatch.setattr(SharedDraper, "send", lambda draper, request: pytest.fail("draped again"))
    cached = GarmentLoader(ds, 1, shuffle=False, num_workers=2, collate_fn=collate_list)
    assert_all_same(cached, [[item] for item in made])


class StandIn:
    """A draper whose garments settle where they start. ``first_last``: the first garment settles after all others."""

    def __init__(self, *, at_once: int = 3, first_last: bool = False, fails: int | None = None) -> None:
        self.at_once, self.first_last, self.fails = at_once, first_last, fails
        self.sent: list[int] = []
        self.waiting: list[DrapeRequest] = []
        self.most_waiting = 0

    def send(self, request: DrapeRequest) -> None:
        self.sent.append(request.number)
        self.waiting.append(request)
        self.most_waiting = max(self.most_waiting, len(self.waiting))

    def poll(self) -> bool:
        return bool(self.waiting) and not self.first_last

    def receive(self) -> DrapeReply:
        request = self.waiting.pop(1 if self.first_last and len(self.waiting) > 1 else 0)
        drape = start_of(request)
        if request.number == self.fails:
            drape = replace(drape, outcome=Outcome.NOT_SETTLED)
        return make_reply(request, drape, "cpu")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.waiting.clear()


def made_ahead(indices: Iterable[int], draper: StandIn, *, ahead: int, config: MakeConfig = CONFIG) -> Iterator[Sample]:
    return produce(5, indices, config, draper=draper, ahead=ahead)


def test_the_bodies_of_a_design_are_draped_once(monkeypatch: pytest.MonkeyPatch) -> None:
    draper = StandIn()
    monkeypatch.setattr("gcd_dataset.loaders.generated.SharedDraper", lambda address: draper)
    options: dict[str, Any] = {"bodies": "both", "fields": ["verts", "front", "meta"]}
    ds = Apart(4, address_for("cpu"), **options)
    one_by_one = [ds[0], ds[1]]
    assert draper.sent == [0, 1]
    assert_all_same(one_by_one, Apart(4, address_for("cpu"), **options).__getitems__([0, 1]))
    assert_all_same(Apart(4, address_for("cpu"), **options).stream([1, 0, 1]), [one_by_one[k] for k in (1, 0, 1)])
    again = StandIn()
    made = made_ahead([2, 3, 3, 2], again, ahead=1, config=ds.config)
    assert [sample.key for sample in made] == [key_of(index) for index in (2, 3, 3, 2)]
    assert again.sent == [0, 1]


def test_a_failed_drape_is_retried_as_the_next_attempt() -> None:
    draper = StandIn(fails=1)
    rejects = [
        sample.provenance.rejects
        for sample in made_ahead(range(3), draper, ahead=2, config=replace(CONFIG, on_fail="retry"))
    ]
    assert rejects[1][0] == "drape: not_settled"
    assert len(draper.sent) == sum(1 + len(reasons) for reasons in rejects)


def test_a_slow_drape_does_not_hold_up_later_ones() -> None:
    """Up to ``ahead`` and ``at_once`` later drapes."""
    draper = StandIn(first_last=True)
    sent_before = []
    for sample in made_ahead(range(6), draper, ahead=5):
        sent_before.append(len(draper.sent))
        assert sample.key == key_of(len(sent_before) - 1)
    assert sent_before[0] >= 5
    assert draper.most_waiting == 3


def test_the_next_request_is_sent_before_a_sample_is_yielded() -> None:
    """Even if all earlier requests have replies: else the draper would run out of requests."""
    draper = StandIn()
    made = made_ahead(range(4), draper, ahead=3)
    assert [bool(draper.waiting) for _ in made] == [True, True, True, False]


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


def test_an_unknown_device_is_an_error_of_one_line() -> None:
    fresh = FreshGarments(GeneratedGarments(2, **{**OPTIONS, "device": "cuda:77"}), workers=1)
    with pytest.raises(DrapeError) as raised:
        next(iter(fresh))
    assert str(raised.value).startswith("unknown device 'cuda:77': choose one of auto, cpu")
    assert "Traceback" not in str(raised.value)
