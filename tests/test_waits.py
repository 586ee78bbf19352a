"""Waits of all stages are counted once and reach the writer."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest

from gcd_dataset import waits
from gcd_dataset.generator.drapers import SharedDraper, address_for
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.maker import _WorkerShare, produce
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.making.garments import encoded
from gcd_dataset.making.progress import Progress
from gcd_dataset.making.run import Made, Wanted, run
from gcd_dataset.making.store import place_for
from gcd_dataset.making.tasks import Work
from gcd_dataset.shards.codec import encode_sample
from gcd_dataset.shards.manifest import Plan
from gcd_dataset.waits import MAKERS, WRITER, Wait, WaitClock, record_wait, sum_waits, take_waits, timed, wait_shares
from gcd_dataset.workers import prefetch

SKIRTS = Overlay.from_dict({"meta": {"upper": None, "bottom": "PencilSkirt"}})  # they come to rest soon
DRAPED = MakeConfig(resolution=10.0, points=16, picture=0, device="cpu", on_fail="keep", design=SKIRTS)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """A manual clock; clears the recorded waits."""
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(waits, "time", SimpleNamespace(perf_counter=lambda: clock.now))
    take_waits()
    return clock


def test_a_writer_that_waits_three_seconds_of_four(clock: SimpleNamespace) -> None:
    def made() -> Iterator[int]:
        for number in range(5):
            clock.now += 3.0
            yield number

    for _ in timed(made(), WRITER):
        clock.now += 1.0
    waited = take_waits()
    assert waited[WRITER] == Wait(15.0, 19.0)  # the work on the last item is not counted
    assert wait_shares(waited)[WRITER] == 15 / 19
    assert take_waits() == {}


def test_an_interrupted_writer_closes_its_source_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    closed = []

    def made() -> Iterator[int]:
        try:
            yield 0
        finally:
            closed.append(True)

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(waits, "record_wait", interrupt)
    with pytest.raises(KeyboardInterrupt) as caught:
        list(timed(made(), WRITER))
    assert closed, f"not while the traceback of {caught!r} holds its frames"


def test_an_interrupted_run_closes_its_source_at_once(tmp_path: Path) -> None:
    closed = []

    def make(wanted: Wanted) -> Iterator[Made]:
        try:
            yield Made(0, encode_sample(fake_sample(0, 0)))
        finally:
            closed.append(True)

    def interrupt(progress: Progress) -> None:
        if progress.made:
            raise KeyboardInterrupt

    work = Work(place_for(tmp_path), Plan("garments", 0, {"fake": True}, 3, 1), {"train": range(3)})
    with pytest.raises(KeyboardInterrupt) as caught:
        run(work, make, on_progress=interrupt)
    assert closed, f"not while the traceback of {caught!r} holds its frames"


def test_a_wait_is_counted_once(clock: SimpleNamespace) -> None:
    own = WaitClock()
    clock.now = 4.0
    own.add_idle(3.0)
    assert own.lap() == Wait(3.0, 4.0)
    clock.now = 5.0
    assert own.lap() == Wait(0.0, 1.0)


def test_two_draping_processes_of_a_gpu_count_as_one() -> None:
    both = sum_waits({"cuda:0": Wait(0.0, 10.0)}, {"cuda:0": Wait(5.0, 10.0)})
    assert wait_shares(both) == {"cuda:0": 0.25}


def test_a_maker_whose_samples_are_not_taken_waits() -> None:
    take_waits()
    assert list(prefetch(iter("abc"), 1, name=MAKERS)) == ["a", "b", "c"]
    wait = take_waits()[MAKERS]
    assert 0 <= wait.idle <= wait.over
    list(prefetch(iter("abc"), 1))
    assert take_waits() == {}


def test_the_waits_of_a_draping_process_come_with_its_drapes_and_change_no_byte() -> None:
    alone = [encode_sample(sample) for sample in produce(5, [0], DRAPED)]
    place = address_for("cpu")
    with SharedDraper(place):  # starts it: waits count from here on
        share = _WorkerShare(5, (0,), DRAPED, place, finished=partial(encoded, 1, True), pictured=True)
        made = list(share.run())
    assert [one.members for one in made] == alone
    waited = sum_waits(*(one.waits for one in made), take_waits())
    assert set(waited) >= {"cpu", MAKERS}
    assert 0 < waited["cpu"].idle < waited["cpu"].over
    record_wait("cpu", waited["cpu"])
    assert take_waits() == {"cpu": waited["cpu"]}
