"""Reports of trained models: one per task, and a table of all.

    python -m benchmarks.reconstruction.leaderboard                                     writes the reports again
    python -m benchmarks.reconstruction.leaderboard --add OUT/report.json --command "python -m … --out OUT"

``--add`` copies the results of ``train`` into ``benchmarks/reports/learning``, with command,
commit and date; smoke runs are refused. From the files there the reports ``learning_T0.md`` … and ``leaderboard.md``
are written. Models are ranked on one test set for each task, among those with the same budget: garments, length and
hardware of the training. Results on other garments have tables of their own. The record of a task is the entry with the
best headline on the validation set (``ReconstructionTask.validation``), which a report has as ``validation``.
"""

import argparse
import subprocess
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks.reconstruction.results import (
    HEADLINES,
    LOWER,
    USUAL,
    Entry,
    add,
    by_test_set,
    ranked,
    read_entries,
    shown,
)
from benchmarks.reconstruction.tasks import TASKS, task_named
from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.files import write_whole

REPORTS = Path(__file__).resolve().parents[1] / "reports"
RESULTS = "learning"
OF_KINDS = 3  # scores of ``HEADLINES`` that are shown for a kind left out
PROGRAMS = (
    "`parameters` draws its answers with the programs that drew the test garments; on patterns of other origin it "
    "answers with similar ones that they draw. Where no remark says otherwise, its answers are means over all points "
    "of a garment; `panel_set` and `edge_tokens` answer from 4,096 points, `neural_tailor` from 4,096 or `points`, and "
    "`nearest` compares 512. `neural_tailor` (removed on 2026-11-27) follows the paper. `ceiling` is "
    "no model: the truth in the output format of `panel_set`."
)
NOTES: Mapping[str, str] = {
    **dict.fromkeys(("T0", "T1", "T1-scan"), PROGRAMS),
    "T3": "`joined`: edges joined wherever possible, as a tailor draws them, scored on the seams of their parts, over "
    "the garments with such edges; `subdivided`: edges cut in advance where seams end, which is easier. "
    "`perfect`: share of the garments with all seams right; `f1`: of seams. Both accept answers with panels of "
    "equal shape exchanged: nothing tells these apart. `freesewing_whole`: patterns of FreeSewing with all seams "
    "right, of 90; no training sees them.",
}


def pages(entries: Sequence[Entry]) -> dict[str, str]:
    """File name to text of all reports."""
    tasks = dict.fromkeys(entry.task for entry in entries)
    found = {f"learning_{task}.md": _page(task, [e for e in entries if e.task == task]) for task in tasks}
    return {**found, "leaderboard.md": _leaderboard(entries)}


def write_pages(reports: Path) -> list[Path]:
    """Write the reports of the results in a folder; the files. Raises ``ConfigError`` if there are none."""
    entries = read_entries(reports / RESULTS)
    if not entries:
        raise ConfigError(f"{reports / RESULTS} has no results: give --add OUT/report.json")
    written = pages(entries)
    for name, text in written.items():
        write_whole(reports / name, text.encode())
    return [reports / name for name in written]


def commit_here() -> str:
    """The present commit. Raises ``ConfigError`` outside a git checkout."""
    given = ["git", "-C", str(REPORTS), "rev-parse", "--short", "HEAD"]
    found = subprocess.run(given, capture_output=True, text=True, check=False)
    if found.returncode:
        raise ConfigError(f"{REPORTS} is in no git checkout: give --commit")
    return found.stdout.strip()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command. Returns the exit code."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="leaderboard", description=__doc__, formatter_class=formatter)
    parser.add_argument("--reports", type=Path, default=REPORTS, help="folder of the reports (%(default)s)")
    parser.add_argument("--add", type=Path, help="report.json to add")
    parser.add_argument("--command", default="", help="the command that made it")
    parser.add_argument("--commit", default="", help="the commit that it ran from; default: the present one")
    parser.add_argument("--remark", default="", help="a sentence of the report on this result")
    args = parser.parse_args(arguments)
    folder = args.reports / RESULTS
    try:
        if args.add:
            if not args.command:
                raise ConfigError("--add: also give the --command that made the results")
            date = datetime.now(UTC).strftime("%Y-%m-%d")
            told = {"command": args.command, "commit": args.commit or commit_here(), "remark": args.remark}
            add(args.add, folder, date=date, **told)
        written = write_pages(args.reports)
    except GcdError as error:
        print(f"leaderboard: {error}", file=sys.stderr)
        return 1
    for path in written:
        print(path)
    return 0


def _first_scores(task: str, entries: Sequence[Entry]) -> list[str]:
    """Names of the first scores that an entry has, the headline first."""
    return [name for name in HEADLINES.get(task, USUAL) if any(e.score(name) for e in entries)][:OF_KINDS]


# -------------------------------------------------------------------------------------------------------------- writing


def _page(task: str, entries: Sequence[Entry]) -> str:
    """The report of a task."""
    whole, *others = by_test_set(entries)
    further = (name for own in (whole, *others) for entry in own for name in entry.scores)
    names = list(dict.fromkeys([*HEADLINES.get(task, USUAL), *further]))
    parts = [f"# {task}", _about(task), *_ranking(whole, names)]
    parts += [*_on_others(others, names), *_left_out(task, entries)]
    for entry in entries:
        without = f", without {entry.left_out}" if entry.left_out else ""
        length = f", {entry.length}" if entry.length else ""
        parts.append(f"## {entry.model}, {entry.trained_on} garments{without}{length}")
        parts += [entry.remark] if entry.remark else []
        tables = {title: table for title, table in entry.tables.items() if table}
        columns = list(dict.fromkeys(name for table in tables.values() for name in table))
        if tables:
            cells = [[title, *(shown(table.get(name)) for name in columns)] for title, table in tables.items()]
            parts.append(_table(["on", *columns], cells))
        parts.append("\n".join(f"- {name}: {_fact(name, value)}" for name, value in entry.facts.items()))
    return "\n\n".join(parts) + "\n"


