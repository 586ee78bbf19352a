"""The ``gcd`` command: parses the options, calls one function of the library, prints its result.

Errors are one line on stderr. Exit 2 for wrong usage: an unknown verb, option, value or name, or options that do not
fit each other, this machine or the existing data set. Exit 1 for bad input: missing or damaged files, or files without
the requested content. Exit 130 after Ctrl-C, 143 after SIGTERM.
"""

import argparse
import logging
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gcd_dataset import __version__
from gcd_dataset.cli import datasets, exchange, garment, generate, reconstruct, scoring, show
from gcd_dataset.cli.common import Parser, Stopped, interrupts_after_imports
from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.files import discard_stdout, user_path

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``gcd`` with ``arguments`` (default: those of this process) and return its exit code."""
    with interrupts_after_imports(process_ends=arguments is None):
        return _run(arguments)


def _run(arguments: Sequence[str] | None) -> int:
    """The exit code of ``gcd`` with ``arguments``."""
    name = "gcd"
    try:
        logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
        logging.getLogger("gcd_dataset").setLevel(logging.INFO)
        options = _parse(arguments)
        # Shells do not expand ``--out=~/x``.
        options = argparse.Namespace(**{name: _expanded(value) for name, value in vars(options).items()})
        name = f"gcd {options.verb}"
        return int(options.run(options))
    except KeyboardInterrupt as error:
        stopped = Stopped.of(error)
        print(f"{name}: {stopped}", file=sys.stderr)
        return stopped.exit_code
    except ConfigError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 2
    except GcdError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 1
    except BrokenPipeError:
        discard_stdout()
        return 1


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The options of a command line. Exits 2 for wrong usage."""
    parser, verbs = _parser()
    options, left = parser.parse_known_args(arguments)
    if left:
        verbs[options.verb].unknown(left)
    return options


def _parser() -> tuple[Parser, Mapping[str, Parser]]:
    """The parser of ``gcd``, and the parser of each verb by name."""
    parser = Parser(prog="gcd", description="Made-to-measure garments with their sewing patterns.")
    parser.add_argument("--version", action="version", version=f"gcd_dataset {__version__}")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    for part in (generate, garment, reconstruct, show, scoring, datasets, exchange):
        part.add_verbs(verbs)
    return parser, verbs.choices


def _expanded(value: Any) -> Any:
    """The value of an option, with a leading ``~`` expanded in every path."""
    if isinstance(value, list):
        return [_expanded(entry) for entry in value]
    return type(value)(user_path(value)) if isinstance(value, str | Path) and str(value).startswith("~") else value
