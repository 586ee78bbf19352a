"""Reads the code blocks of a document, and runs its commands and programs as a user would."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent
BLOCK = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', re.MULTILINE | re.DOTALL)
TORCH_ABORT = "terminate called without an active exception"  # pytorch#179291: a gloo thread outlives Python
RANK_VARIABLES = ("RANK", "WORLD_SIZE", "LOCAL_RANK", "PYTHONUNBUFFERED")  # the last would interleave ranks' lines


class Block(NamedTuple):
    """A fenced block of code."""

    language: str
    title: str
    text: str

    def commands(self) -> Iterator[list[str]]:
        """The words of each line, without its comment."""
        for line in self.text.splitlines():
            if words := shlex.split(line, comments=True):
                yield words


def blocks_of(document: Path) -> list[Block]:
    """The code blocks of a document, in order."""
    return [Block(*found) for found in BLOCK.findall(document.read_text())]


def run(workspace: Path, *command: str) -> list[str]:
    """The output of a command; asserts success."""
    shutil.rmtree(workspace / "logs", ignore_errors=True)
    # ``torchrun`` and ``gcd`` of this environment, this tree's package, and without this process's own rank.
    env = {name: value for name, value in os.environ.items() if name not in RANK_VARIABLES}
    env |= {"PATH": f"{BIN}{os.pathsep}{env['PATH']}", "PYTHONPATH": str(ROOT)}
    env |= {"OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": ""}
    done = subprocess.run(command, cwd=workspace, env=env, capture_output=True, text=True, timeout=420, check=False)
    logs = {path: path.read_text() for path in (workspace / "logs").rglob("std*.log")}
    # torch may abort an exiting rank after the last barrier: its output is complete, and is checked.
    aborted = any(TORCH_ABORT in text for text in logs.values())
    problem = "".join([shlex.join(command), "\n", *logs.values(), done.stdout, done.stderr])[-6000:]
    assert done.returncode == 0 or aborted, problem
    return "".join([done.stdout, *(text for path, text in logs.items() if path.stem == "stdout")]).splitlines()
