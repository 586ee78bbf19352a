"""CPU time of imports and of ``gcd --help``, each in a fresh interpreter: user and system time, least of the rounds.

``python`` is an interpreter that does nothing; it is part of the other figures. ``loaders_beside_torch`` is what
``import gcd_dataset.loaders`` takes beyond ``import torch``. Files are in the page cache, bytecode is compiled.
"""

import argparse
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence

from benchmarks.cases.figures import Figure, Measured
from gcd_dataset.errors import ConfigError

COMMANDS: Mapping[str, Sequence[str]] = {
    "python": ("-c", "pass"),
    "gcd_dataset": ("-c", "import gcd_dataset"),
    "gcd_help": ("-m", "gcd_dataset", "--help"),
    "torch": ("-c", "import torch"),
    "loaders": ("-c", "import gcd_dataset.loaders"),
    "viewer": ("-c", "import gcd_dataset.viewer.server"),
}
"""Figure to the arguments of the interpreter."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--rounds", type=int, default=5, help="runs of each command")


def run(options: argparse.Namespace) -> Measured:
    """Time the commands, in turn, so that other load on the machine affects all. Raises ``ConfigError``."""
    if options.rounds < 1:
        raise ConfigError(f"--rounds {options.rounds}: give 1 or more")
    rounds = [{name: _cpu_seconds(command) for name, command in COMMANDS.items()} for _ in range(options.rounds + 1)]
    best = {name: min(found[name] for found in rounds[1:]) for name in COMMANDS}  # the first compiles bytecode
    figures = [Figure(f"{name}_cpu_s", seconds, "CPU-s") for name, seconds in best.items()]
    return Measured([*figures, Figure("loaders_beside_torch_cpu_s", best["loaders"] - best["torch"], "CPU-s")])


def _cpu_seconds(arguments: Sequence[str]) -> float:
    """User and system time of an interpreter and its children."""
    before = os.times()
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system
