"""The draping process: the same garments as without it, and what happens when processes start, fail and die."""

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
from gcd_dataset.generator.drapers.address import _create, socket_file
from gcd_dataset.generator.drapers.process import ClientConnection, RequestQueue
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.pipeline import prepare, sample_key
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.loaders import FakeGarments, FreshGarments, GarmentLoader, GeneratedGarments, collate_list
from gcd_dataset.records import Outcome, Sample
from tests.loaders.test_shards import assert_all_same

COUNT = 3
SKIRTS = Overlay.from_dict({"meta": {"upper": None, "bottom": "PencilSkirt"}})  # settle soon
OPTIONS: dict[str, Any] = {
    "seed": 5, "resolution": 10.0, "device": "cpu", "picture": 32, "on_fail": "keep", "design": SKIRTS,
}  # fmt: skip


class Apart(GeneratedGarments):
    """Garments that always drape in the draping process, as on a GPU."""

    def __init__(self, n: int, address: DraperAddress, **options: Any) -> None:
        super().__init__(n, **OPTIONS, **options)
        self._addresses = (address,)

    @property
    def _drapes_elsewhere(self) -> bool:
        return True


@pytest.fixture(scope="module")
def items() -> list[dict[str, Any]]:
    return GeneratedGarments(COUNT, **OPTIONS).__getitems__(range(COUNT))


@pytest.fixture
def address() -> Iterator[DraperAddress]:
    """An address of this test alone; its draping process ends with the test."""
    address = _create("cpu")
    yield address
    (address.folder / "owner").unlink(missing_ok=True)
    kill_drapers(address)


def drapers(address: DraperAddress) -> list[int]:
    """Identifiers of the draping processes at an address."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                command = (folder / "cmdline").read_bytes().decode().split("\0")
            except OSError:
                continue
            if str(address.folder) in command:
                found.append(int(folder.name))
    return found


def kill_drapers(address: DraperAddress, number: int = signal.SIGKILL) -> None:
    for pid in drapers(address):
        os.kill(pid, number)


@pytest.mark.parametrize(("workers", "context"), [(1, "spawn"), (2, "fork")])
def test_workers_get_the_same_garments_from_the_draping_process(
    items: list[dict[str, Any]], workers: int, context: str
) -> None:
    ds = Apart(COUNT, address_for("cpu"))
    loader = DataLoader(ds, batch_size=2, num_workers=workers, multiprocessing_context=context, collate_fn=collate_list)
    assert_all_same(loader, [items[:2], items[2:]])


def test_all_workers_share_one_draping_process(
    items: list[dict[str, Any]], address: DraperAddress, tmp_path: Path
) -> None:
    ds = Apart(COUNT, address, cache_dir=tmp_path)
    loader = GarmentLoader(ds, 1, shuffle=False, num_workers=2, collate_fn=collate_list)
    assert drapers(address) == []
    assert_all_same(loader, [[item] for item in items])
    assert len(drapers(address)) == 1
    kill_drapers(address)
    assert_all_same(loader, [[item] for item in items])  # from the cache, without a draper


def test_a_stream_is_in_the_order_of_its_indices(items: list[dict[str, Any]]) -> None:
    ds = Apart(COUNT, address_for("cpu"))
    assert_all_same(ds.stream([2, 0, 2, 1]), [items[2], items[0], items[2], items[1]])


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
    made = made_ahead(range(8), config, ahead=5, at_once=3)
    assert [sample.key for sample in made] == [sample_key(index) for index in range(8)]
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
    taken = [queue._pop() for _ in range(4)]
    assert [entry and entry[1].number for entry in taken] == [2, 0, 1, 3]
    theirs.close()


def drape_request(number: int, resolution: float = 10.0) -> DrapeRequest:
    config = MakeConfig(resolution=resolution, device="cpu", design=SKIRTS)
    [worn] = prepare(5, 0, config).dressed
    assert worn.box_mesh is not None
    return DrapeRequest(number, DrapeJob(worn.box_mesh, worn.body, worn.size), 0)


def test_a_killed_draper_is_an_error_and_the_next_client_starts_another(address: DraperAddress) -> None:
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


def test_a_draper_about_to_end_is_replaced(address: DraperAddress) -> None:
    """Its socket still accepts connections, but sends no greeting."""
    with Listener(str(socket_file(address.folder)), "AF_UNIX") as dying:
        thread = threading.Thread(target=lambda: dying.accept().close())
        thread.start()
        with SharedDraper(address) as draper:
            draper.send(drape_request(7))
            assert draper.receive().number == 7
        thread.join()


def test_a_draper_whose_starter_is_killed_serves_the_next_client(
    address: DraperAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its starter dies while the draping process loads: the next client waits for it and starts no second process."""
    child = os.fork()
    if child == 0:
        popen = subprocess.Popen

        def killed(*command: Any, **options: Any) -> None:
            popen(*command, **options)
            os.kill(os.getpid(), signal.SIGKILL)

        monkeypatch.setattr(subprocess, "Popen", killed)
        try:
            address.connect()
        finally:
            os._exit(1)
    os.waitpid(child, 0)
    begun = drapers(address)
    assert len(begun) == 1
    with SharedDraper(address) as draper:
        draper.send(drape_request(7))
        assert draper.receive().number == 7
    assert drapers(address) == begun


