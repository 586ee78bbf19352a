"""Two ranks, each with half of every batch, learn what one process learns."""

from pathlib import Path

import pytest
import torch
from torch.distributed import TCPStore  # type: ignore[attr-defined]
from torch.multiprocessing.spawn import spawn

from tests.benchmarks.reconstruction.toys import train_rank


@pytest.mark.filterwarnings("ignore")
def test_two_ranks_learn_what_one_process_learns(tmp_path: Path) -> None:
    for world in (1, 2):
        store = TCPStore("127.0.0.1", 0, is_master=True, wait_for_workers=False)  # on a port that it holds
        arguments = (world, store.port, 30, tmp_path / f"{world}.pt")
        spawn(train_rank, args=arguments, nprocs=world)  # type: ignore[no-untyped-call]
    one, two = (torch.load(tmp_path / f"{world}.pt") for world in (1, 2))
    assert all(torch.allclose(one[name], two[name], atol=1e-5) for name in one)
