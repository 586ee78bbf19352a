"""Exponential back-off for servers that are busy or unreachable."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass

from gcd_dataset.errors import RemoteError

__all__ = ["PATIENCE", "Backoff", "RetryableError", "first_line"]

PATIENCE = 30.0  # s of waiting without a received byte
FIRST_WAIT, LAST_WAIT = 0.5, 60.0  # s: each wait is twice the last, up to LAST_WAIT
REQUESTED_WAITS = 6  # consecutive waits that a server may request (Retry-After)
LONGEST_WAIT = 300.0  # s; after a request for a longer wait the server is given up

log = logging.getLogger(__name__)


class RetryableError(Exception):
    """A temporary error: the request is retried.

    ``wait``: seconds until the retry, if the server has requested a time. ``is_unreachable``: there was no connection.
    """

    def __init__(self, message: str, wait: float | None = None, *, is_unreachable: bool = False) -> None:
        super().__init__(message)
        self.wait, self.is_unreachable = wait, is_unreachable


@dataclass
class Backoff:
    """Attempts and waits since the last received byte."""

    patience: float | None = None
    """Seconds; ``None`` for ``PATIENCE``."""
    attempts: int = 0
    waited: float = 0.0
    """Seconds."""
    requested: int = 0
    """Waits requested by the server."""

    def wait(
        self,
        address: str,
        error: RetryableError,
        *,
        retry_unreachable: bool = True,
        sleep: Callable[[float], object] | None = None,
    ) -> None:
        """Sleep before the next attempt. Raises ``RemoteError`` with ``address`` when the patience is exhausted.

        ``retry_unreachable=False``: raise it at once for an unreachable server. ``sleep`` returns true to give up.
        """
        seconds = self.next_wait(error.wait)
        if error.is_unreachable and not retry_unreachable:
            seconds = None
        if seconds is not None:
            log.info("%s: %s: next attempt in %.1f s", address, error, seconds)
        if seconds is None or (sleep or time.sleep)(seconds):
            raise RemoteError(
                f"{address}: {error}, {self}: try again later, or with more patience (--patience, patience=); received "
                "data are kept"
            )

    def next_wait(self, requested: float | None) -> float | None:
        """Seconds to the next attempt: ``requested``, or a back-off; ``None`` when the patience is exhausted."""
        self.attempts += 1
        patience = PATIENCE if self.patience is None else self.patience
        if requested is not None:
            self.requested += 1
            wait = requested
            over = self.requested > REQUESTED_WAITS or requested > max(LONGEST_WAIT, patience)
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
    """The first line of an error's message; its type where the message is empty."""
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
