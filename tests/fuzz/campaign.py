"""Give each reader many damaged inputs: ``python -m tests.fuzz.campaign --examples 10000 --report FILE``."""

import argparse
import random
import tempfile
from collections.abc import Callable, Container, Iterator, Sequence
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, settings

from benchmarks.cases import CaseResult
from benchmarks.run import report_text
from tests.fuzz.expensive import EXPENSIVE, expensive
from tests.fuzz.readers import DOCUMENTS, READERS, Reader, damaged, edited_documents
from tests.fuzz.trial import Tally, Verdict, try_all

EXPENSIVE_SHARE = 20  # an expensive input takes as long to read as this number of damaged ones

ABOUT = """
Readers of files from outside, each given damaged files and documents: `make fuzz N=10000`. A file is damaged by one to
three edits of its bytes (bits, ranges, binary integers, numbers in text); a document by one to three edits of its tree.
`read` counts the inputs that were accepted: if checksums protect the file (shards, index, HDF5, body sets), an
accepted input was read as the original; otherwise it counts as `silent`. Limits for one input: 10 s and 1 GiB.
"""


def try_files(name: str, reader: Reader, count: int) -> Tally:
    """The tally of a reader on ``count`` damaged files."""
    return try_all(reader.read, damaged(reader, name, count), expected=reader.expected())


def try_expensive(name: str, reader: Reader, count: int) -> Tally:
    """The tally of a reader on ``count`` expensive inputs."""
    inputs = (expensive(name, reader.content, random.Random(f"{name}:{number}")) for number in range(count))
    return try_all(reader.read, inputs, expected=None)


def try_documents(name: str, reader: Reader, count: int) -> Tally:
    """The tally of a reader on ``count`` edited documents; fewer if Hypothesis finds no more distinct ones."""
    contents: list[bytes] = []

    @settings(
        max_examples=count,
        database=None,
        derandomize=True,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
        deadline=None,
    )
    @given(edited_documents(reader, name))
    def collect(content: bytes) -> None:
        contents.append(content)

    collect()
    return try_all(reader.read, contents, expected=reader.expected())


def main(arguments: Sequence[str] | None = None) -> int:
    """Try the named readers (default: all), and print a table. Exit status 1 for any fault."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.campaign", description=__doc__)
    parser.add_argument("readers", nargs="*", metavar="READER", help=f"default: all of {', '.join(READERS)}")
    parser.add_argument("--examples", type=int, default=200, help="inputs for each reader (default: 200)")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the table as Markdown, too")
    options = parser.parse_args(arguments)
    rows, faults = [], []
    for kind, name, tally in _tallies(options.readers or list(READERS), options.examples):
        row = {"reader": name, "inputs": kind, "tried": tally.tried} | {v.value: tally.counts[v] for v in Verdict}
        rows.append(row)
        faults += [f"{name}, {kind}: {fault}" for fault in tally.faults]
        print("  ".join(f"{key} {value}" for key, value in row.items()), flush=True)
    print("\n".join(faults[:200]))
    if options.report:
        command = ["tests.fuzz.campaign", "--examples", str(options.examples)]
        options.report.write_text(report_text("robustness", ABOUT, CaseResult([], rows), command))
    return 1 if faults else 0


def _tallies(names: Sequence[str], count: int) -> Iterator[tuple[str, str, Tally]]:
    few = max(count // EXPENSIVE_SHARE, 1)
    trials: dict[str, tuple[Callable[[str, Reader, int], Tally], Container[str], int]] = {
        "bytes": (try_files, READERS, count),
        "documents": (try_documents, DOCUMENTS, count),
        "expensive": (try_expensive, EXPENSIVE, few),
    }
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            reader = READERS[name](Path(folder))
            for kind, (trial, readers, tried) in trials.items():
                if name in readers:
                    yield kind, name, trial(name, reader, tried)


if __name__ == "__main__":
    raise SystemExit(main())
