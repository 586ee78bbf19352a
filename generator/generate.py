"""Making a data set: samples into shards, going on where an earlier run was stopped."""

import multiprocessing
import signal
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.pipeline import MakeConfig, device_kind, make, make_many, recipe_of
from gcd_dataset.records import Sample
from gcd_dataset.shards import ShardWriter

__all__ = ["Plan", "generate", "plan"]

AHEAD = 2  # samples in work for each process, so that none waits for the writer


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
    make samples side by side; on a GPU, where garments are draped together, this one does it.
    Raises ``OutputError`` where the shards cannot be written.
    """
    if not plan.missing:
        return
    with ShardWriter(plan.out, seed=plan.seed, recipe=recipe_of(plan.config)) as writer:
        for sample in _made(plan.seed, plan.missing, plan.config, workers):
            writer.write(sample)
            yield sample


def _made(seed: int, indices: Sequence[int], config: MakeConfig, workers: int) -> Iterator[Sample]:
    if workers < 2 or (config.stage == "drape" and device_kind(config) == "cuda"):
        yield from make_many(seed, indices, config)
        return
    with _processes(workers) as pool:
        rest = iter(indices)
        made = [pool.submit(partial(make, seed, index, config)) for index in islice(rest, AHEAD * workers)]
        while made:
            yield made.pop(0).result()
            made += [pool.submit(partial(make, seed, index, config)) for index in islice(rest, 1)]


@contextmanager
def _processes(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that leave Ctrl-C to the caller, and that are not waited for when it comes."""
    # Not forked: threads that Warp or torch may have started here would not live on there.
    context = multiprocessing.get_context("forkserver" if "forkserver" in _methods() else "spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_ignore_interrupts)
    try:
        yield pool
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _methods() -> list[str]:
    return multiprocessing.get_all_start_methods()


def _ignore_interrupts() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
