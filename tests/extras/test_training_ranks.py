"""Two ranks, each with half of the examples and half of every batch, have the same weights and find the line."""

import os
from pathlib import Path

import pytest
import torch
from torch.distributed import TCPStore  # type: ignore[attr-defined]
from torch.multiprocessing.spawn import spawn

from benchmarks.reconstruction.options import Config
from benchmarks.reconstruction.processes import of_all_ranks, one_of_several
from benchmarks.reconstruction.train import train
from tests.benchmarks.reconstruction.toys import LineLearner, line

CONFIG = Config(steps=150, batch=32, lr=0.1, weight_decay=0.0, ema=0.9)


def train_rank(rank: int, world: int, port: int, folder: Path) -> None:
    """Train as one rank of several, which meet at a store on ``port``, and write its weights."""
    os.environ |= {"RANK": str(rank), "LOCAL_RANK": str(rank), "WORLD_SIZE": str(world), "MASTER_PORT": str(port)}
    os.environ |= {"MASTER_ADDR": "127.0.0.1", "TORCHELASTIC_USE_AGENT_STORE": "True"}
    os.environ["TORCHELASTIC_RESTART_COUNT"] = "0"
    torch.set_num_threads(1)
    with one_of_several("cpu") as device:
        learner = LineLearner()
        if rank:  # the first rank's weights are taken
            torch.nn.init.zeros_(learner.net[1].weight)  # type: ignore[arg-type]
        found = train(learner, line()[rank::world], CONFIG, device=device)
        assert of_all_ranks(rank) == [0, 1]
    torch.save(found.learner.state_dict(), folder / f"{rank}.pt")


@pytest.mark.filterwarnings("ignore")
def test_two_ranks_learn_from_their_shares(tmp_path: Path) -> None:
    store = TCPStore("127.0.0.1", 0, is_master=True, wait_for_workers=False)  # on a port that it holds
    spawn(train_rank, args=(2, store.port, tmp_path), nprocs=2)  # type: ignore[no-untyped-call]
    one, two = (torch.load(tmp_path / f"{rank}.pt") for rank in range(2))
    assert all(torch.equal(one[name], two[name]) for name in one)
    assert one["net.1.weight"].tolist()[0] == pytest.approx([2.0, -1.0], abs=0.02)
