"""Two ranks, each with half of every batch, learn what one process learns."""

import socket
from pathlib import Path

import pytest
import torch
from torch.multiprocessing.spawn import spawn

from tests.benchmarks.reconstruction.toys import train_rank


def free_port() -> int:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        return int(server.getsockname()[1])


@pytest.mark.filterwarnings("ignore")
def test_two_ranks_learn_what_one_process_learns(tmp_path: Path) -> None:
    for world in (1, 2):
        arguments = (world, free_port(), 30, tmp_path / f"{world}.pt")
        spawn(train_rank, args=arguments, nprocs=world)  # type: ignore[no-untyped-call]
    one, two = (torch.load(tmp_path / f"{world}.pt") for world in (1, 2))
    assert all(torch.allclose(one[name], two[name], atol=1e-5) for name in one)
