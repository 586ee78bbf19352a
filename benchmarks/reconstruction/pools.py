"""``FreshPool``: examples on the device that a stream of fresh garments renews in the course of a training."""

import queue
import threading
from collections.abc import Callable, Iterator
from typing import Any, Generic, TypeVar

import torch
from jaxtyping import Int
from torch import Tensor

from benchmarks.reconstruction.learners import Learner, TensorExamples
from gcd_dataset.errors import ConfigError

Batch = TypeVar("Batch")
WAITING = 256  # examples that wait to be taken


class FreshPool(Generic[Batch]):
    """The latest examples: those given at first, then fresh ones as they are made, the oldest replaced.

    Before each step the examples that are ready are taken; a step never waits. A training with a pool therefore depends
    on the speed of the machine. A resumed training goes on with the next garments of the stream.
    """

    def __init__(
        self,
        learner: Learner[Batch, Any],
        first: TensorExamples,
        stream: Callable[[int], Iterator[tuple[int, TensorExamples]]],
        *,
        room: int,
    ) -> None:
        """``first``: examples to begin with, on the device; ``stream``: indices and encoded garments from an index on,
        on a CPU, in order.

        Raises ``ConfigError`` without room for the first examples.
        """
        if len(first) > room:
            raise ConfigError(f"room {room}: give room for the {len(first)} examples to begin with")
        self._stream, filled = stream, len(first)
        self._store = first[torch.arange(room, device=first.device) % filled]
        self._filled = self._next = filled
        self._view = learner.drawn_from(self._store)
        self._ready: queue.Queue[tuple[int, TensorExamples] | BaseException] | None = None
        self._following = 0  # index after the last example received; those of garments left out are counted
        self.received = 0
        """Fresh examples received, in this run and those that it continues."""

    def __len__(self) -> int:
        return self._filled

    def batch(self, rows: Int[Tensor, " b"], chance: torch.Generator | None = None) -> Batch:
        """The examples ``rows``, as the learner draws them."""
        return self._view.batch(rows, chance)

    def advance(self, step: int) -> None:
        """Take what is ready; the first call starts the stream. Raises the stream's error."""
        if self._ready is None:
            self._ready = queue.Queue(WAITING)
            thread = threading.Thread(target=_fill, args=(self._ready, self._stream(self._following)), daemon=True)
            thread.start()
        taken: list[TensorExamples] = []
        while len(taken) < WAITING:
            try:
                one = self._ready.get_nowait()
            except queue.Empty:
                break
            if isinstance(one, BaseException):
                raise one
            self._following = one[0] + 1
            taken.append(one[1])
        if taken:
            self._put(type(taken[0]).join(taken))

    def _put(self, fresh: TensorExamples) -> None:
        room = len(self._store)
        rows = (self._next + torch.arange(len(fresh))) % room
        self._store.put(rows, fresh)
        self._next = int((self._next + len(fresh)) % room)
        self._filled = min(room, self._filled + len(fresh))
        self.received += len(fresh)

    def state_dict(self) -> dict[str, Any]:
        """The number of examples received, and the index at which the stream continues."""
        return {"received": self.received, "following": self._following}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue the stream after the examples received before."""
        self.received, self._following = state["received"], state["following"]


def _fill(
    ready: "queue.Queue[tuple[int, TensorExamples] | BaseException]", stream: Iterator[tuple[int, TensorExamples]]
) -> None:
    try:
        for one in stream:
            ready.put(one)
    except Exception as error:  # noqa: BLE001 - raised in the training
        ready.put(error)
