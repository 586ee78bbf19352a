"""Garments that workers have draped by a process of its own: the same as if they had draped them themselves."""

import importlib
import multiprocessing
import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice
from multiprocessing.connection import Listener
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from torch.utils.data import DataLoader

from gcd_dataset.errors import DrapeError
from gcd_dataset.generator.drape import DrapeJob
from gcd_dataset.generator.drapers import DraperAddress, DrapeReply, DrapeRequest, SharedDraper, address_for
from gcd_dataset.generator.drapers.address import _made, socket_file
from gcd_dataset.generator.drapers.process import Asker, Inbox
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.pipeline import prepare, sample_key
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.loaders import FakeGarments, FreshGarments, GarmentLoader, GeneratedGarments, collate_list
from gcd_dataset.records import Outcome, Sample
from tests.loaders.test_shards import assert_all_same

COUNT = 3
SKIRTS = Overlay.from_dict({"meta": {"upper": None, "bottom": "PencilSkirt"}})  # they come to rest soon
OPTIONS: dict[str, Any] = {
    "seed": 5, "resolution": 10.0, "device": "cpu", "picture": 32, "on_fail": "keep", "design": SKIRTS,
}  # fmt: skip


class Apart(GeneratedGarments):
    """Garments of which no process drapes its own, as on a GPU."""

    def __init__(self, n: int, place: DraperAddress, **options: Any) -> None:
        super().__init__(n, **OPTIONS, **options)
        self._addresses = (place,)

    @property
    def _drapes_elsewhere(self) -> bool:
        return True


@pytest.fixture(scope="module")
def items() -> list[dict[str, Any]]:
    return GeneratedGarments(COUNT, **OPTIONS).__getitems__(range(COUNT))


@pytest.fixture
def place() -> Iterator[DraperAddress]:
    """A place of which nobody else knows; its draper ends with the test."""
    place = _made("cpu")
    yield place
    (place.folder / "owner").unlink(missing_ok=True)
    kill_drapers(place)


def drapers(place: DraperAddress) -> list[int]:
    """Processes that drape there."""
    there = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                command = (folder / "cmdline").read_bytes().decode().split("\0")
            except OSError:
                continue
            if str(place.folder) in command:
                there.append(int(folder.name))
    return there


def kill_drapers(place: DraperAddress, how: int = signal.SIGKILL) -> None:
    for pid in drapers(place):
        os.kill(pid, how)


@pytest.mark.parametrize(("workers", "context"), [(1, "spawn"), (2, "fork")])
def test_whoever_drapes_them_they_are_the_same(items: list[dict[str, Any]], workers: int, context: str) -> None:
    ds = Apart(COUNT, address_for("cpu"))
    loader = DataLoader(ds, batch_size=2, num_workers=workers, multiprocessing_context=context, collate_fn=collate_list)
    assert_all_same(loader, [items[:2], items[2:]])


def test_all_workers_have_one_draper_in_common(
    items: list[dict[str, Any]], place: DraperAddress, tmp_path: Path
) -> None:
    ds = Apart(COUNT, place, cache_dir=tmp_path)
    loader = GarmentLoader(ds, 1, shuffle=False, num_workers=2, collate_fn=collate_list)
    assert drapers(place) == []
    assert_all_same(loader, [[item] for item in items])
    assert len(drapers(place)) == 1
    kill_drapers(place)
    assert_all_same(loader, [[item] for item in items])  # of the cache, without it


def test_a_stream_gives_them_in_order(items: list[dict[str, Any]]) -> None:
    ds = Apart(COUNT, address_for("cpu"))
    assert_all_same(ds.stream([2, 0, 2, 1]), [items[2], items[0], items[2], items[1]])


def made_ahead(
    indices: Iterable[int], config: MakeConfig, *, ahead: int, at_once: int | None = None
) -> Iterator[Sample]:
    with SharedDraper(address_for("cpu"), at_once=at_once or ahead) as draper:
        yield from produce(5, indices, config, draper=draper, ahead=ahead)


def test_a_design_is_draped_once_for_its_bodies_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    sent, ask = [], SharedDraper.ask

    def noted(draper: SharedDraper, order: DrapeRequest) -> None:
        sent.append(order.number)
        ask(draper, order)

    monkeypatch.setattr(SharedDraper, "ask", noted)
    ds = Apart(4, address_for("cpu"), bodies="both", fields=["verts", "front", "meta"])
    one_by_one = [ds[0], ds[1]]
    assert sent == [0, 1]
    assert_all_same(one_by_one, Apart(4, address_for("cpu"), bodies="both", fields=ds.fields).__getitems__([0, 1]))
    sent.clear()
    made = made_ahead([2, 3, 3, 2], ds.config, ahead=1)
    assert [sample.key for sample in made] == [sample_key(index) for index in (2, 3, 3, 2)]
    assert sent == [0, 1]


