"""The progress bar of a verb."""

import sys
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from gcd_dataset.verbs.progress import Progress, Told

if TYPE_CHECKING:
    from tqdm import tqdm

__all__ = ["Bar"]


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
        counts = {"rejected": progress.rejects.total(), "unsettled": progress.unsettled}
        self._bar.set_postfix({name: count for name, count in counts.items() if count}, refresh=False)
        self._bar.update(progress.done + len(progress.left_out) - self._bar.n)

    def _begin(self, progress: Progress) -> None:
        from tqdm import tqdm

        self._end()
        self.progress = Progress(progress.count, progress.there, split=progress.split)
        self._bar = tqdm(
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
