"""Run the unfinished trainings of a plan, one for each GPU.

    python -m benchmarks.reconstruction.plan benchmarks/reconstruction/plans/smoke.toml --out runs
    python -m benchmarks.reconstruction.plan benchmarks/reconstruction/plans/h200.toml --out runs --only "T0-*" \\
        --gpus 2 --limit-minutes 9
    python -m benchmarks.reconstruction.plan benchmarks/reconstruction/plans/h200.toml --out runs --report

A plan is a TOML file with a table for each group of runs. Its keys are options of ``train``, or of ``stitching.run``
with ``program = "stitching.run"``; a list holds a value for each run, and several lists all their combinations. A run
is named by the table and its values of the lists: ``T0-panel_set-4000``.

The garments of all runs are made first, each data set once; ``--make-only`` stops there. Then the runs start in the
order of the plan. A call that is killed, or that ``--limit-minutes`` ends, is repeated: finished runs are left alone,
trainings continue from their checkpoints. Each run has the log ``OUT/NAME/log.txt``. The exit code is 1 if a run
failed, 3 if the limit left some unfinished, else 0. ``--report`` starts nothing: it adds the reports of the runs to the
leaderboard.
"""

import argparse
import json
import os
import shlex
import subprocess
import sys
import time
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from fnmatch import fnmatch
from itertools import product
from pathlib import Path
from typing import Any, NoReturn

import torch

from benchmarks.reconstruction import leaderboard, results
from benchmarks.reconstruction.stitching import run as stitching
from benchmarks.reconstruction.tasks import task_named
from benchmarks.reconstruction.train import UNFINISHED, add_arguments, is_draped, options_from, require_usable
from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.generator.device import cores
from gcd_dataset.jsonfile import read_json
from gcd_dataset.scoring.table import REPORT

PROGRAMS = {"train": "benchmarks.reconstruction.train", "stitching.run": "benchmarks.reconstruction.stitching.run"}
FRESH = ("fresh", "make_device")
"""Options of garments that are made during a training."""
LOG, PLANNED = "log.txt", "planned.json"
RESERVE = 0.5  # minutes of the limit that a run is not told of, to write its checkpoint
NOT_DRAPED = "Drapes of the answers are not scored yet."


@dataclass(frozen=True)
class PlannedRun:
    """A run of a plan."""

    name: str
    program: str
    """Key of ``PROGRAMS``."""
    model: str
    """First argument of ``train``; empty for ``stitching.run``."""
    options: Mapping[str, Any]

    @property
    def command(self) -> list[str]:
        """The command, without the options that ``plan`` adds."""
        return ["python", "-m", PROGRAMS[self.program], *([self.model] if self.model else []), *_flags(self.options)]

    @property
    def garments(self) -> str:
        """Equal for runs whose garments share a file of ``--data``; a larger set holds the smaller ones."""
        task = task_named(str(self.options.get("task", "T3" if self.program == "stitching.run" else "T0")))
        own = [self.options.get(name) for name in ("source", "resolution", "test", "smoke")]
        return repr((dict(task.options), task.points, task.extra, own))

    def is_done(self, out: Path) -> bool:
        """Whether its report is there, with the scores of drapes if it wants them.

        Raises ``ConfigError`` for a folder of other options and for a damaged report.
        """
        folder = out / self.name
        planned = self.command
        if (folder / PLANNED).exists():
            planned = read_json(folder / PLANNED, "plan of a run", error=ConfigError)
        if planned != self.command:
            raise ConfigError(f"{folder} holds a run of other options: delete it, or rename the run in the plan")
        if not (folder / REPORT).exists():
            return False
        report = read_json(folder / REPORT, "report of a run", error=ConfigError)
        return is_draped(report) or not self.options.get("drape")


def read_plan(path: Path) -> list[PlannedRun]:
    """The runs of a plan, in its order. Raises ``ConfigError`` for an unusable one."""
    try:
        groups = tomllib.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: {error}: give a TOML file of runs") from error
    runs: dict[str, PlannedRun] = {}
    for name, group in groups.items():
        try:
            for run in _runs(name, group):
                if run.name in runs:
                    raise ConfigError(f"two runs {run.name}: give runs with different names")
                _require_usable(run)
                runs[run.name] = run
        except ConfigError as error:
            raise ConfigError(f"{path}: [{name}] {error}") from error
    if not runs:
        raise ConfigError(f"{path}: no runs: give a table for each group of runs")
    return list(runs.values())


