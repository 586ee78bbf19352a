"""The progress bar of a verb."""

import sys
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from gcd_dataset.verbs.progress import SETTLED, Progress, Told

if TYPE_CHECKING:
    from tqdm import tqdm

__all__ = ["Bar", "postfix"]

MOST_RULES = 3  # that stand in the bar


class Bar:
    """Shows how far a verb has come, a line on stderr for each split, and keeps what it was told last.

    ``verb``: named in the lines about samples that are left out.
    """

    def __init__(self, unit: str, quiet: bool, *, verb: str = "generate") -> None:
        self._unit, self._quiet, self._verb = unit, quiet, verb
        self._bar: tqdm[Any] | None = None
        self.progress = Progress(0, 0)
        """The last that was told."""
        self.interrupted = False

    def run(self, work: Callable[..., Any]) -> Any:
        """What ``work`` returns when it is given ``told``; ``None`` where Ctrl-C ended it."""
        try:
            return work(told=self.told)
        except KeyboardInterrupt:
            self.interrupted = True
            return None

    @property
    def told(self) -> Told:
        """To be called with each progress."""
        return self._show

    def _show(self, progress: Progress) -> None:
        if self._bar is None or progress.split != self.progress.split:
            self._begin(progress)
        assert self._bar is not None
        for fault in progress.left_out[len(self.progress.left_out) :]:
            self._bar.write(f"gcd {self._verb}: left out: {fault}", file=sys.stderr)
        self.progress = progress
        self._bar.set_postfix_str(postfix(progress), refresh=False)
        self._bar.update(progress.done + len(progress.left_out) - self._bar.n)

    def _begin(self, progress: Progress) -> None:
        from tqdm import tqdm

        bar = self

        class Paced(tqdm):
            """Shows the rate of the last minute, and the time left at it, where that is taken."""

            @property
            def format_dict(self) -> dict[str, Any]:
                return {**super().format_dict, **({} if bar.progress.rate is None else {"rate": bar.progress.rate})}

        self._end()
        self.progress = Progress(progress.count, progress.there, split=progress.split)
        self._bar = Paced(
            total=progress.count,
            initial=progress.there,
            unit=self._unit,
            desc=None if progress.split == "train" else progress.split,
            disable=self._quiet,
        )

    def _end(self) -> None:
        if self._bar is not None:
            self._bar.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()


def postfix(progress: Progress) -> str:
    """What stands behind the bar: outcomes but settled ones, who waits, and designs turned down, by rule.

    >>> postfix(Progress(9, 0).with_sample(rejects=["too_heavy: 3 kg"], outcome="SETTLED"))
    'rejected 1 (too_heavy 1)'
    """
    parts = [f"{name.lower()} {count}" for name, count in progress.outcomes.most_common() if name != SETTLED]
    if progress.waits:
        parts.append("waits: " + " ".join(f"{name} {share:.0%}" for name, share in progress.waits.items()))
    if rejected := progress.rejects.total():
        rules = [f"{rule} {count}" for rule, count in progress.rejects.most_common(MOST_RULES)]
        more = ["…"] if len(progress.rejects) > MOST_RULES else []
        parts.append(f"rejected {rejected} ({', '.join(rules + more)})")
    return ", ".join(parts)
