"""The drapers of a Ray cluster: actors, two for each GPU, that garments from any of its nodes share."""

import asyncio
import os
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

from gcd_dataset.errors import DrapeError, GcdError
from gcd_dataset.generator.drape import resolve_device
from gcd_dataset.generator.drapers.draper import DrapeReply, DrapeRequest, require_faces
from gcd_dataset.generator.drapers.process import Inbox
from gcd_dataset.generator.drapers.shared import AT_ONCE

__all__ = ["DrapingActor", "RayDraper", "start_actor"]

LOSSES = 4  # actors that may die with a garment before the garment is given up
RESTARTED = 120.0  # s within which one of the actors answers again
FAREWELL = 1.0  # s for the last answers of an actor to be sent


def start_actor(device: str, *, gpus: float) -> Any:
    """A handle of a new actor that drapes on ``device`` and takes a share of a GPU; Ray restarts it where it dies."""
    import ray

    # Orders are not repeated by Ray: it would wait for the GPU that has gone while another could drape them.
    options = {"num_gpus": gpus, "num_cpus": 0, "max_restarts": -1, "max_task_retries": 0}
    return ray.remote(**options)(DrapingActor).remote(device)


class RayDraper:
    """Orders garments from the first of several actors; those that are lost with it, from the next that stands.

    Raises ``DrapeError`` for a garment with which ``LOSSES`` actors died, and where none answers for two minutes.
    """

    def __init__(self, actors: Sequence[Any], *, at_once: int = AT_ONCE) -> None:
        import ray  # an extra

        self._ray = ray
        self.at_once = at_once
        self._actors = deque(actors)
        self._asked: dict[Any, tuple[DrapeRequest, int]] = {}
        """The order and how often it was lost, by the reference of its answer."""

    def ask(self, order: DrapeRequest) -> None:
        require_faces(order)
        self._send(order, 0)

    def answered(self) -> bool:
        return bool(self._asked) and bool(self._ray.wait(list(self._asked), timeout=0)[0])

    def answer(self) -> DrapeReply:
        while True:
            [reference], _ = self._ray.wait(list(self._asked), num_returns=1)
            order, losses = self._asked.pop(reference)
            try:
                answer = self._ray.get(reference)
            except self._ray.exceptions.RayError as error:
                answer = Broken(type(error).__name__)
            if isinstance(answer, DrapeReply):
                return answer
            if isinstance(answer, str):
                raise DrapeError(f"while draping on a GPU of the Ray cluster: {answer}")
            if losses + 1 == LOSSES:
                raise DrapeError(
                    f"{LOSSES} draping actors of the Ray cluster died with a garment, the last by {answer.reason}: see "
                    "their logs (ray list actors), then give the same command again: it goes on from here"
                )
            self._find_standing()
            self._send(order, losses + 1)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._asked.clear()

    def _send(self, order: DrapeRequest, losses: int) -> None:
        self._asked[self._actors[0].drape.remote(order)] = order, losses

    def _find_standing(self) -> None:
        """Put an actor that answers before the others. Raises ``DrapeError`` where none does."""
        calls = {actor.ready.options(max_task_retries=-1).remote(): actor for actor in self._actors}
        while calls:
            answered, _ = self._ray.wait(list(calls), num_returns=1, timeout=RESTARTED)
            if not answered:
                break
            actor = calls.pop(answered[0])
            try:
                self._ray.get(answered[0])
            except self._ray.exceptions.RayError:
                continue
            self._actors.remove(actor)
            self._actors.appendleft(actor)
            return
        raise DrapeError(
            "no GPU of the Ray cluster drapes any more: see ray status, then give the same command again: it goes on "
            "from here"
        )


@dataclass(frozen=True)
class Broken:
    """The answer of an actor that ends."""

    reason: str


class DrapingActor:
    """Drapes on one device the garments that any number of tasks order; made a Ray actor by ``start_actor``.

    An error of ours is answered, as text. Any other, such as those of a GPU that has fallen out, ends the process.
    Raises ``ConfigError`` for a device that is not there.
    """

    def __init__(self, device: str) -> None:
        self._device = resolve_device(device)
        self._inbox = Inbox()
        self._callers: set[_Caller] = set()
        self._ended: str | Broken | None = None
        threading.Thread(target=self._drape, daemon=True).start()

    async def ready(self) -> str:
        """The identifier of its node, as soon as it can drape."""
        import ray

        return str(ray.get_runtime_context().get_node_id())

    async def drape(self, order: DrapeRequest) -> DrapeReply | str | Broken:
        """The garment at rest, or the error that ended the draping."""
        caller = _Caller()
        self._callers.add(caller)
        try:
            if self._ended is not None:
                return self._ended
            await asyncio.to_thread(self._inbox.put, caller, order)
            return await caller.answer
        finally:
            caller.there = False
            self._callers.discard(caller)

    def _drape(self) -> None:
        try:
            while True:
                self._inbox.drape(self._device)
        except GcdError as error:
            self._end(str(error))
        except Exception as error:  # noqa: BLE001 - ends the process: CUDA takes no call after one that failed
            self._end(Broken(" ".join(str(error).split()) or type(error).__name__))
            threading.Timer(FAREWELL, os._exit, [1]).start()

    def _end(self, reason: "str | Broken") -> None:
        self._ended = reason
        for caller in list(self._callers):
            caller.tell(reason)


class _Caller:
    """One order that waits for its answer in the actor's event loop."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self.answer: asyncio.Future[DrapeReply | str | Broken] = self._loop.create_future()
        self.there = True

    def tell(self, answer: DrapeReply | str | Broken) -> None:
        self._loop.call_soon_threadsafe(self._set, answer)

    def _set(self, answer: DrapeReply | str | Broken) -> None:
        if not self.answer.done():
            self.answer.set_result(answer)