def _runs(name: str, group: Any) -> list[PlannedRun]:
    if not isinstance(group, dict):
        raise ConfigError(f"is no table: give [{name}] with the options of its runs")
    lists = {key: value for key, value in group.items() if isinstance(value, list) and key != "set"}
    found = []
    for values in product(*lists.values()):
        options = {**group, **dict(zip(lists, values, strict=True))}
        program, model = str(options.pop("program", "train")), str(options.pop("model", ""))
        if program not in PROGRAMS:
            raise ConfigError(f"program {program!r}: give one of {', '.join(PROGRAMS)}")
        if program == "train" and not model:
            raise ConfigError("has no model: give model = …")
        title = "-".join([name, *(str(value) for value in values)])
        if "/" in title or not title.isprintable() or title in (".", ".."):
            raise ConfigError(f"{title!r:.99} is no name for a folder: rename the table")
        found.append(PlannedRun(title, program, model, options))
    return found


class _Parser(argparse.ArgumentParser):
    """Raises ``ConfigError`` where others leave the program."""

    def error(self, message: str) -> NoReturn:
        raise ConfigError(message)


def _require_usable(run: PlannedRun) -> None:
    """Raise ``ConfigError`` for options that the program would refuse on any machine."""
    parser = _Parser(allow_abbrev=False)
    given = [*_flags(run.options), "--out", "out", "--device", "cpu"]
    if run.program == "stitching.run":
        stitching.add_arguments(parser)
        require_usable(stitching.options_of(stitching.parsed(parser, given)))
    else:
        add_arguments(parser)
        require_usable(options_from(parser.parse_args(given), run.model))


def _flags(options: Mapping[str, Any]) -> list[str]:
    """Options as arguments: ``true`` is a flag, ``false`` none."""
    found: list[str] = []
    for key, value in options.items():
        flag = f"--{key.replace('_', '-')}"
        if isinstance(value, bool):
            found += [flag] if value else []
        else:
            found += [flag, *(str(part) for part in (value if isinstance(value, list) else [value]))]
    return found


# ------------------------------------------------------------------------------------------------------------- the runs


