"""How far a verb has come."""

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Self

__all__ = ["Progress", "Told", "unheard"]

SETTLED = "SETTLED"  # the name of the outcome


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


Told = Callable[[Progress], None]
"""Called before the first sample, and after each."""


def unheard(progress: Progress) -> None:
    """Where nobody asked to be told."""
