"""Recorded steps of the stitching network: batches of one shape, no copy from the host, and ranks draw alike."""

from contextlib import nullcontext
from dataclasses import replace
from functools import cache
from typing import Any

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from benchmarks.reconstruction.models.stitches import StitchExamples, StitchLearner
from benchmarks.reconstruction.training import replace_tensors, tensors_of
from tests.benchmarks.reconstruction.toys import SMALL, encode, t_shirt, tube


def test_a_step_copies_nothing_from_the_host(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a recorded step must not; the device is one without values, for which autocast does not exist."""
    monkeypatch.setattr(torch, "autocast", lambda *_, **__: nullcontext())
    learner, meta = StitchLearner(SMALL), torch.device("meta")
    batch = learner.of_one_shape(many()).batch(torch.arange(48), torch.Generator().manual_seed(0))
    there: dict[str, Any] = {name: column.to(meta) for name, column in tensors_of(batch).items()}
    there_too = replace(batch, graphs=batch.graphs.to(meta), **there)
    learner.to(meta)
    with Devices() as used:
        torch.autograd.backward(torch.stack(list(learner.loss(there_too).values())).sum())
    assert used.kinds == {"meta"}


class Devices(TorchDispatchMode):
    """The kinds of devices of the tensors that operations in its context read or write."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.kinds: set[str] = set()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        found = func(*args, **(kwargs or {}))
        self.kinds |= {one.device.type for one in tree_leaves((args, kwargs, found)) if isinstance(one, torch.Tensor)}
        return found


@cache
def many(count: int = 240, *, large: int = 12) -> StitchExamples:
    """Garments of 16 edges, and a few of 26."""
    arrays = [encode(t_shirt() if k < large else tube()) for k in range(count)]
    return StitchLearner(SMALL).examples(arrays, device=torch.device("cpu"))


def test_batches_of_one_shape_can_replace_each_other() -> None:
    """As a recorded step needs; the last of these batches has as many large garments as the set."""
    learner = StitchLearner(SMALL)
    examples = learner.of_one_shape(many())
    drawn = torch.stack([torch.randint(240, (48,), generator=torch.Generator().manual_seed(k)) for k in range(8)])
    batches = [examples.batch(rows, torch.Generator().manual_seed(k)) for k, rows in enumerate(drawn)]
    assert len({batch.parts for batch in batches}) == 1
    assert [part.rows for part in batches[0].parts] != [48]
    assert len({tuple(batch.counts.tolist()) for batch in batches}) > 1
    for batch in batches[1:]:
        replace_tensors(batches[0], batch)
        assert all(torch.equal(ours, tensors_of(batch)[name]) for name, ours in tensors_of(batches[0]).items())
    with pytest.raises(ValueError, match="shapes"):
        replace_tensors(batches[0], examples.batch(drawn[0, :40], torch.Generator()))
    other = replace(examples, one_shape=False).batch(drawn[0], torch.Generator())
    with pytest.raises(ValueError, match="parts"):
        replace_tensors(batches[0], other)


def test_wider_parts_change_no_loss() -> None:
    torch.manual_seed(0)
    learner = StitchLearner(SMALL)
    examples = many()
    rows = torch.randint(240, (48,), generator=torch.Generator().manual_seed(0))
    ours, padded = (
        learner.loss(replace(examples, one_shape=one_shape).batch(rows, torch.Generator().manual_seed(1)))
        for one_shape in (False, True)
    )
    assert {name: value.item() for name, value in padded.items()} == pytest.approx(
        {name: value.item() for name, value in ours.items()}, rel=1e-4
    )


def test_a_garment_without_room_in_a_batch_of_one_shape_is_left_out() -> None:
    learner = StitchLearner(SMALL)
    examples = replace(many(), one_shape=True)
    rows = torch.arange(48) % 12  # the large ones only
    batch = examples.batch(rows, torch.Generator().manual_seed(0))
    small = sum(part.rows for part in batch.parts if part.width < 26)
    assert 0 < (batch.counts == 0).sum() <= small
    assert all(value.isfinite() for value in learner.loss(batch).values())
    everything = replace(many(120, large=60), one_shape=True).batch(rows, torch.Generator().manual_seed(0))
    assert (everything.counts > 0).all()


def test_what_is_drawn_for_a_garment_does_not_depend_on_the_others_of_its_batch() -> None:
    """So that two ranks, each with half of a batch, learn what one process learns."""
    examples = many()
    rows = torch.randperm(240, generator=torch.Generator().manual_seed(0))[:48]
    whole, *halves = (
        sorted(torch.stack([column.double() for column in tensors_of(batch).values()], dim=1).tolist())
        for some in (rows, rows[::2], rows[1::2])
        for batch in [examples.batch(some, torch.Generator().manual_seed(1))]
    )
    assert sorted([*halves[0], *halves[1]]) == whole
