"""The writer lock: a waiting process gets it as soon as its holder releases it."""

import fcntl
import os
from pathlib import Path

import pytest

from gcd_dataset.shards.access import locked


def test_a_process_forked_under_the_lock_does_not_keep_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers forked by a parent that holds the cache lock; another process waits for the lock."""
    first, real = locked(tmp_path / ".lock", "writing", wait=True), fcntl.flock
    ended, end = os.pipe()
    first.__enter__()
    child = os.fork()
    if child == 0:
        os.close(end)
        os.read(ended, 1)  # outlives the lock
        os._exit(0)

    def waited_for(file: int, operation: int) -> None:
        """The second process has opened the lock file when the first releases it."""
        monkeypatch.undo()
        with pytest.raises(BlockingIOError):
            real(file, operation | fcntl.LOCK_NB)
        first.__exit__(None, None, None)
        real(file, operation | fcntl.LOCK_NB)

    monkeypatch.setattr(fcntl, "flock", waited_for)
    try:
        with locked(tmp_path / ".lock", "writing", wait=True):
            assert (tmp_path / ".lock").exists()
    finally:
        os.close(end)
        os.waitpid(child, 0)
        os.close(ended)
