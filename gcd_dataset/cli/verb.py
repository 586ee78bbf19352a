"""What the verbs of ``gcd`` have in common: how they are put into its parser, and how they end when stopped."""

import argparse
import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from gcd_dataset.errors import ConfigError

if TYPE_CHECKING:
    from gcd_dataset.shards.store import Store

__all__ = [
    "ANYWHERE",
    "INTERRUPTED",
    "add_quiet",
    "add_server",
    "add_verb",
    "interrupts_after_imports",
    "natural",
    "open_anywhere",
    "require_folder",
    "stopped",
]

INTERRUPTED = 130  # what shells call a program ended by Ctrl-C
RETRY = 0.05  # s between two looks whether an import has ended
ANYWHERE = "folder, URL, or repository ORG/NAME of the Hub"


def add_verb(verbs: Any, name: str, run: Callable[[argparse.Namespace], int], text: str) -> argparse.ArgumentParser:
    """The parser of a verb, put among ``verbs``; ``run`` gives the exit code."""
    parser: argparse.ArgumentParser = verbs.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
    parser.set_defaults(run=run)
    return parser


def add_quiet(parser: argparse.ArgumentParser) -> None:
    """Give a verb with a progress bar the option to leave it out."""
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def add_server(parser: argparse.ArgumentParser) -> None:
    """Give a verb that reads or writes repositories the option to say where they are."""
    parser.add_argument("--endpoint", metavar="URL", help="of the Hub (default: HF_ENDPOINT, or huggingface.co)")


def natural(text: str) -> int:
    """An option that is a number of things."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text} is no whole number of 0 or more")
    return int(text)


@contextlib.contextmanager
def interrupts_after_imports() -> Iterator[None]:
    """Deliver Ctrl-C when no import is under way: trimesh takes it for a missing package, and goes on.

    Nothing is different where Python does not handle Ctrl-C itself, or outside the main thread.
    """
    inside = threading.current_thread() is threading.main_thread()
    if not inside or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    later: list[threading.Timer] = []

    def interrupted(number: int, frame: FrameType | None) -> None:
        for timer in later:
            timer.cancel()
        later.clear()
        if not _importing(frame):
            raise KeyboardInterrupt
        later.append(threading.Timer(RETRY, os.kill, (os.getpid(), signal.SIGINT)))
        later[0].daemon = True
        later[0].start()

    signal.signal(signal.SIGINT, interrupted)
    try:
        yield
        if later:
            raise KeyboardInterrupt
    finally:
        for timer in later:
            timer.cancel()
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _importing(frame: FrameType | None) -> bool:
    """Whether an import is among the calls that led here."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def stopped(verb: str, there: str) -> int:
    """The exit code of a verb ended by Ctrl-C, told with what is there: the same command goes on from that."""
    print(f"gcd {verb}: stopped at {there}: the same command goes on from there", file=sys.stderr)
    return INTERRUPTED


def require_folder(source: str) -> Path:
    """The folder of a data set. Raises ``ConfigError`` for anything else, and says how what is elsewhere comes here."""
    from gcd_dataset.hub.place import Folder, find_place
    from gcd_dataset.shards.access import reading

    if "://" in source:
        place = find_place(source)
        if isinstance(place, Folder):
            return place.path
        raise ConfigError(
            f"{source}: not on this machine: run gcd download {source} first, and give the folder that it makes"
        )
    with reading(Path(source)):
        if Path(source).is_dir():
            return Path(source)
    raise ConfigError(
        f"{source}: no such folder: give a folder of shards; for a repository of the Hub, run gcd download first"
    )


def open_anywhere(source: str, endpoint: str | None) -> "Store":
    """The data set in a folder, at a URL, or in a repository at ``endpoint``. Raises ``ConfigError``."""
    from gcd_dataset.hub.opening import open_store
    from gcd_dataset.hub.place import Repo, find_place
    from gcd_dataset.hub.site import Remote

    return open_store(source, Remote(endpoint=endpoint if isinstance(find_place(source), Repo) else None))