def _leaderboard(entries: Sequence[Entry]) -> str:
    lines = [
        "# Leaderboard",
        "The scores of each task that its report puts first: means with 95 % intervals over the test garments; of "
        "several seeds, the mean with the lowest and the highest. `rank` compares models with the same garments, "
        "length and hardware of the training; references, and models below their published budget, are not ranked. "
        "A record is chosen on the validation set; a task without validated results has none. T1 and T3 ask for "
        "three seeds: rows with one are provisional. Where a score has no figure, the answers were not kept: it "
        "needs the next run on a GPU. Scores of patterns: [definitions](../../docs/evaluate.md#scores).",
    ]
    for task in dict.fromkeys(entry.task for entry in entries):
        own = [entry for entry in entries if entry.task == task]
        whole, *others = by_test_set(own)
        names = HEADLINES.get(task, USUAL)
        lines += [f"## {task}", _about(task) + f" [Report](learning_{task}.md)."]
        lines += [*_ranking(whole, names), *_on_others(others, names), *_left_out(task, own)]
    return "\n\n".join(lines) + "\n"


def _ranking(entries: Sequence[Entry], names: Sequence[str]) -> list[str]:
    """The scores of one test set, budget by budget, and what is not ranked; nothing without entries."""
    if not entries:
        return []
    sign = -1 if task_named(entries[0].task).headline in LOWER else 1
    validated = [e for e in entries if e.validation and not e.outside]
    record, rows = max(validated, key=lambda e: sign * e.validation[0], default=None), list[list[str]]()
    for budget in dict.fromkeys(e.budget for e in entries if not e.outside):
        alike = ranked([e for e in entries if e.budget == budget and not e.outside])
        rows += [_row(str(k) if len(alike) > 1 else "–", e, names, record) for k, e in enumerate(alike, 1)]
    rows += [_row(e.outside, e, names, None) for e in entries if e.outside]
    about = f"Tested on {entries[0].tested:,} garments (patterns {entries[0].tests})."
    head = ["rank", "model", "garments", "minutes", "weights", "hardware", "seeds", "validation", *names]
    return [about, _table(head, rows)]


def _row(rank: str, entry: Entry, names: Sequence[str], record: Entry | None) -> list[str]:
    """``rank``: place among the models of this budget; a dash for one alone."""
    weights = entry.facts.get("parameters", 0) / 1e6
    budget = [entry.trained_on, _spent(entry), f"{weights:.1f} M" if weights else "", entry.budget[2]]
    model = f"{entry.model} (**record**)" if entry is record else entry.model
    return [rank, model, *budget, str(entry.seeds), shown(entry.validation), *(entry.score(name) for name in names)]


def _spent(entry: Entry) -> str:
    """The minutes of a training, and the steps if these were asked for."""
    return f"{entry.minutes:.1f}" + (f" ({entry.length})" if entry.steps and entry.minutes else "")


def _on_others(groups: Sequence[Sequence[Entry]], names: Sequence[str]) -> list[str]:
    """The scores of further test sets, a table for each."""
    about = "Results on other test garments do not compare with the table above, nor with each other."
    return [about, *(part for own in groups for part in _ranking(own, names))] if groups else []


def _left_out(task: str, entries: Sequence[Entry]) -> list[str]:
    """The scores on each kind of garment, trained with and without it; nothing if no kind was left out."""
    without = sorted((e for e in entries if e.left_out), key=lambda e: (e.model, e.train, e.left_out))
    names = [name for name in _first_scores(task, entries) if any(e.score(name) for e in without)]
    whole, rows = by_test_set(entries)[0], []
    for entry in without:
        peers = [e for e in whole if (e.model, e.train, e.fresh) == (entry.model, entry.train, 0)]
        peers.sort(key=lambda e: (e.length != entry.length, abs(e.minutes - entry.minutes)))
        known = peers[0].kinds.get(entry.left_out, {}) if peers else {}
        cells = [
            cell for name in names for cell in (shown([known[name]] if name in known else None), entry.score(name))
        ]
        is_equal = not peers or peers[0].length == entry.length
        length = entry.length if is_equal else f"{peers[0].length} with, {entry.length} without"
        rows.append([entry.left_out, entry.model, f"{entry.train:,}", length, f"{entry.tested:,}", *cells])
    if not rows:
        return []
    head = [
        "left out",
        "model",
        "of",
        "trained for",
        "tested on",
        *(f"{name}, {how}" for name in names for how in ("with", "without")),
    ]
    about = "A kind of garment left out: scores on the test garments of that kind, trained with and without it."
    return [about, _table(head, rows)]


def _about(task: str) -> str:
    known = TASKS.get(task)
    about = "" if known is None else f"Input: {known.given}. Answer: {known.asked}."
    return " ".join(text for text in (about, NOTES.get(task, "")) if text)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _fact(name: str, value: Any) -> str:
    return f"`{value}`" if name == "command" else f"{value:,}" if isinstance(value, int) else str(value)


if __name__ == "__main__":
    sys.exit(main())
