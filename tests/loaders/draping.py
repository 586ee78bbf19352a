"""Garments that drape in a process of their own, and that process."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gcd_dataset.generator.drape import DrapeJob
from gcd_dataset.generator.drapers import DraperAddress, DrapeRequest
from gcd_dataset.generator.drapers.address import _create
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.pipeline import prepare
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.loaders import GeneratedGarments

COUNT = 2
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


def items() -> list[dict[str, Any]]:
    """The garments, draped by this process."""
    return GeneratedGarments(COUNT, **OPTIONS).__getitems__(range(COUNT))


@contextmanager
def own_address() -> Iterator[DraperAddress]:
    """An address of one test alone; its draping process ends with the block."""
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


def drape_request(number: int, resolution: float = 10.0) -> DrapeRequest:
    [worn] = prepare(5, 0, MakeConfig(resolution=resolution, device="cpu", design=SKIRTS)).dressed
    assert worn.box_mesh is not None
    return DrapeRequest(number, DrapeJob(worn.box_mesh, worn.body, worn.size), 0)
