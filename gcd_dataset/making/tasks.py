"""The tasks of a data set: one for each shard, a function of its plan alone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from gcd_dataset.errors import ConfigError
from gcd_dataset.shards.access import Place
from gcd_dataset.shards.manifest import Plan, shard_name
from gcd_dataset.shards.writer import shard_size_of

MOST = 10_000_000  # samples of a data set


class Task(NamedTuple):
    """A shard to make."""

    plan: Plan
    split: str
    number: int
    indices: Sequence[int]
    """Indices of its samples, ascending."""

    @property
    def tar(self) -> str:
        """The name of the shard's file, which exists when the task is done."""
        return shard_name(self.split, self.number)


@dataclass(frozen=True)
class Work:
    """A data set to make."""

    place: Place
    plan: Plan
    """Of all splits; each task has that of its split."""
    splits: Mapping[str, Sequence[int]]
    """Split to the indices of its samples, ascending."""
    wearers: int = 1
    """Samples of a design, which lie in one shard."""
    files: Mapping[str, bytes] = field(default_factory=dict)
    """Name to content of the files beside the shards."""

    def tasks(self) -> list[Task]:
        """The tasks of all splits, in their order."""
        tasks = []
        for split, indices in self.splits.items():
            size = shard_size_of(len(indices), self.wearers)
            plan = replace(self.plan, shard_size=size)
            for number, first in enumerate(range(0, len(indices), size)):
                tasks.append(Task(plan, split, number, indices[first : first + size]))
        return tasks


class Job(NamedTuple):
    """One of several jobs that make a data set together: every ``of``-th task, from task ``number`` on."""

    number: int
    of: int

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"


def parse_job(text: str) -> Job:
    """The job ``I/N``, counted from 0. Raises ``ConfigError``.

    >>> parse_job("2/8")
    Job(number=2, of=8)
    """
    number, slash, of = text.partition("/")
    if slash and number.isdecimal() and of.isdecimal() and int(number) < int(of):
        return Job(int(number), int(of))
    raise ConfigError(f"job {text[:40]!r}: give I/N, such as 0/8: job I of N, counted from 0")


def check_count(count: int) -> int:
    """``count``, if a data set can have so many samples. Raises ``ConfigError`` otherwise."""
    if not 1 <= count <= MOST:
        raise ConfigError(f"count is {count if count < 10**15 else '10**15 or more'}: give 1 to {MOST}")
    return count
