"""Making a data set: samples into shards, going on where an earlier run was stopped."""

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import groupby, islice
from multiprocessing.connection import Connection
from pathlib import Path

from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.generator.pipeline import make_many
from gcd_dataset.generator.recipe import MakeConfig, device_kind, recipe_of
from gcd_dataset.records import Sample
from gcd_dataset.shards import ShardWriter

__all__ = ["Plan", "generate", "plan"]

AHEAD = 2  # tasks in work for each process, so that none waits for the writer


@dataclass(frozen=True)
class Plan:
    """A data set to be made, and what of it is still missing."""

    out: Path
    count: int
    seed: int
    config: MakeConfig
    missing: tuple[int, ...]

    @property
    def there(self) -> int:
        """How many of its samples an earlier run has finished."""
        return self.count - len(self.missing)


def plan(out: Path | str, count: int, *, seed: int = 0, config: MakeConfig | None = None) -> Plan:
    """What it takes to have samples 0 … ``count`` - 1 of ``seed`` in ``out``.

    What a killed run left half-written in ``out`` is put in order. Raises ``ConfigError`` where ``out`` holds a data
    set of another recipe or seed, ``OutputError`` where it cannot be written.
    """
    config = config or MakeConfig()
    if count < 1:
        raise ConfigError(f"count is {count}: give 1 or more")
    with ShardWriter(out, seed=seed, recipe=recipe_of(config)) as writer:
        done = writer.done
    return Plan(Path(out), count, seed, config, tuple(index for index in range(count) if index not in done))


def generate(plan: Plan, *, workers: int = 0) -> Generator[Sample, None, None]:
    """Make and store what is missing, yielding each sample as it is stored.

    Stopped at any moment and planned again it goes on; the shards come out as the same bytes. ``workers`` processes
    make samples side by side on a CPU. On a GPU garments are draped together, by this process alone.
    Raises ``OutputError`` where the shards cannot be written, ``GcdError`` where a process is killed.
    """
    if not plan.missing:
        return
    with ShardWriter(plan.out, seed=plan.seed, recipe=recipe_of(plan.config)) as writer:
        for sample in _made(plan, workers):
            writer.write(sample)
            yield sample


def _made(plan: Plan, workers: int) -> Iterator[Sample]:
    if workers < 2 or (plan.config.stage == "drape" and device_kind(plan.config) == "cuda"):
        yield from make_many(plan.seed, plan.missing, plan.config)
        return
    designs = groupby(plan.missing, key=lambda index: index // plan.config.wearers)
    tasks = (tuple(indices) for _, indices in designs)
    with _processes(workers) as pool:

        def submitted(count: int) -> Iterator[Future[list[Sample]]]:
            return (pool.submit(_make, plan.seed, task, plan.config) for task in islice(tasks, count))

        at_work = deque(submitted(AHEAD * workers))
        while at_work:
            yield from _result(at_work.popleft())
            at_work.extend(submitted(1))


def _make(seed: int, indices: Sequence[int], config: MakeConfig) -> list[Sample]:
    return list(make_many(seed, indices, config))


def _result(task: Future[list[Sample]]) -> list[Sample]:
    try:
        return task.result()
    except BrokenProcessPool as error:
        raise GcdError("a worker process was killed, by lack of memory perhaps: go on with fewer --workers") from error


@contextmanager
def _processes(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that leave Ctrl-C to this one, and that end with the block, or with this process however it ends."""
    # Not forked: threads that Warp or torch may have started here would not live on there.
    context = multiprocessing.get_context("spawn")
    lifeline, held = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(lifeline,))
    try:
        yield pool
    finally:
        held.close()
        pool.shutdown(wait=False, cancel_futures=True)


def _begin(lifeline: Connection) -> None:
    """In a worker: leave interrupts to the parent, and end when it lets go of its end of the lifeline."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()


def _end_with(lifeline: Connection) -> None:
    lifeline.poll(None)
    os._exit(1)