def test_a_drape_that_fails_raises_the_attempt(monkeypatch: pytest.MonkeyPatch) -> None:
    answered, told = SharedDraper.answer, []

    def failing_once(draper: SharedDraper) -> DrapeReply:
        answer = answered(draper)
        told.append(answer.number)
        fails = answer.number == 1
        # The rest settle, whatever so coarse a cloth does.
        outcome = Outcome.NOT_SETTLED if fails else Outcome.SETTLED
        return replace(answer, drape=replace(answer.drape, outcome=outcome))

    monkeypatch.setattr(SharedDraper, "answer", failing_once)
    config = MakeConfig(resolution=10.0, device="cpu", picture=0, points=16, design=SKIRTS)
    made = made_ahead(range(3), config, ahead=2)
    rejects = [sample.provenance.rejects for sample in made]
    assert rejects[1][0] == "drape: not_settled"
    assert len(told) == sum(1 + len(reasons) for reasons in rejects)


def test_while_one_is_draped_for_long_those_after_it_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """As many at once, and as far ahead, as was asked for; the first is answered when nothing else is under way."""
    asked, answered, most = set[int](), set[int](), []
    ask, answer = SharedDraper.ask, SharedDraper.answer
    slow: list[DrapeReply] = []

    def noted(draper: SharedDraper, order: DrapeRequest) -> None:
        asked.add(order.number)
        most.append(len(asked - answered))
        ask(draper, order)

    def first_last(draper: SharedDraper) -> DrapeReply:
        if slow and asked - answered == {0}:
            given = slow.pop()
        else:
            given = answer(draper)
            if given.number == 0 and asked - answered != {0}:
                slow.append(given)
                return first_last(draper)
        answered.add(given.number)
        if given.number == 0:
            assert asked == {0, 1, 2, 3, 4}
        return given

    monkeypatch.setattr(SharedDraper, "ask", noted)
    monkeypatch.setattr(SharedDraper, "answer", first_last)
    monkeypatch.setattr(SharedDraper, "answered", lambda draper: False)
    config = MakeConfig(resolution=10.0, device="cpu", picture=0, points=16, design=SKIRTS, on_fail="keep")
    made = made_ahead(range(8), config, ahead=5, at_once=3)
    assert [sample.key for sample in made] == [sample_key(index) for index in range(8)]
    assert max(most) == 3


def test_the_draper_has_something_to_do_while_one_is_handed_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Though all that was asked for has been answered before."""
    under_way, ask, answer = set[int](), SharedDraper.ask, SharedDraper.answer

    def noted(draper: SharedDraper, order: DrapeRequest) -> None:
        under_way.add(order.number)
        ask(draper, order)

    def taken(draper: SharedDraper) -> DrapeReply:
        given = answer(draper)
        under_way.discard(given.number)
        return given

    monkeypatch.setattr(SharedDraper, "ask", noted)
    monkeypatch.setattr(SharedDraper, "answer", taken)
    monkeypatch.setattr(SharedDraper, "answered", lambda draper: bool(under_way))
    config = MakeConfig(resolution=10.0, device="cpu", picture=0, points=16, design=SKIRTS, on_fail="keep")
    made = made_ahead(range(4), config, ahead=3)
    assert [bool(under_way) for _ in made] == [True, True, True, False]


def test_what_fails_is_draped_again_before_others() -> None:
    """Those after it wait for it."""
    inbox, (ours, theirs) = Inbox(), multiprocessing.Pipe()
    asker = Asker(ours, inbox)
    one = order(0)
    for number, again in enumerate([False, False, True, False]):
        inbox.put(asker, replace(one, number=number, again=again))
    taken = [inbox._taken() for _ in range(4)]
    assert [entry and entry[1].number for entry in taken] == [2, 0, 1, 3]
    theirs.close()


def order(number: int, resolution: float = 10.0) -> DrapeRequest:
    config = MakeConfig(resolution=resolution, device="cpu", design=SKIRTS)
    [worn] = prepare(5, 0, config).dressed
    assert worn.box_mesh is not None
    return DrapeRequest(number, DrapeJob(worn.box_mesh, worn.body, worn.size), 0)


def test_a_killed_draper_is_told_and_the_next_is_begun(place: DraperAddress) -> None:
    with SharedDraper(place) as draper:
        kill_drapers(place, signal.SIGSTOP)  # it would be done, perhaps, before it is killed
        draper.ask(order(0))
        kill_drapers(place)
        with pytest.raises(DrapeError, match="drapes on cpu has ended"):
            draper.answer()
        with pytest.raises(DrapeError, match="drapes on cpu has ended"):
            draper.ask(order(1))
    with SharedDraper(place) as draper:
        draper.ask(order(7))
        assert draper.answer().number == 7


def test_a_draper_that_is_about_to_end_is_not_taken_for_one(place: DraperAddress) -> None:
    """Its socket takes calls a moment longer than it answers them."""
    with Listener(str(socket_file(place.folder)), "AF_UNIX") as dying:
        thread = threading.Thread(target=lambda: dying.accept().close())
        thread.start()
        with SharedDraper(place) as draper:
            draper.ask(order(7))
            assert draper.answer().number == 7
        thread.join()


def test_a_draper_whose_starter_is_killed_is_met_by_the_next(
    place: DraperAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While it loads; the next waits for it, and begins no other beside it."""
    child = os.fork()
    if child == 0:
        popen = subprocess.Popen

        def killed(*command: Any, **options: Any) -> None:
            popen(*command, **options)
            os.kill(os.getpid(), signal.SIGKILL)

        monkeypatch.setattr(subprocess, "Popen", killed)
        try:
            place.connect()
        finally:
            os._exit(1)
    os.waitpid(child, 0)
    begun = drapers(place)
    assert len(begun) == 1
    with SharedDraper(place) as draper:
        draper.ask(order(7))
        assert draper.answer().number == 7
    assert drapers(place) == begun


