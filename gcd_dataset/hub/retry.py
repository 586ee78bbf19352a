"""Waiting for a server that is busy, or gone for a while."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass

from gcd_dataset.errors import RemoteError

__all__ = ["PATIENCE", "Backoff", "RetryableError", "first_line"]

PATIENCE = 30.0  # s of waits between attempts that brought nothing
FIRST_WAIT, LAST_WAIT = 0.5, 60.0  # s: each wait is twice the one before, up to the last
ASKED_WAITS = 6  # in a row that a server may ask for
LONGEST_WAIT = 300.0  # s; a server that asks for more is given up

log = logging.getLogger(__name__)


class RetryableError(Exception):
    """What may pass; ``wait``: seconds that the server asks for; ``is_unreachable``: there is nobody to ask."""

    def __init__(self, what: str, wait: float | None = None, *, is_unreachable: bool = False) -> None:
        super().__init__(what)
        self.wait, self.is_unreachable = wait, is_unreachable


@dataclass
class Backoff:
    """The attempts since a byte came last."""

    patience: float | None = None
    """Seconds; ``None`` for ``PATIENCE``."""
    attempts: int = 0
    waited: float = 0.0
    asked: int = 0
    """Waits that the server asked for."""

    def rest(
        self,
        where: str,
        trouble: RetryableError,
        *,
        patient: bool = True,
        sleep: Callable[[float], object] | None = None,
    ) -> None:
        """Wait before the next attempt. Raises ``RemoteError`` with ``where`` if there shall be none.

        Not ``patient``: where nobody answers at all, there is no second attempt. ``sleep`` gives true where the wait
        was broken off for good.
        """
        wait = self.next_wait(trouble.wait)
        if trouble.is_unreachable and not patient:
            wait = None
        if wait is not None:
            log.info("%s: %s: once more in %.1f s", where, trouble, wait)
        if wait is None or (sleep or time.sleep)(wait):
            raise RemoteError(
                f"{where}: {trouble}, {self}: try again later, or with more patience (--patience, patience=); what has "
                "come is kept"
            )

    def next_wait(self, asked: float | None) -> float | None:
        """Seconds to the next attempt, ``asked`` if the server said so; ``None`` where there shall be none."""
        self.attempts += 1
        patience = PATIENCE if self.patience is None else self.patience
        if asked is not None:
            self.asked += 1
            wait = asked
            over = self.asked > ASKED_WAITS or asked > max(LONGEST_WAIT, patience)
        else:
            wait = min(FIRST_WAIT * 2 ** min(self.attempts - 1, 16), LAST_WAIT, patience - self.waited)
            over = wait <= 0
        if over:
            return None
        self.waited += wait
        return wait

    def __str__(self) -> str:
        return f"after {self.attempts} attempt{'s' if self.attempts > 1 else ''} and {self.waited:.0f} s of waiting"


def first_line(error: object) -> str:
    """What an error says, in one line."""
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
