"""The draper of this process: batches on a GPU, a thread for each garment on a CPU."""

import time
from collections import deque
from collections.abc import Iterator
from typing import Self

from gcd_dataset.generator.drape import DrapeJob, drape_batch, places_on, resolve_device
from gcd_dataset.generator.drape.config import DrapeConfig
from gcd_dataset.generator.drape.queue import drape_in_turn
from gcd_dataset.generator.drapers.draper import DrapeReply, DrapeRequest, draped, require_faces
from gcd_dataset.records import Drape

__all__ = ["DraperHere"]


class DraperHere:
    """Drapes in this process, in the calls of ``answer``.

    ``device``: as ``resolve_device`` takes it. ``at_once``: garments in a batch; by default as many as the GPU holds,
    or one for each core. Raises ``ConfigError`` for a device that is not there.
    """

    def __init__(self, device: str = "auto", *, at_once: int | None = None) -> None:
        self.device = resolve_device(device)
        self.at_once = at_once or places_on(self.device)
        self._waiting: deque[DrapeRequest] = deque()
        self._done: deque[DrapeReply] = deque()
        self._turns: Iterator[DrapeReply] | None = None

    def ask(self, order: DrapeRequest) -> None:
        require_faces(order)
        if order.again:
            self._waiting.appendleft(order)
        else:
            self._waiting.append(order)

    def answered(self) -> bool:
        return bool(self._done)

    def answer(self) -> DrapeReply:
        while not self._done:
            if self.device == "cpu":
                self._drape_some()
            else:
                self._take_turn()
        return self._done.popleft()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._waiting.clear()
        self._turns = None

    def _drape_some(self) -> None:
        orders = [self._waiting.popleft() for _ in range(min(self.at_once, len(self._waiting)))]
        begun = time.perf_counter()
        drapes = drape_batch([order.job for order in orders], device=self.device, at_once=self.at_once)
        seconds = (time.perf_counter() - begun) / len(orders)
        self._done.extend(self._finished(order, drape, seconds) for order, drape in zip(orders, drapes, strict=True))

    def _take_turn(self) -> None:
        """Run the batch until one of its garments comes to rest; those ordered meanwhile have joined it."""
        self._turns = self._turns or self._in_turn()
        answer = next(self._turns, None)
        if answer is None:
            self._turns = None
        else:
            self._done.append(answer)

    def _in_turn(self) -> Iterator[DrapeReply]:
        at_work: list[DrapeRequest] = []
        begun = time.perf_counter()

        def jobs() -> Iterator[DrapeJob | None]:
            while True:
                if self._waiting:
                    at_work.append(self._waiting.popleft())
                    yield at_work[-1].job
                else:
                    yield None

        turns = drape_in_turn(jobs(), DrapeConfig(), device=self.device, at_once=self.at_once)
        for count, (number, drape) in enumerate(turns, 1):
            yield self._finished(at_work[number], drape, (time.perf_counter() - begun) / count)

    def _finished(self, order: DrapeRequest, drape: Drape, seconds: float) -> DrapeReply:
        return draped(order, drape, self.device, seconds=seconds)