def test_a_draper_that_fails_says_why_and_takes_no_more_calls(place: DraperAddress) -> None:
    """Whatever it is, and though it waits for somebody who does not read before it ends."""
    with SharedDraper(place) as deaf, SharedDraper(place) as draper:
        deaf.ask(replace(order(0), picture=400))
        assert deaf._connection.poll(120)  # and more of it is held back
        good = order(1)
        torn = replace(good.job.box_mesh, labels={"strapless_top": np.array([10**6])})
        draper.ask(replace(good, job=replace(good.job, box_mesh=torn)))
        with pytest.raises(
            DrapeError, match=r"draping on cpu: index 1000000 is out of bounds .*; start again, on other"
        ):
            draper.answer()
        with SharedDraper(place) as other:
            other.ask(good)
            assert other.answer().number == 1


class Unreadable:
    """What nobody can unpack."""

    def __reduce__(self) -> tuple[type[int], tuple[str]]:
        return int, ("no number",)


def test_an_order_that_cannot_be_read_is_one_error(place: DraperAddress) -> None:
    with SharedDraper(place) as draper:
        draper.ask(replace(order(0), number=Unreadable()))  # type: ignore[arg-type]
        with pytest.raises(DrapeError, match="drapes on cpu has ended"):
            draper.answer()


def test_more_garments_may_wait_than_a_process_may_have_files(place: DraperAddress) -> None:
    few, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (100, most))
    try:
        draper = SharedDraper(place)  # its draper has that limit too
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (few, most))
    with draper:
        one = order(0)
        for number in range(150):
            draper.ask(replace(one, number=number))
        assert draper.answer().number in range(150)


def test_a_connection_is_not_closed_while_it_is_read() -> None:
    """Its number would be given to the next connection, from which the rest of an order would be taken."""
    ours, theirs = multiprocessing.Pipe()
    asker = Asker(ours, Inbox())
    os.write(theirs.fileno(), b"half")
    with socket.socket(fileno=os.dup(theirs.fileno())) as half:
        half.shutdown(socket.SHUT_RD)  # it takes no answers, and is not gone
    asker.tell("an answer")
    asker.finish()
    assert not ours.closed
    theirs.close()


def test_a_process_that_outlives_the_owner_has_a_place_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gcd_dataset.generator.drapers.address._places", {})
    place = address_for("cpu")
    assert address_for("cpu") == place
    shutil.rmtree(place.folder)
    assert address_for("cpu").folder.is_dir()


def test_a_draper_killed_under_a_loader_is_one_error(place: DraperAddress) -> None:
    loader = iter(DataLoader(Apart(50, place), batch_size=1, num_workers=1, collate_fn=collate_list, timeout=120))
    next(loader)
    kill_drapers(place)
    with pytest.raises(DrapeError, match="drapes on cpu has ended"):
        for _ in loader:
            pass


