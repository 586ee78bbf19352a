"""Drapers of a Ray cluster: actors, two for each GPU, that the tasks of all nodes share."""

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
from gcd_dataset.generator.drapers.process import RequestQueue
from gcd_dataset.generator.drapers.shared import AT_ONCE

__all__ = ["DrapingActor", "RayDraper", "start_actor"]

MAX_LOSSES = 4  # deaths of actors while draping the same garment, after which the client gives up
RESTART_TIME = 120.0  # s within which an actor must reply again
EXIT_DELAY = 1.0  # s for the last replies of an actor to be sent


def start_actor(device: str, *, gpus: float) -> Any:
    """The handle of a new actor that drapes on ``device`` with a share of a GPU; Ray restarts it after a crash."""
    import ray

    # No retries by Ray: it would wait for the lost GPU while another actor could drape the garment.
    options = {"num_gpus": gpus, "num_cpus": 0, "max_restarts": -1, "max_task_retries": 0}
    return ray.remote(**options)(DrapingActor).remote(device)


class RayDraper:
    """Sends requests to the first of several actors; requests lost with an actor go to the next live one.

    Raises ``DrapeError`` if ``MAX_LOSSES`` actors died while draping one garment, or none replies for two minutes.
    """

    def __init__(self, actors: Sequence[Any], *, at_once: int = AT_ONCE) -> None:
        import ray  # an extra

        self._ray = ray
        self.at_once = at_once
        self._actors = deque(actors)
        self._sent: dict[Any, tuple[DrapeRequest, int]] = {}
        """The request and how often it was lost, by the reference of its reply."""

    def send(self, request: DrapeRequest) -> None:
        require_faces(request)
        self._send(request, 0)

    def poll(self) -> bool:
        return bool(self._sent) and bool(self._ray.wait(list(self._sent), timeout=0)[0])

    def receive(self) -> DrapeReply:
        while True:
            [reference], _ = self._ray.wait(list(self._sent), num_returns=1)
            request, losses = self._sent.pop(reference)
            try:
                reply = self._ray.get(reference)
            except self._ray.exceptions.RayError as error:
                reply = ActorLost(type(error).__name__)
            if isinstance(reply, DrapeReply):
                return reply
            if isinstance(reply, str):
                raise DrapeError(f"while draping on a GPU of the Ray cluster: {reply}")
            if losses + 1 == MAX_LOSSES:
                raise DrapeError(
                    f"a garment was sent to {MAX_LOSSES} draping actors of the Ray cluster in turn, and each ended "
                    f"before it replied, the last with {reply.reason}: read their logs (ray list actors, ray logs "
                    "actor --id ID), then give the same command again to continue"
                )
            self._find_live_actor()
            self._send(request, losses + 1)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._sent.clear()

    def _send(self, request: DrapeRequest, losses: int) -> None:
        self._sent[self._actors[0].drape.remote(request)] = request, losses

    def _find_live_actor(self) -> None:
        """Move an actor that replies to the front. Raises ``DrapeError`` if there is none."""
        calls = {actor.ready.options(max_task_retries=-1).remote(): actor for actor in self._actors}
        while calls:
            replied, _ = self._ray.wait(list(calls), num_returns=1, timeout=RESTART_TIME)
            if not replied:
                break
            actor = calls.pop(replied[0])
            try:
                self._ray.get(replied[0])
            except self._ray.exceptions.RayError:
                continue
            self._actors.remove(actor)
            self._actors.appendleft(actor)
            return
        raise DrapeError(
            f"no draping actor of the Ray cluster replies: all {len(self._actors)} have ended, or did not restart "
            f"within {RESTART_TIME:.0f} s: look for lost GPUs (ray status, ray list actors), then give the same "
            "command again to continue"
        )


@dataclass(frozen=True)
class ActorLost:
    """Takes the place of a reply: the actor has ended, or is about to end."""

    reason: str


class DrapingActor:
    """Drapes the requests of any number of tasks on one device; ``start_actor`` makes it a Ray actor.

    After a ``GcdError`` every waiting request gets its message as the reply. Any other error, such as a lost GPU, ends
    the process. Raises ``ConfigError`` for an unknown device.
    """

    def __init__(self, device: str) -> None:
        self._device = resolve_device(device)
        self._requests = RequestQueue()
        self._clients: set[_Client] = set()
        self._ended: str | ActorLost | None = None
        threading.Thread(target=self._drape, daemon=True).start()

    async def ready(self) -> str:
        """The identifier of the actor's node, as soon as the actor can drape."""
        import ray

        return str(ray.get_runtime_context().get_node_id())

    async def drape(self, request: DrapeRequest) -> DrapeReply | str | ActorLost:
        """The reply, or the error that ended the draping."""
        client = _Client()
        self._clients.add(client)
        try:
            if self._ended is not None:
                return self._ended
            await asyncio.to_thread(self._requests.put, client, request)
            return await client.result
        finally:
            client.connected = False
            self._clients.discard(client)

    def _drape(self) -> None:
        try:
            while True:
                self._requests.drape(self._device)
        except GcdError as error:
            self._end(str(error))
        except Exception as error:  # noqa: BLE001 - ends the process: CUDA rejects all calls after a failed one
            self._end(ActorLost(" ".join(str(error).split()) or type(error).__name__))
            threading.Timer(EXIT_DELAY, os._exit, [1]).start()

    def _end(self, reason: "str | ActorLost") -> None:
        self._ended = reason
        for client in list(self._clients):
            client.reply(reason)


class _Client:
    """A request that waits for its reply in the actor's event loop."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self.result: asyncio.Future[DrapeReply | str | ActorLost] = self._loop.create_future()
        self.connected = True

    def reply(self, reply: DrapeReply | str | ActorLost) -> None:
        self._loop.call_soon_threadsafe(self._set, reply)

    def _set(self, reply: DrapeReply | str | ActorLost) -> None:
        if not self.result.done():
            self.result.set_result(reply)
