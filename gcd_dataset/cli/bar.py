"""The progress bar of a verb."""

import sys
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from gcd_dataset.cli.common import Stopped
from gcd_dataset.making.progress import SETTLED, Progress

if TYPE_CHECKING:
    from tqdm import tqdm

MOST_RULES = 3  # rules named in the bar


class Bar:
    """A progress bar on stderr, a new one for each split; keeps the latest progress.

    ``verb``: the verb named in lines about skipped samples; ``again``: how to go on after a signal.
    """

    def __init__(
        self, unit: str, quiet: bool, *, verb: str = "generate", again: str = "the same command continues from there"
    ) -> None:
        self._unit, self._quiet, self._verb, self._again = unit, quiet, verb, again
        self._bar: tqdm[Any] | None = None
        self.progress = Progress(0, 0)
        """The latest progress."""

    def run(self, work: Callable[..., Any]) -> Any:
        """The result of ``work(on_progress=…)``. Raises ``Stopped``, with the latest progress, after a signal."""
        try:
            return work(on_progress=self.show)
        except KeyboardInterrupt as error:
            done = self.progress
            split = "" if done.split == "train" else f" of {done.split}"
            so_far = f" at {done.done} of {done.count}{split}" if done.count else ""
            raise Stopped(Stopped.of(error).number, f"{so_far}: {self._again}") from None

    def show(self, progress: Progress) -> None:
        """Update the bar; a ``ProgressCallback``."""
        if self._bar is None or progress.split != self.progress.split:
            self._begin(progress)
        assert self._bar is not None
        for fault in progress.skipped[len(self.progress.skipped) :]:
            self._bar.write(f"gcd {self._verb}: left out: {fault}", file=sys.stderr)
        self.progress = progress
        self._bar.set_postfix_str(postfix(progress), refresh=False)
        self._bar.update(progress.done + len(progress.skipped) - self._bar.n)

    def _begin(self, progress: Progress) -> None:
        from tqdm.auto import tqdm

        bar = self

        class Paced(tqdm):
            """A bar with the rate of the last minute and the time left at that rate, if measured."""

            @property
            def format_dict(self) -> dict[str, Any]:
                return {**super().format_dict, **({} if bar.progress.rate is None else {"rate": bar.progress.rate})}

        self._end()
        self.progress = Progress(progress.count, progress.existing, split=progress.split)
        self._bar = Paced(
            total=progress.count,
            initial=progress.existing,
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
    """Text after the bar: outcomes other than settled, and rejected attempts by rule.

    >>> postfix(Progress(9, 0).with_made(["too_heavy: 3 kg"], "SETTLED"))
    'rejected 1 (too_heavy 1)'
    """
    parts = [f"{name.lower()} {count}" for name, count in progress.outcomes.most_common() if name != SETTLED]
    if rejected := progress.rejects.total():
        rules = [f"{rule} {count}" for rule, count in progress.rejects.most_common(MOST_RULES)]
        more = ["…"] if len(progress.rejects) > MOST_RULES else []
        parts.append(f"rejected {rejected} ({', '.join(rules + more)})")
    return ", ".join(parts)
