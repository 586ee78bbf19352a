"""How far a verb has come."""

import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

from gcd_dataset.waits import Wait, Waits, sum_waits, wait_shares

__all__ = ["SETTLED", "Pace", "Progress", "Told", "unheard"]

SETTLED = "SETTLED"  # the name of the outcome
WINDOW = 60.0  # s over which rates and waits are taken


@dataclass(frozen=True)
class Progress:
    """How many samples there are to be, and what has become of those that were worked on."""

    count: int
    """Samples to be there in the end."""
    there: int
    """Samples that an earlier call has finished."""
    made: int = 0
    """Samples finished by this call."""
    split: str = "train"
    """The split that is worked on."""
    rejects: Counter[str] = field(default_factory=Counter)
    """Designs and drapes turned down on the way to them, by the rule they broke."""
    outcomes: Counter[str] = field(default_factory=Counter)
    """How their drapes ended, by the name of the ``Outcome``."""
    left_out: tuple[str, ...] = ()
    """Samples that could not be made, with the reason."""
    rate: float | None = None
    """Samples a second over the last minute; ``None`` where it is not taken."""
    waits: Mapping[str, float] = field(default_factory=dict)
    """Share of the last minute in which the draping processes of each GPU waited for orders, by device; ``makers`` for
    the writer to take their samples, where they are processes of their own; ``writer`` for samples."""

    @property
    def left_s(self) -> float | None:
        """Seconds left at the rate of the last minute; ``None`` where that is not known, or nothing was made in it."""
        return max(self.count - self.done, 0) / self.rate if self.rate else None

    @property
    def done(self) -> int:
        """Samples that are there now."""
        return self.there + self.made

    @property
    def unsettled(self) -> int:
        """Samples of this call whose drapes did not settle."""
        return self.outcomes.total() - self.outcomes[SETTLED]

    def with_sample(self, *, rejects: Iterable[str] = (), outcome: str | None = None) -> Self:
        """One sample further; ``rejects`` are rules, and what broke them after a colon."""
        turned_down = self.rejects + Counter(reason.partition(":")[0] for reason in rejects)
        ended = self.outcomes if outcome is None else self.outcomes + Counter([outcome])
        return replace(self, made=self.made + 1, rejects=turned_down, outcomes=ended)

    def without_sample(self, fault: str) -> Self:
        """One sample left out, for a reason."""
        return replace(self, left_out=(*self.left_out, fault))


class _Mark(NamedTuple):
    time: float
    made: int
    waits: Waits
    """Since the beginning."""


class Pace:
    """Takes the rate and the waits of the last minute.

    ``clock``: seconds from any beginning; ``every``: seconds between two marks, which are kept for a minute.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic, *, every: float = 1.0) -> None:
        self._clock, self._every = clock, every
        self._waits: Waits = {}
        self._marks = deque([_Mark(clock(), 0, {})])

    def of(self, progress: Progress, waits: Waits) -> Progress:
        """The progress with its pace; ``waits``: those since the last call."""
        now, marks = self._clock(), self._marks
        self._waits = sum_waits(self._waits, waits)
        while len(marks) > 1 and now - marks[1].time >= WINDOW:
            marks.popleft()
        first = marks[0]
        if now - marks[-1].time >= self._every:
            marks.append(_Mark(now, progress.made, self._waits))
        if now <= first.time:
            return progress
        minute = sum_waits(self._waits, {name: Wait(-wait.idle, -wait.over) for name, wait in first.waits.items()})
        return replace(progress, rate=(progress.made - first.made) / (now - first.time), waits=wait_shares(minute))


Told = Callable[[Progress], None]
"""Called before the first sample, and after each."""


def unheard(progress: Progress) -> None:
    """Where nobody asked to be told."""
