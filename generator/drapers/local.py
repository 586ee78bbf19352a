"""The draper in this process: batches on a GPU, one thread for each garment on a CPU."""

import time
from collections import deque
from collections.abc import Iterator
from typing import Self

from gcd_dataset.generator.drape import DrapeJob, batch_capacity, drape_batch, resolve_device
from gcd_dataset.generator.drape.batches import drape_unordered
from gcd_dataset.generator.drape.config import DrapeConfig
from gcd_dataset.generator.drapers.draper import DrapeReply, DrapeRequest, make_reply


class LocalDraper:
    """Drapes in this process, during the calls of ``receive``.

    ``device``: see ``resolve_device``. ``at_once``: garments in a batch; by default as many as the GPU holds, or one
    for each core. Raises ``ConfigError`` for an unknown device.
    """

    def __init__(self, device: str = "auto", *, at_once: int | None = None) -> None:
        self.device = resolve_device(device)
        self.at_once = at_once or batch_capacity(self.device)
        self._waiting: deque[DrapeRequest] = deque()
        self._done: deque[DrapeReply] = deque()
        self._batch: Iterator[DrapeReply] | None = None

    def send(self, request: DrapeRequest) -> None:
        request.job.require_drapeable()
        if request.retry:
            self._waiting.appendleft(request)
        else:
            self._waiting.append(request)

    def poll(self) -> bool:
        return bool(self._done)

    def receive(self) -> DrapeReply:
        while not self._done:
            if self.device == "cpu":
                self._drape_by_threads()
            else:
                self._run_batch()
        return self._done.popleft()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._waiting.clear()
        self._batch = None

    def _drape_by_threads(self) -> None:
        requests = [self._waiting.popleft() for _ in range(min(self.at_once, len(self._waiting)))]
        begin = time.perf_counter()
        drapes = drape_batch([request.job for request in requests], device=self.device, at_once=self.at_once)
        seconds = (time.perf_counter() - begin) / len(requests)
        self._done.extend(
            make_reply(request, drape, self.device, seconds=seconds)
            for request, drape in zip(requests, drapes, strict=True)
        )

    def _run_batch(self) -> None:
        """Run the batch until a garment comes to rest; requests sent in the meantime join the batch."""
        self._batch = self._batch or self._batched()
        reply = next(self._batch, None)
        if reply is None:
            self._batch = None
        else:
            self._done.append(reply)

    def _batched(self) -> Iterator[DrapeReply]:
        requests: list[DrapeRequest] = []
        begin = time.perf_counter()

        def jobs() -> Iterator[DrapeJob | None]:
            while True:
                if self._waiting:
                    requests.append(self._waiting.popleft())
                    yield requests[-1].job
                else:
                    yield None

        drapes = drape_unordered(jobs(), DrapeConfig(), device=self.device, at_once=self.at_once)
        for count, (number, drape) in enumerate(drapes, 1):
            seconds = (time.perf_counter() - begin) / count
            yield make_reply(requests[number], drape, self.device, seconds=seconds)
