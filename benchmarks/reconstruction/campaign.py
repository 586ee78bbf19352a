"""Train and score all models of a plan, some at once, in as many calls as it takes.

    python -m benchmarks.reconstruction.campaign benchmarks/reconstruction/plans/smoke.toml --out runs
    python -m benchmarks.reconstruction.campaign benchmarks/reconstruction/plans/h200.toml --out runs --only "T0-*" \\
        --gpus 2 --limit-minutes 9
    python -m benchmarks.reconstruction.campaign benchmarks/reconstruction/plans/h200.toml --out runs --report

A plan is a TOML file with a table for each group of runs. Its keys are options of ``train``, or of ``stitching.run``
with ``program = "stitching.run"``; a list holds a value for each run, and several lists all their combinations. A run
is named by the table and its values of the lists: ``T0-panel_set-4000``. ``spare``: minutes to load and to score,
without drapes; ``expected``: minutes that ``steps`` may take.

A run is trained if ``OUT/NAME/report.json`` exists. The garments of the runs are made, a set at a time, those without
drapes first. Runs whose garments are there start, one for each GPU, the longest that fits into the time first; those
with ``fresh`` garments when all sets are made. While runs on garments without drapes train, the last of several GPUs
drapes the garments of the others and begins no run. ``--make-only`` makes the garments alone, so that a later call
trains while nothing is draped.

With ``--at-once 2`` a GPU has two runs, which take turns to train: one loads or scores meanwhile. A run with
``drape = true`` is started twice: without ``--drape``, and again to drape its answers, when all garments are made, no
training that fits into the time waits, and its GPU has no other run. It is finished when its report has the scores of
drapes.

A call that ends early, or is killed, is repeated: trainings continue from their checkpoints, and answers whose drapes
were stopped are draped again. Each run has the log ``OUT/NAME/log.txt``. The exit code is 1 if a run failed, 3 if
``--make-only`` did not make all garments, else 0.
``--report`` starts nothing: it hands the reports to ``leaderboard``, also those without the scores of drapes.
"""

import argparse
import csv
import fcntl
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from enum import StrEnum
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from benchmarks.reconstruction import leaderboard, results
from benchmarks.reconstruction.planned_runs import Planned, read_plan
from benchmarks.reconstruction.run_files import REPORT
from benchmarks.reconstruction.tasks import task_named
from benchmarks.reconstruction.train import UNFINISHED, is_draped
from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.files import make_folder, write_whole
from gcd_dataset.generator.drape.device import cores

OF_FRESH = ("workers", "make_device", "fresh")
"""Options of garments that are made during a training; all cores and GPUs make the others."""
DRAPING = 0.8  # minutes to drape the answers of a run
LEAST = 1.5  # minutes; a training that cannot be finished is not begun with less
INTERRUPTED = 130  # exit code
LEAVE = 15.0  # s that a program has to write its checkpoint
LOG, PLANNED = "log.txt", "planned.json"
NOT_DRAPED = "Drapes of the answers are not scored yet."


class State(StrEnum):
    """What is known of a run."""

    DONE = "done"
    TO_DRAPE = "to be draped"
    """Trained, answered and scored; the drapes of its answers are missing."""
    FAILED = "failed"
    UNFINISHED = "unfinished"
    WAITING = "waiting"


