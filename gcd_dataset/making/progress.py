"""Progress of a verb: counts, outcomes, rejects and rate."""

import time
from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

SETTLED = "SETTLED"  # name of ``Outcome.SETTLED``
WINDOW = 60.0  # s: rates are averages over the last minute
EVERY = 1.0  # s between two marks of the window, which begins at one


@dataclass(frozen=True)
class Progress:
    """Samples wanted, existing and made, with outcomes, rejects and rate."""

    count: int
    """Samples in the finished data set."""
    existing: int
    """Samples finished by earlier calls."""
    made: int = 0
    """Samples finished by this call."""
    split: str = "train"
    """The split being written."""
    rejects: Counter[str] = field(default_factory=Counter)
    """Rejected attempts of this call, by the rule they broke."""
    outcomes: Counter[str] = field(default_factory=Counter)
    """Outcomes of the drapes of this call, by the name of the ``Outcome``."""
    skipped: tuple[str, ...] = ()
    """Samples that could not be made, with the reason."""
    rate: float | None = None
    """Samples a second over the last minute; ``None`` if not measured."""

    @property
    def left_s(self) -> float | None:
        """Seconds left at the rate of the last minute; ``None`` if the rate is unknown or zero."""
        return max(self.count - self.done, 0) / self.rate if self.rate else None

    @property
    def done(self) -> int:
        """Samples finished so far, by this call and earlier ones."""
        return self.existing + self.made

    @property
    def unsettled(self) -> int:
        """Number of drapes of this call that did not settle."""
        return self.outcomes.total() - self.outcomes[SETTLED]

    def with_made(self, rejects: Iterable[str] = (), outcome: str | None = None, fault: str = "") -> Self:
        """The progress after one more sample, or one that was skipped for a ``fault``.

        ``rejects``: ``rule: reason`` of each rejected attempt.
        """
        if fault:
            return replace(self, skipped=(*self.skipped, fault))
        by_rule = self.rejects + Counter(reason.partition(":")[0] for reason in rejects)
        outcomes = self.outcomes if outcome is None else self.outcomes + Counter([outcome])
        return replace(self, made=self.made + 1, rejects=by_rule, outcomes=outcomes)


class _Mark(NamedTuple):
    """Samples made up to one point in time."""

    time: float
    made: int


class Pace:
    """Rate over a sliding window of a minute. ``clock``: time [s] from any origin."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._marks = deque([_Mark(clock(), 0)])

    def of(self, progress: Progress) -> Progress:
        """``progress`` with its rate."""
        now, marks = self._clock(), self._marks
        while len(marks) > 1 and now - marks[1].time >= WINDOW:
            marks.popleft()
        first = marks[0]
        if now - marks[-1].time >= EVERY:
            marks.append(_Mark(now, progress.made))
        if now <= first.time:
            return progress
        return replace(progress, rate=(progress.made - first.made) / (now - first.time))


ProgressCallback = Callable[[Progress], None]
"""Called with the progress before the first sample and after each."""


def ignore_progress(progress: Progress) -> None:
    """The default callback: does nothing."""
