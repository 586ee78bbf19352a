"""Give each reader many damaged inputs: ``python -m tests.fuzz.campaign --examples 10000 --report FILE``.

Inputs go one by one to a child process, with limits on time and memory for each.
"""

import argparse
import os
import pickle
import random
import resource
import select
import signal
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from benchmarks.cases import CaseResult
from benchmarks.run import report_text
from gcd_dataset.errors import GcdError
from tests.fuzz.inputs import edited, mutated
from tests.fuzz.readers import DOCUMENTS, READERS, Reader

SECONDS = 10.0  # s: limit on reading one input; long, since other programs share the cores
MEGABYTES = 1024  # MB: limit on the address space that reading one input may add
FAULTS = ("crash", "hang", "memory", "silent")
VERDICTS = ("read", "refused", *FAULTS)

ABOUT = """
Readers of files from outside, each given damaged files and documents: `make fuzz N=10000`. A file is damaged by one to
three edits of its bytes (bits, ranges, binary integers, numbers in text); a document by one to three edits of its tree.
`read` counts the inputs that were accepted: if checksums protect the file (shards, index, HDF5, body sets), an
accepted input was read as the original; otherwise it counts as `silent`. Limits for one input: 10 s and 1 GiB.
"""


@dataclass
class Tally:
    """The verdicts on many inputs."""

    counts: Counter[str] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)
    """For each input that was neither read nor refused: its number, verdict and cause, as one line."""


def tallies(name: str, reader: Reader, count: int) -> Iterator[tuple[str, Tally]]:
    """Kind of inputs to the tally of a reader on them: damaged bytes, edited documents."""

    def inputs(make: Callable[[random.Random], bytes]) -> Iterable[bytes]:
        return [make(random.Random(f"{name}:{number}")) for number in range(count)]

    expected = reader.read(reader.content) if reader.protected else None
    yield "bytes", try_all(reader.read, inputs(lambda chance: mutated(reader.content, chance)), expected)
    if name in DOCUMENTS:
        document = DOCUMENTS[name](reader.content)
        yield "documents", try_all(reader.read, inputs(lambda chance: edited(document, chance)), expected)


def main(arguments: Sequence[str] | None = None) -> int:
    """Try the named readers (default: all), and print a table. Exit status 1 for any fault."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.campaign", description=__doc__)
    parser.add_argument("readers", nargs="*", metavar="READER", help=f"default: all of {', '.join(READERS)}")
    parser.add_argument("--examples", type=int, default=200, help="inputs for each reader (default: 200)")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the table as Markdown, too")
    options = parser.parse_args(arguments)
    rows, faults = [], []
    for name in options.readers or READERS:
        with tempfile.TemporaryDirectory() as folder:
            for kind, tally in tallies(name, READERS[name](Path(folder)), options.examples):
                row = {"reader": name, "inputs": kind, "tried": tally.counts.total()}
                rows.append(row | {verdict: tally.counts[verdict] for verdict in VERDICTS})
                faults += [f"{name}, {kind}: {fault}" for fault in tally.faults]
                print("  ".join(f"{key} {value}" for key, value in rows[-1].items()), flush=True)
    print("\n".join(faults[:200]))
    if options.report:
        command = ["tests.fuzz.campaign", "--examples", str(options.examples)]
        options.report.write_text(report_text("robustness", ABOUT, CaseResult([], rows), command))
    return 1 if faults else 0


class _HangError(BaseException):
    """Raised by the timer; as a ``BaseException`` it passes the ``except Exception`` of a reader."""


def try_all(read: Callable[[bytes], Any], inputs: Iterable[bytes], expected: object) -> Tally:
    """Give each input to ``read``. With ``expected``, an input that reads as anything else is ``silent``.

    A child process reads, so that a crash or a hang of compiled code is a verdict too; the next input then goes to a
    new child.
    """
    tally, waiting = Tally(), list(inputs)
    while (first := tally.counts.total()) < len(waiting):
        for number, (verdict, cause) in enumerate(_by_child(read, waiting[first:], expected), first):
            tally.counts[verdict] += 1
            if verdict in FAULTS:
                tally.faults.append(f"input {number}: {verdict}: {cause}")
    return tally


def _by_child(read: Callable[[bytes], Any], inputs: list[bytes], expected: object) -> Iterator[tuple[str, str]]:
    """The verdicts on the inputs, up to the one that kills the child."""
    ours, theirs = get_context("fork").Pipe(duplex=False)
    child = os.fork()
    if not child:
        _read_all(read, inputs, expected, theirs)
    theirs.close()
    try:
        for _ in inputs:
            if not select.select([ours], [], [], 3 * SECONDS)[0]:
                yield "hang", f"no answer for {3 * SECONDS:.0f} s, in compiled code"
                return
            try:
                answer = ours.recv()
            except EOFError:
                yield "crash", "the process died"
                return
            yield answer
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        ours.close()


def _read_all(read: Callable[[bytes], Any], inputs: list[bytes], expected: object, answers: Connection) -> None:
    """In the child: read the inputs, send the verdicts, exit."""
    try:
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.signal(signal.SIGALRM, _time_is_up)
        for content in inputs:
            answers.send(_judged(read, content, expected))
    finally:
        os._exit(0)


def _judged(read: Callable[[bytes], Any], content: bytes, expected: object) -> tuple[str, str]:
    try:
        with _limited():
            found = read(content)
    except GcdError as error:
        text = str(error)
        return ("refused", "") if text and "\n" not in text else ("crash", f"message: {text!r}")
    except MemoryError as error:
        return "memory", _cause(error)
    except _HangError as error:
        return "hang", _cause(error)
    except BaseException as error:  # noqa: BLE001 -- any other exception is a crash
        return "crash", _cause(error)
    if expected is not None and pickle.dumps(found) != pickle.dumps(expected):
        return "silent", "read as other values"
    return "read", ""


def _cause(error: BaseException) -> str:
    places = [f for f in traceback.extract_tb(error.__traceback__) if "site-packages" not in f.filename]
    where = f"{places[-1].filename}:{places[-1].lineno}" if places else "?"
    return f"{type(error).__name__}: {str(error)[:120]!r} at {where}"


@contextmanager
def _limited() -> Iterator[None]:
    with open("/proc/self/statm") as file:  # noqa: PTH123
        size = int(file.read().split()[0]) * resource.getpagesize()
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (size + MEGABYTES * 2**20, hard))
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        resource.setrlimit(resource.RLIMIT_AS, (hard, hard))


def _time_is_up(*_: object) -> None:
    raise _HangError(f"over {SECONDS:.0f} s")


if __name__ == "__main__":
    raise SystemExit(main())