# ---------------------------------------------------------------------------------------------------------- the command


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command. Returns the exit code."""
    args = _parser().parse_args(arguments)
    try:
        runs = [run for run in read_plan(args.plan) if any(fnmatch(run.name, glob) for glob in args.only)]
        if not runs:
            raise ConfigError(f"{args.plan} has no run {' '.join(args.only)}: give --only a pattern such as 'T0-*'")
        return _report(runs, args) if args.report else _Campaign(args).run(runs)
    except KeyboardInterrupt:
        print("campaign: interrupted: repeat the command to continue", file=sys.stderr)
        return INTERRUPTED
    except GcdError as error:
        print(f"campaign: {error}", file=sys.stderr)
        return 1


def _parser() -> argparse.ArgumentParser:
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="campaign", description=__doc__, formatter_class=formatter)
    parser.add_argument("plan", type=Path, help="TOML file of runs")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="folder of the runs (%(default)s)")
    parser.add_argument("--data", type=Path, help="folder of the garments (default: garments in --out)")
    parser.add_argument("--only", nargs="+", default=["*"], metavar="GLOB", help="names of the runs to start (all)")
    parser.add_argument("--gpus", type=int, default=-1, help="runs at once, each on its GPU; 0: one, on the CPU "
                        "(default: the GPUs of this machine)")  # fmt: skip
    parser.add_argument("--at-once", type=int, default=1, help="runs on a GPU, which take turns to train (%(default)s)")
    parser.add_argument("--limit-minutes", type=float, default=0.0, help="time of this call; 0: no limit (%(default)s)")
    parser.add_argument(
        "--examples", default="", help="folder of specifications that the runs of T3 are tested on, too"
    )
    parser.add_argument("--make-only", action="store_true", help="make the garments of the runs, start no run")
    parser.add_argument("--list", action="store_true", help="print state and time of the runs, start nothing")
    parser.add_argument("--report", action="store_true", help="add the reports to the leaderboard, draped or not")
    parser.add_argument("--reports", type=Path, default=leaderboard.REPORTS, help="folder of the leaderboard")
    parser.add_argument("--commit", default="", help="commit of the runs, with --report (default: the present one)")
    return parser


def _report(runs: Sequence[Planned], args: argparse.Namespace) -> int:
    """Add the reports to the leaderboard, with the commands of the plan."""
    trained = [run for run in runs if (args.out / run.name / REPORT).exists()]
    if not trained:
        raise ConfigError(f"{args.out} has no finished run of {args.plan}: run the campaign first")
    commit, undraped = args.commit or leaderboard.commit_here(), 0
    for run in trained:
        path = args.out / run.name / REPORT
        _require_planned(run, path.parent)
        date = datetime.fromtimestamp(path.stat().st_mtime, UTC).strftime("%Y-%m-%d")
        examples = ["--examples", "FREESEWING"] if "foreign" in _report_in(path) else []
        command = shlex.join([*run.command, *examples, "--out", f"runs/{run.name}"])
        told = {"command": command, "commit": commit, "date": date}
        is_undraped = _is_to_drape(run, path)
        undraped += is_undraped
        remark = NOT_DRAPED if is_undraped else ""
        results.add(path, args.reports / leaderboard.RESULTS, **told, remark=remark)
    for path in leaderboard.write_pages(args.reports):
        print(path)
    print(f"{len(trained)} of {len(runs)} runs reported" + (f", {undraped} of them not draped" if undraped else ""))
    return 0


# --------------------------------------------------------------------------------------------------------- the campaign


@dataclass
class _Job:
    """A program that runs."""

    run: Planned
    process: subprocess.Popen[bytes]
    begun: float
    makes: Sequence[Planned] = ()
    """The runs whose garments it makes; none: it is a run."""


@dataclass(frozen=True)
class _Slot:
    """Where a run takes place."""

    gpu: int | None
    """``None``: on the CPU."""
    place: int
    """Of the runs at once."""


class _Campaign:
    """The runs of one call."""

    def __init__(self, args: argparse.Namespace) -> None:
        self.out, self.examples, self.lists = make_folder(args.out), args.examples, args.list
        self.makes_only = args.make_only
        self.unmade: set[str] = set()
        """Names of the pending runs that have no garments yet."""
        self.data = args.data or args.out / "garments"
        gpus = _gpus() if args.gpus < 0 else args.gpus
        if args.at_once < 1:
            raise ConfigError(f"--at-once {args.at_once}: give 1 or more")
        self.at_once = args.at_once
        self.slots = [_Slot(gpu, k) for k in range(self.at_once) for gpu in range(gpus) or [None]]
        self.begun = time.monotonic()
        if not 0 <= args.limit_minutes < float("inf"):
            raise ConfigError(f"--limit-minutes {args.limit_minutes:g}: give 0 or more")
        self.limit = 60.0 * args.limit_minutes or float("inf")
        self.states: dict[str, State] = {}
        self.jobs: dict[_Slot, _Job] = {}
        self.maker: int | None = None
        """The GPU that drapes garments, and begins no run, while others train; ``None`` when none or all do."""
        self.lock = -1

    def run(self, runs: Sequence[Planned]) -> int:
        """Make the garments, start what is not finished, print the table. Returns the exit code."""
        for run in runs:
            self.states[run.name] = self._known(run)
        pending = [run for run in runs if self.states[run.name] is not State.DONE]
        self.unmade = {run.name for run in pending}
        if not self.lists:
            with _locked(self.out / "lock") as self.lock:
                before = signal.signal(signal.SIGTERM, _stop)
                try:
                    self._work(pending)
                finally:
                    self._end_all()
                    signal.signal(signal.SIGTERM, before)
        self._print(runs)
        if State.FAILED in self.states.values():
            return 1
        if self.makes_only and self.unmade and not self.lists:
            _say(f"the limit left no time for all garments of {', '.join(sorted(self.unmade))}: repeat the command")
            return UNFINISHED
        return 0

    def _known(self, run: Planned) -> State:
        """The state that the files tell. Raises ``ConfigError`` for files of other options."""
        folder = self.out / run.name
        _require_planned(run, folder)
        if (folder / REPORT).exists():
            return State.TO_DRAPE if _is_to_drape(run, folder / REPORT) else State.DONE
        return State.UNFINISHED if (folder / "checkpoint.pt").exists() else State.WAITING

    # ----------------------------------------------------------------------------------------------------- the work

    def _work(self, pending: Sequence[Planned]) -> None:
        """Make the garments of each data set, start its runs, drape their answers, and wait for them."""
        ready: list[Planned] = []
        sets = [[run for run in pending if run.garments == one] for one in dict.fromkeys(r.garments for r in pending)]
        sets.sort(key=_is_draped)
        undraped = [run for sharing in sets if not _is_draped(sharing) for run in sharing]
        if not self.makes_only and any(self._may_train(run) for run in undraped):
            self.maker = self._last_gpu() if any(map(_is_draped, sets)) else None
        while sets or ready or self.jobs:
            if self._left() <= 0:
                self._end_all()
                return
            for slot in self.slots:
                if slot in self.jobs:
                    continue
                is_making = any(job.makes for job in self.jobs.values())
                if not is_making and not self._may_train_beside(sets, ready):
                    self.maker = None
                if sets and not is_making and self.maker in (None, slot.gpu):
                    self._make(slot, sets.pop(0))
                elif self.maker is not None and slot.gpu == self.maker:
                    continue
                elif (run := self._next(slot, ready, are_made=not sets and not is_making)) is not None:
                    ready.remove(run)
                    self._begin(slot, run)
            if not self.jobs:
                return
            time.sleep(0.2)
            for slot, job in list(self.jobs.items()):
                if (code := job.process.poll()) is not None:
                    del self.jobs[slot]
                    ready += self._ended(job, code)

    def _last_gpu(self) -> int | None:
        """The last of several GPUs."""
        gpus = sorted({slot.gpu for slot in self.slots if slot.gpu is not None})
        return gpus[-1] if len(gpus) > 1 else None

    def _may_train(self, run: Planned) -> bool:
        """Whether a run can train before all garments are made."""
        return self.states[run.name] is not State.TO_DRAPE and not run.options.get("fresh")

    def _may_train_beside(self, sets: Sequence[Sequence[Planned]], ready: Sequence[Planned]) -> bool:
        """Whether runs train, or may soon, while the next set is made."""
        if not sets:
            return False
        fits = any(self._may_train(run) and self._expected(run) <= self._left() / 60 for run in ready)
        return bool(self.jobs) or fits or not _is_draped(sets[0])

    def _make(self, slot: _Slot, sharing: Sequence[Planned]) -> None:
        """Start to make the largest set of garments of the runs that share them."""
        largest = max(sharing, key=lambda run: run.train)
        _say(f"garments of {', '.join(run.name for run in sharing)}")
        workers = max(0, cores() - 1)
        kept = {key: value for key, value in largest.options.items() if key not in OF_FRESH}
        largest = replace(largest, options=kept)
        command = [*largest.training, "--make-only"]
        self._start(slot, largest, command, self._log_of_garments(largest), workers=workers, makes=sharing)

    def _begin(self, slot: _Slot, run: Planned) -> None:
        """Start the training of a run, or the drapes of its answers."""
        left, is_drape = self._left() / 60, self.states[run.name] is State.TO_DRAPE
        command = run.command if is_drape else run.training
        more = ["--limit-minutes", f"{max(0.1, left - 0.5):.2f}"] if left < float("inf") else []
        _say(f"{run.name} {'drapes' if is_drape else 'begins'}" + ("" if slot.gpu is None else f" on GPU {slot.gpu}"))
        folder = make_folder(self.out / run.name)
        write_whole(folder / PLANNED, json.dumps(run.command).encode())
        places = len({place.gpu for place in self.slots})  # each drapes the answers of one run at a time
        workers = max(1, (cores() - 1) // places) if is_drape else max(0, cores() // len(self.slots) - 1)
        self._start(slot, run, [*command, *more], folder / LOG, workers=workers)

    def _log_of_garments(self, run: Planned) -> Path:
        return self.out / f"garments_{run.name}.txt"

    def _next(self, slot: _Slot, waiting: Sequence[Planned], *, are_made: bool) -> Planned | None:
        """What starts in a slot: the longest training that fits into the time left; else a run to be draped; else the
        longest training, which a later call continues.

        ``are_made``: whether all garments are made. Before, nothing starts that also drapes: neither a training on
        fresh garments, nor the drapes of answers, during which a GPU has no other run: they would slow its steps.
        """
        left = self._left() / 60
        trainings = [run for run in waiting if self.states[run.name] is not State.TO_DRAPE]
        trainings = [run for run in trainings if are_made or not run.options.get("fresh")]
        ranked = sorted(trainings, key=self._expected, reverse=True)
        fitting = [run for run in ranked if self._expected(run) <= left]
        beside = [self.states[job.run.name] for other, job in self.jobs.items() if other.gpu == slot.gpu]
        if State.TO_DRAPE in beside:
            return None
        may_drape = are_made and left >= DRAPING and not beside
        undraped = [run for run in waiting if self.states[run.name] is State.TO_DRAPE] if may_drape else []
        begun = [run for run in ranked if run.minutes] if left >= LEAST else []
        return next(iter([*fitting, *undraped, *begun]), None)

    def _expected(self, run: Planned) -> float:
        """Minutes that the training and the scores of a run still take."""
        return max(0.0, run.minutes - _trained_minutes(self.out / run.name)) + run.spare

    def _minutes_left(self, run: Planned) -> float:
        """Minutes that a run still takes, drapes included."""
        state = self._known(run)
        training = 0.0 if state in (State.DONE, State.TO_DRAPE) else self._expected(run)
        return training + (DRAPING if run.drapes and state is not State.DONE else 0.0)

    def _ended(self, job: _Job, code: int) -> Sequence[Planned]:
        """Note how a program ended. Returns the runs that can start now."""
        if job.makes and code == 0:
            _say(f"garments made in {time.monotonic() - job.begun:.0f} s")
            self.unmade -= {run.name for run in job.makes}
            return () if self.makes_only else job.makes
        if job.makes:
            log = self._log_of_garments(job.run)
            _say(f"no garments, see {log}: {_last_line(log)}")
            self.states |= {run.name: State.FAILED for run in job.makes}
            return ()
        name, log = job.run.name, self.out / job.run.name / LOG
        minutes = (time.monotonic() - job.begun) / 60
        before, found = self.states[name], self._known(job.run) if code == 0 else State.FAILED
        if found is State.DONE:
            self.states[name] = State.DONE
            _say(f"{name} done after {minutes:.1f} min")
        elif found is State.TO_DRAPE and before is not State.TO_DRAPE:
            self.states[name] = State.TO_DRAPE
            _say(f"{name} trained and scored after {minutes:.1f} min, to be draped")
            return [job.run]
        elif code == UNFINISHED:
            self.states[name] = State.UNFINISHED
            _say(f"{name} stopped after {minutes:.1f} min, to be continued")
        else:
            self.states[name] = State.FAILED
            _say(f"{name} failed with exit code {code}, see {log}: {_last_line(log)}")
        return ()

    # --------------------------------------------------------------------------------------------------- the programs

    def _start(
        self,
        slot: _Slot,
        run: Planned,
        command: Sequence[str],
        log: Path,
        *,
        workers: int,
        makes: Sequence[Planned] = (),
    ) -> None:
        arguments = [*command[1:], "--out", str(self.out / run.name), "--data", str(self.data)]
        if "workers" not in run.options and not run.options.get("smoke"):
            arguments += ["--workers", str(workers)]
        if run.program == "stitching.run" and self.examples:
            arguments += ["--examples", self.examples]
        if self.at_once > 1:
            arguments += ["--turns", str(self.out / f"turns{'' if slot.gpu is None else slot.gpu}")]
        environment = {**os.environ, "PYTHONUNBUFFERED": "1", "OMP_NUM_THREADS": "1"}  # all cores have processes
        if slot.gpu is not None:
            visible = _visible(slot.gpu)
            environment["CUDA_VISIBLE_DEVICES"] = visible if self.maker is None else visible.split(",")[0]
        with log.open("ab") as file:
            file.write(f"$ {shlex.join(['python', *arguments])}\n".encode())
            file.flush()
            process = subprocess.Popen(
                [sys.executable, *arguments],
                stdout=file,
                stderr=file,
                env=environment,
                start_new_session=True,
                pass_fds=[self.lock],  # a program that a killed campaign leaves behind keeps the lock
            )
        self.jobs[slot] = _Job(run, process, time.monotonic(), makes)

    def _end_all(self) -> None:
        """End the programs and the processes that they started."""
        for job in self.jobs.values():
            _signal_group(job.process, signal.SIGTERM)
        deadline = time.monotonic() + LEAVE
        for job in self.jobs.values():
            while job.process.poll() is None and time.monotonic() < deadline:
                time.sleep(0.05)
            _signal_group(job.process, signal.SIGKILL)
            job.process.wait()
            if job.run.name in self.states:
                self.states[job.run.name] = self._known(job.run)
        self.jobs.clear()

    def _left(self) -> float:
        """Time left [s]."""
        return self.limit - (time.monotonic() - self.begun)

    def _print(self, runs: Sequence[Planned]) -> None:
        """The table of all runs."""
        rows = [["run", "state", "minutes left", "headline"]]
        for run in runs:
            state = self.states[run.name]
            left = "" if state is State.DONE else f"{self._minutes_left(run):.1f}"
            rows.append([run.name, str(state), left, _headline(self.out / run.name / REPORT, run.task)])
        widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
        for row in rows:
            print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
        counts = [f"{sum(s is state for s in self.states.values())} {state}" for state in State]
        total = sum(self._minutes_left(run) for run in runs)
        print(", ".join(counts) + (f"; {total:.0f} minutes left on one device" if total else ""))


def _is_draped(sharing: Sequence[Planned]) -> bool:
    """Whether the garments that the runs share are draped."""
    return sharing[0].has_draped_garments


@contextmanager
def _locked(path: Path) -> Iterator[int]:
    """A lock on a folder of runs, its file descriptor. Raises ``ConfigError`` if another process has it."""
    with path.open("a") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ConfigError(f"{path.parent}: a campaign, or a run that one left, goes on there: end it") from error
        yield file.fileno()


def _gpus() -> int:
    import torch

    return torch.cuda.device_count()


def _visible(gpu: int) -> str:
    """The GPUs of this process, one of them first: programs train on the first, and drape garments on all."""
    given = os.environ.get("CUDA_VISIBLE_DEVICES", "")
    names = given.split(",") if given else [str(k) for k in range(_gpus())]
    return ",".join([*names[gpu:], *names[:gpu]])


def _signal_group(process: subprocess.Popen[bytes], number: signal.Signals) -> None:
    try:
        os.killpg(process.pid, number)
    except ProcessLookupError:
        return


def _stop(number: int, frame: object) -> None:
    raise SystemExit(128 + number)


def _trained_minutes(folder: Path) -> float:
    """Minutes of training that the curves show; 0 without a checkpoint to continue from."""
    path = folder / "curves.csv"
    if not path.exists() or not (folder / "checkpoint.pt").exists():
        return 0.0
    with path.open(newline="") as file:
        return max((float(row["seconds"]) for row in csv.DictReader(file)), default=0.0) / 60


def _require_planned(run: Planned, folder: Path) -> None:
    """Raise ``ConfigError`` if the folder holds a run of other options than the plan's."""
    try:
        planned = json.loads((folder / PLANNED).read_text()) if (folder / PLANNED).exists() else run.command
    except ValueError as error:
        raise ConfigError(f"{folder / PLANNED}: {error}: delete the folder") from error
    if planned != run.command:
        raise ConfigError(f"{folder} holds a run of other options: delete it, or rename the run in the plan")


def _report_in(path: Path) -> dict[str, Any]:
    """What a run reports. Raises ``ConfigError`` for a damaged file."""
    try:
        found = json.loads(path.read_text())
    except ValueError as error:
        raise ConfigError(f"{path}: {error}: delete it, the run is scored again") from error
    if not isinstance(found, dict):
        raise ConfigError(f"{path}: no report: delete it, the run is scored again")
    return found


def _is_to_drape(run: Planned, path: Path) -> bool:
    """Whether the report at ``path`` lacks scores of drapes. Raises ``ConfigError`` for a damaged file."""
    found = _report_in(path)
    return run.drapes and not is_draped(found)


def _headline(path: Path, task: str) -> str:
    """The score by which models of the task are compared."""
    if not path.exists():
        return ""
    found = _report_in(path)
    name = "perfect_symmetric" if "one_to_one" in found else task_named(task).headline
    value = found.get("one_to_one", found.get("scores", {})).get(name)
    return f"{name} {value[0]:.3f}" if value else ""


def _last_line(path: Path) -> str:
    lines = [line for line in path.read_text(errors="replace").splitlines() if line.strip()]
    return lines[-1].strip() if lines else ""


def _say(text: str) -> None:
    print(f"campaign: {text}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