def test_fresh_garments_go_on_after_their_draper_was_killed(place: DraperAddress) -> None:
    """By another, which the same program starts, with the garment that did not come."""
    whole = [item["meta"]["index"] for item in FreshGarments(FakeGarments(40, fields=["meta"]), replay=2, room=4)]
    fresh = FreshGarments(Apart(40, place, fields=["meta"]), replay=2, room=4, workers=1)
    given = [next(made := iter(fresh))["meta"]["index"]]
    kill_drapers(place)
    with pytest.raises(DrapeError) as raised:
        given.extend(item["meta"]["index"] for item in made)
    assert str(raised.value).startswith("the process that drapes on cpu has ended, killed perhaps for lack of memory")
    fresh.load_state_dict(fresh.state_dict())
    given.extend(item["meta"]["index"] for item in islice(fresh, 1))
    assert given == whole[: len(given)]


def test_a_draper_killed_under_workers_is_one_error(place: DraperAddress, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gcd_dataset.generator.maker.addresses_for", lambda devices: (place,))
    config = MakeConfig(resolution=10.0, device="cpu", picture=0, points=16, design=SKIRTS, on_fail="keep")
    made = produce(5, range(100), config, workers=2)
    given = [next(made)]
    kill_drapers(place)
    with pytest.raises(DrapeError, match="drapes on cpu has ended"):
        given.extend(made)
    assert [sample.key for sample in given] == [sample_key(index) for index in range(len(given))]


def test_workers_have_the_draping_processes_by_turns(items: list[dict[str, Any]], place: DraperAddress) -> None:
    ds = Apart(COUNT, place)
    places = (place, _made("cpu"))
    ds._addresses = places
    assert_all_same(FreshGarments(ds, room=1, workers=2), items)
    assert [len(drapers(place)) for place in places] == [1, 1]
    (places[1].folder / "owner").unlink()
    kill_drapers(places[1])


def test_a_device_that_is_not_there_is_told_on_one_line() -> None:
    fresh = FreshGarments(GeneratedGarments(2, **{**OPTIONS, "device": "cuda:77"}), workers=1)
    with pytest.raises(DrapeError) as raised:
        next(iter(fresh))
    assert str(raised.value).startswith("device cuda:77: there is cpu")
    assert "Traceback" not in str(raised.value)


def test_a_worker_that_is_killed_holds_up_no_other(place: DraperAddress) -> None:
    with SharedDraper(place) as draper:
        draper.ask(order(0))
        draper.answer()
        child = os.fork()
        if child == 0:
            try:
                other = SharedDraper(place)
                for number in range(20):
                    other.ask(order(number))
            finally:
                os.kill(os.getpid(), signal.SIGKILL)
        os.waitpid(child, 0)
        draper.ask(order(1))
        assert draper.answer().number == 1


def test_a_worker_that_does_not_read_holds_up_no_other(place: DraperAddress) -> None:
    with SharedDraper(place) as deaf, SharedDraper(place) as draper:
        large = order(0, 3.0)
        for _ in range(3):
            deaf.ask(large)
        draper.ask(order(1))
        assert draper.answer().number == 1


def test_a_device_that_is_not_there_is_told() -> None:
    with pytest.raises(DrapeError, match="device cuda:77: there is"):
        _made("cuda:77").connect()


def test_the_draper_ends_with_the_process_that_owns_it() -> None:
    code = (
        "import os, signal\n"
        "from gcd_dataset.generator.drapers import address_for\n"
        "place = address_for('cpu')\n"
        "child = os.fork()\n"
        "if child == 0:\n"
        "    place.connect(); os._exit(0)\n"
        "os.waitpid(child, 0)\n"
        "place.connect()\n"  # it has outlived the child that started it
        "print(place.folder, flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False).stdout.strip()
    place = DraperAddress(Path(out), "cpu")
    deadline = time.monotonic() + 60
    while drapers(place) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert drapers(place) == []
    assert not place.folder.exists()


def warp_has_begun(item: dict[str, Any]) -> bool:
    """Whether Warp has been started in this process: with a GPU that would be a context of CUDA."""
    return importlib.import_module("warp._src.context").runtime is not None


def test_no_worker_starts_warp() -> None:
    ds = Apart(1, address_for("cpu"), transform=warp_has_begun)
    [[begun]] = DataLoader(ds, num_workers=1, multiprocessing_context="spawn", collate_fn=collate_list)
    assert not begun
