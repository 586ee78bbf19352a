"""Two ranks, each with half of every batch, learn what one process learns."""

import os
from pathlib import Path

import pytest
import torch
from torch.distributed import TCPStore  # type: ignore[attr-defined]
from torch.multiprocessing.spawn import spawn

from benchmarks.reconstruction.training import TrainConfig, one_of_several_ranks, train
from tests.benchmarks.reconstruction.toys import LineLearner, line

CONFIG = TrainConfig(steps=30, batch=8, lr=0.1)


def train_rank(rank: int, world: int, port: int, file: Path) -> None:
    """Train as one rank of several, which meet at a store on ``port``, and write the first rank's weights."""
    os.environ |= {"RANK": str(rank), "LOCAL_RANK": str(rank), "WORLD_SIZE": str(world), "MASTER_PORT": str(port)}
    os.environ |= {"MASTER_ADDR": "127.0.0.1", "TORCHELASTIC_USE_AGENT_STORE": "True"}
    os.environ["TORCHELASTIC_RESTART_COUNT"] = "0"
    torch.set_num_threads(1)
    with one_of_several_ranks("cpu") as device:
        found = train(LineLearner(), line(), CONFIG, device=device)
    if rank == 0:
        torch.save(found.learner.state_dict(), file)


@pytest.mark.filterwarnings("ignore")
def test_two_ranks_learn_what_one_process_learns(tmp_path: Path) -> None:
    store = TCPStore("127.0.0.1", 0, is_master=True, wait_for_workers=False)  # on a port that it holds
    spawn(train_rank, args=(2, store.port, tmp_path / "2.pt"), nprocs=2)  # type: ignore[no-untyped-call]
    one = train(LineLearner(), line(), CONFIG, device=torch.device("cpu")).learner.state_dict()
    two = torch.load(tmp_path / "2.pt")
    assert all(torch.allclose(one[name], two[name], atol=1e-5) for name in one)