class _Calls:
    """Calls of the programs until a deadline."""

    def __init__(self, args: argparse.Namespace) -> None:
        self.out, self.data, self.examples = make_folder(args.out), args.data or args.out / "garments", args.examples
        count = torch.cuda.device_count() if args.gpus is None else args.gpus
        self.gpus: list[int | None] = [*range(count)] or [None]
        self.deadline = time.monotonic() + 60 * args.limit_minutes if args.limit_minutes else float("inf")

    @property
    def is_over(self) -> bool:
        return time.monotonic() >= self.deadline

    def make(self, runs: Sequence[PlannedRun]) -> bool:
        """Make the garments of runs, the largest set of those that share them; whether all are made."""
        sharing: dict[str, list[PlannedRun]] = {}
        for run in runs:
            sharing.setdefault(run.garments, []).append(run)
        for some in sharing.values():
            largest = max(some, key=lambda run: int(run.options.get("train", 0)))
            kept = {name: value for name, value in largest.options.items() if name not in (*FRESH, "drape")}
            log = self.out / f"garments_{largest.name}.txt"
            command = [*replace(largest, options=kept).command, "--make-only"]
            with self._started(largest, command, log, workers=max(1, cores() - 1)) as process:
                while process.poll() is None and not self.is_over:
                    time.sleep(0.2)
                is_late = process.poll() is None
                process.terminate()
            if is_late:
                return False
            if process.returncode:
                raise ConfigError(f"no garments of {largest.name}, see {log}")
        return True

    def train(self, runs: Sequence[PlannedRun]) -> bool:
        """Train, a run for each GPU at a time; whether none failed."""
        waiting, failed = list(runs), False
        jobs: dict[int | None, tuple[PlannedRun, subprocess.Popen[bytes]]] = {}
        try:
            while (waiting and not self.is_over) or jobs:
                for gpu in self.gpus:
                    if gpu not in jobs and waiting and not self.is_over:
                        run = waiting.pop(0)
                        jobs[gpu] = run, self._train_one(run, gpu)
                time.sleep(0.2)
                for gpu, (run, process) in list(jobs.items()):
                    if (code := process.poll()) is not None:
                        del jobs[gpu]
                        failed |= code not in (0, UNFINISHED)
                        _say(f"{run.name} ended with exit code {code}, see {self.out / run.name / LOG}")
        finally:
            for _, process in jobs.values():
                process.terminate()
            for _, process in jobs.values():
                process.wait()
        return not failed

    def _train_one(self, run: PlannedRun, gpu: int | None) -> subprocess.Popen[bytes]:
        folder = make_folder(self.out / run.name)
        write_whole(folder / PLANNED, json.dumps(run.command).encode())
        command = run.command
        if self.deadline < float("inf"):
            left = (self.deadline - time.monotonic()) / 60 - RESERVE
            command += ["--limit-minutes", f"{max(0.1, left):.2f}"]
        if run.program == "stitching.run" and self.examples:
            command += ["--examples", self.examples]
        _say(f"{run.name} begins" + ("" if gpu is None else f" on GPU {gpu}"))
        return self._started(run, command, folder / LOG, workers=max(1, cores() // len(self.gpus) - 1), gpu=gpu)

    def _started(
        self, run: PlannedRun, command: Sequence[str], log: Path, *, workers: int, gpu: int | None = None
    ) -> subprocess.Popen[bytes]:
        arguments = [*command[1:], "--out", str(self.out / run.name), "--data", str(self.data)]
        if "workers" not in run.options and not run.options.get("smoke"):
            arguments += ["--workers", str(workers)]
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}  # all cores have processes
        if gpu is not None:
            given = os.environ.get("CUDA_VISIBLE_DEVICES", "")
            names = given.split(",") if given else [str(k) for k in range(torch.cuda.device_count())]
            # A program trains on its first GPU, and drapes on all that it sees.
            environment["CUDA_VISIBLE_DEVICES"] = ",".join([*names[gpu:], *names[:gpu]])
        with log.open("ab") as file:
            file.write(f"$ {shlex.join(['python', *arguments])}\n".encode())
            file.flush()
            return subprocess.Popen([sys.executable, *arguments], stdout=file, stderr=file, env=environment)


def _report(runs: Sequence[PlannedRun], args: argparse.Namespace) -> int:
    """Add the reports to the leaderboard, with the commands of the plan."""
    trained = [run for run in runs if (args.out / run.name / REPORT).exists()]
    if not trained:
        raise ConfigError(f"{args.out} has no finished run of {args.plan}: run the plan first")
    commit = args.commit or leaderboard.commit_here()
    for run in trained:
        path = args.out / run.name / REPORT
        remark = "" if run.is_done(args.out) else NOT_DRAPED
        date = datetime.fromtimestamp(path.stat().st_mtime, UTC).strftime("%Y-%m-%d")
        examples = ["--examples", "FREESEWING"] if run.program == "stitching.run" and args.examples else []
        command = shlex.join([*run.command, *examples, "--out", f"runs/{run.name}"])
        told = {"command": command, "commit": commit, "date": date}
        results.add(path, args.reports / leaderboard.RESULTS, **told, remark=remark)
    for path in leaderboard.write_pages(args.reports):
        print(path)
    print(f"{len(trained)} of {len(runs)} runs reported")
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command. Returns the exit code."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="plan", description=__doc__, formatter_class=formatter)
    parser.add_argument("plan", type=Path, help="TOML file of runs")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="folder of the runs (%(default)s)")
    parser.add_argument("--data", type=Path, help="folder of the garments (default: garments in --out)")
    parser.add_argument("--only", nargs="+", default=["*"], metavar="GLOB", help="names of the runs to start (all)")
    parser.add_argument("--gpus", type=int, help="runs at once, each on its GPU; 0: one, on the CPU "
                        "(default: the GPUs of this machine)")  # fmt: skip
    parser.add_argument("--limit-minutes", type=float, default=0.0, help="time of this call; 0: no limit (%(default)s)")
    parser.add_argument("--examples", default="", help="folder of specifications that the runs of T3 are tested on")
    parser.add_argument("--make-only", action="store_true", help="make the garments of the runs, start no run")
    parser.add_argument("--list", action="store_true", help="print the runs and whether they are done, start nothing")
    parser.add_argument("--report", action="store_true", help="add the reports to the leaderboard, draped or not")
    parser.add_argument("--reports", type=Path, default=leaderboard.REPORTS, help="folder of the leaderboard")
    parser.add_argument("--commit", default="", help="commit of the runs, with --report (default: the present one)")
    args = parser.parse_args(arguments)
    try:
        runs = [run for run in read_plan(args.plan) if any(fnmatch(run.name, glob) for glob in args.only)]
        if not runs:
            raise ConfigError(f"{args.plan} has no run {' '.join(args.only)}: give --only a pattern such as 'T0-*'")
        return _report(runs, args) if args.report else _carry_out(runs, args)
    except GcdError as error:
        _say(str(error))
        return 1


def _carry_out(runs: Sequence[PlannedRun], args: argparse.Namespace) -> int:
    if not 0 <= args.limit_minutes < float("inf"):
        raise ConfigError(f"--limit-minutes {args.limit_minutes:g}: give 0 or more")
    pending = [run for run in runs if not run.is_done(args.out)]
    is_well = True
    if not args.list:
        calls = _Calls(args)
        if not calls.make(pending) or args.make_only:
            return UNFINISHED if calls.is_over else 0
        is_well = calls.train(pending)
    done = [run.is_done(args.out) for run in runs]
    for run, is_done in zip(runs, done, strict=True):
        print(f"{run.name}  {'done' if is_done else 'unfinished'}")
    return 1 if not is_well else 0 if all(done) or args.list else UNFINISHED


def _say(text: str) -> None:
    print(f"plan: {text}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
