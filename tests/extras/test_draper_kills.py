"""Draping processes that are killed, or whose clients are: each test starts its own."""

import os
import resource
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
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
from gcd_dataset.generator.drapers import DraperAddress, SharedDraper
from gcd_dataset.generator.drapers.address import socket_file
from gcd_dataset.loaders import FakeGarments, FreshGarments, collate_list
from tests.helpers import wait_until
from tests.loaders.draping import COUNT, Apart, drape_request, drapers, items, kill_drapers, own_address
from tests.loaders.test_shards import assert_all_same


@pytest.fixture
def address() -> Iterator[DraperAddress]:
    with own_address() as address:
        yield address


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


def test_a_spawned_worker_gets_the_same_drapes(address: DraperAddress) -> None:
    options: dict[str, Any] = {"num_workers": 1, "multiprocessing_context": "spawn", "collate_fn": collate_list}
    found = [item for [item] in DataLoader(Apart(COUNT, address), batch_size=1, **options)]
    assert_all_same(found, items())


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


def test_a_failing_draper_reports_the_error_and_is_replaced(
    address: DraperAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even if another client does not read its replies."""
    monkeypatch.setattr(DrapeJob, "require_drapeable", lambda job: None)  # else refused here
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
    wait_until(lambda: not drapers(address))
    assert not address.folder.exists()