def test_a_failing_draper_reports_the_error_and_is_replaced(
    address: DraperAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even if another client does not read its replies."""
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


class Unreadable:
    """An object that cannot be unpickled."""

    def __reduce__(self) -> tuple[type[int], tuple[str]]:
        return int, ("no number",)


def test_a_request_that_cannot_be_unpickled_is_one_error(address: DraperAddress) -> None:
    with SharedDraper(address) as draper:
        draper.send(replace(drape_request(0), number=Unreadable()))  # type: ignore[arg-type]
        with pytest.raises(DrapeError, match="drapes on cpu has ended"):
            draper.receive()


def test_more_requests_may_wait_than_the_soft_limit_of_open_files(address: DraperAddress) -> None:
    few, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (100, most))
    try:
        draper = SharedDraper(address)  # the draping process inherits the limit
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (few, most))
    with draper:
        one = drape_request(0)
        for number in range(150):
            draper.send(replace(one, number=number))
        assert draper.receive().number in range(150)


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


def test_a_draper_killed_under_a_loader_is_one_error(address: DraperAddress) -> None:
    loader = iter(DataLoader(Apart(50, address), batch_size=1, num_workers=1, collate_fn=collate_list, timeout=120))
    next(loader)
    kill_drapers(address)
    with pytest.raises(DrapeError, match="drapes on cpu has ended"):
        for _ in loader:
            pass


def test_fresh_garments_resume_after_their_draper_was_killed(address: DraperAddress) -> None:
    """They start a new draper and continue at the lost garment."""
    whole = [item["meta"]["index"] for item in FreshGarments(FakeGarments(40, fields=["meta"]), replay=2, room=4)]
    fresh = FreshGarments(Apart(40, address, fields=["meta"]), replay=2, room=4, workers=1)
    given = [next(made := iter(fresh))["meta"]["index"]]
    kill_drapers(address)
    with pytest.raises(DrapeError) as raised:
        given.extend(item["meta"]["index"] for item in made)
    assert str(raised.value).startswith("the process that drapes on cpu has ended, perhaps killed for lack of memory")
    fresh.load_state_dict(fresh.state_dict())
    given.extend(item["meta"]["index"] for item in islice(fresh, 1))
    assert given == whole[: len(given)]


def test_a_draper_killed_under_workers_is_one_error(address: DraperAddress, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gcd_dataset.generator.maker.addresses_for", lambda devices: (address,))
    config = MakeConfig(resolution=10.0, device="cpu", picture=0, points=16, design=SKIRTS, on_fail="keep")
    made = produce(5, range(100), config, workers=2)
    given = [next(made)]
    kill_drapers(address)
    with pytest.raises(DrapeError, match="drapes on cpu has ended"):
        given.extend(made)
    assert [sample.key for sample in given] == [sample_key(index) for index in range(len(given))]


def test_workers_are_distributed_over_the_draping_processes(
    items: list[dict[str, Any]], address: DraperAddress
) -> None:
    ds = Apart(COUNT, address)
    addresses = (address, _create("cpu"))
    ds._addresses = addresses
    assert_all_same(FreshGarments(ds, room=1, workers=2), items)
    assert [len(drapers(each)) for each in addresses] == [1, 1]
    (addresses[1].folder / "owner").unlink()
    kill_drapers(addresses[1])


def test_an_unknown_device_is_an_error_of_one_line() -> None:
    fresh = FreshGarments(GeneratedGarments(2, **{**OPTIONS, "device": "cuda:77"}), workers=1)
    with pytest.raises(DrapeError) as raised:
        next(iter(fresh))
    assert str(raised.value).startswith("unknown device 'cuda:77': choose one of auto, cpu")
    assert "Traceback" not in str(raised.value)


def test_a_killed_worker_does_not_hold_up_others(address: DraperAddress) -> None:
    with SharedDraper(address) as draper:
        draper.send(drape_request(0))
        draper.receive()
        child = os.fork()
        if child == 0:
            try:
                other = SharedDraper(address)
                for number in range(20):
                    other.send(drape_request(number))
            finally:
                os.kill(os.getpid(), signal.SIGKILL)
        os.waitpid(child, 0)
        draper.send(drape_request(1))
        assert draper.receive().number == 1


def test_a_worker_that_does_not_read_does_not_hold_up_others(address: DraperAddress) -> None:
    with SharedDraper(address) as deaf, SharedDraper(address) as draper:
        large = drape_request(0, 3.0)
        for _ in range(3):
            deaf.send(large)
        draper.send(drape_request(1))
        assert draper.receive().number == 1


def test_connecting_for_an_unknown_device_raises() -> None:
    with pytest.raises(DrapeError, match="unknown device 'cuda:77': choose one of"):
        _create("cuda:77").connect()


def test_the_draper_ends_with_the_process_that_owns_it() -> None:
    code = (
        "import os, signal\n"
        "from gcd_dataset.generator.drapers import address_for\n"
        "address = address_for('cpu')\n"
        "child = os.fork()\n"
        "if child == 0:\n"
        "    address.connect(); os._exit(0)\n"
        "os.waitpid(child, 0)\n"
        "address.connect()\n"  # the draper has outlived the child that started it
        "print(address.folder, flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False).stdout.strip()
    address = DraperAddress(Path(out), "cpu")
    deadline = time.monotonic() + 60
    while drapers(address) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert drapers(address) == []
    assert not address.folder.exists()


def warp_is_initialised(item: dict[str, Any]) -> bool:
    """Whether Warp is initialised in this process: with a GPU that would take a CUDA context."""
    return importlib.import_module("warp._src.context").runtime is not None


def test_workers_do_not_initialise_warp() -> None:
    ds = Apart(1, address_for("cpu"), transform=warp_is_initialised)
    [[initialised]] = DataLoader(ds, num_workers=1, multiprocessing_context="spawn", collate_fn=collate_list)
    assert not initialised
