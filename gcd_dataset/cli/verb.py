"""What the verbs of ``gcd`` have in common: how they are put into its parser, and how they end when stopped."""

import argparse
import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn

from gcd_dataset.cli.examples import EXAMPLES
from gcd_dataset.errors import ConfigError, ShardError, did_you_mean, shown

if TYPE_CHECKING:
    from gcd_dataset.shards.store import Store

__all__ = [
    "ANYWHERE",
    "INTERRUPTED",
    "NAMES",
    "Parser",
    "add_quiet",
    "add_server",
    "add_verb",
    "body_name",
    "interrupts_after_imports",
    "natural_number",
    "open_anywhere",
    "processes",
    "require_folder",
    "stopped",
]

INTERRUPTED = 130  # what shells call a program ended by Ctrl-C
RETRY = 0.05  # s between two looks whether an import has ended
WRONG_USAGE = 2
ANYWHERE = "folder, URL, or repository ORG/NAME of the Hub"
MEAN, DRAWN = ("neutral", "female", "male"), ("random", "female", "male")
NAMES = ", ".join((*MEAN, *(f"{kind}:SEED" for kind in DRAWN)))
"""Of bodies."""


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, with the nearest word that it knows."""

    more: Callable[[], None] | None = None
    """Adds the options that are slow to look up, once this parser is at work."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse, with all options."""
        if self.more is not None:
            self.more()
            self.more = None
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Exit 2."""
        self.exit(WRONG_USAGE, f"{self.prog}: {message} ({self.prog} --help lists what there is)\n")

    def unknown(self, words: Sequence[str]) -> NoReturn:
        """Exit 2 for words that are left over."""
        options = [option for action in self._actions for option in action.option_strings]
        what = "no option" if words[0].startswith("-") else "more than is asked for:"
        self.error(f"{what} {shown(words[0])}{did_you_mean(words[0].partition('=')[0], options)}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            known = list(map(str, action.choices))
            said = f"no {shown(str(value))}: there is {', '.join(known)}{did_you_mean(str(value), known)}"
            raise argparse.ArgumentError(action, said)


def body_name(text: str) -> str:
    """An option that is the name of a body, or a mesh file."""
    kind, drawn, seed = text.partition(":")
    if drawn and kind in DRAWN and not seed.isdecimal():
        raise argparse.ArgumentTypeError(
            f"{shown(text)}: the seed is {shown(seed) or 'nothing'}: give a whole number of 0 or more, such as {kind}:7"
        )
    if (drawn and kind in DRAWN) or text in MEAN or Path(text).suffix or Path(text).exists():
        return text
    nearest = did_you_mean(kind, DRAWN if drawn else {*MEAN, *DRAWN})
    raise argparse.ArgumentTypeError(f"no body named {shown(text)}: there are {NAMES}, or a mesh file{nearest}")


def add_verb(verbs: Any, name: str, run: Callable[[argparse.Namespace], int], text: str) -> Parser:
    """The parser of a verb, put among ``verbs``; ``run`` gives the exit code."""
    parser: Parser = verbs.add_parser(
        name,
        help=text,
        description=f"{text[0].upper()}{text[1:]}.",
        epilog="\n  ".join(["examples:", *EXAMPLES[name]]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run)
    return parser


def add_quiet(parser: argparse.ArgumentParser) -> None:
    """Give a verb with a progress bar the option to leave it out."""
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def add_server(parser: argparse.ArgumentParser) -> None:
    """Give a verb that reads or writes repositories the option to say where they are."""
    parser.add_argument("--endpoint", metavar="URL", help="of the Hub (default: HF_ENDPOINT, or huggingface.co)")


def processes(text: str) -> int | None:
    """An option that is a number of processes, or ``auto``, which is ``None``."""
    return None if text == "auto" else natural_number(text)


def natural_number(text: str) -> int:
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
    """The folder of a data set. Raises ``ShardError`` where there is none, ``ConfigError`` for one elsewhere."""
    from gcd_dataset.hub.source import Folder, parse_source
    from gcd_dataset.shards.access import reading

    if "://" in source:
        place = parse_source(source)
        if isinstance(place, Folder):
            return place.path
        raise ConfigError(
            f"{source}: not on this machine: run gcd download {source} first, and give the folder that it makes"
        )
    with reading(Path(source)):
        if Path(source).is_dir():
            return Path(source)
        met = "a file, not a folder of shards" if Path(source).exists() else "no such folder"
    raise ShardError(
        f"{shown(source)}: {met}: give a folder of shards; for a repository of the Hub, run gcd download first"
    )


def open_anywhere(source: str, endpoint: str | None) -> "Store":
    """The data set in a folder, at a URL, or in a repository at ``endpoint``. Raises ``ShardError``."""
    from gcd_dataset.hub.opening import open_store
    from gcd_dataset.hub.site import Remote
    from gcd_dataset.hub.source import Repo, parse_source

    try:
        place = parse_source(source)
    except ConfigError as error:  # a path that leads nowhere is bad input, to every verb
        raise ShardError(str(error)) from error
    return open_store(source, Remote(endpoint=endpoint if isinstance(place, Repo) else None))
