"""Reports of trained models: one per task, and a table of all.

    python -m benchmarks.reconstruction.leaderboard                                     writes the reports again
    python -m benchmarks.reconstruction.leaderboard --add OUT/report.json --command "python -m … --out OUT"

``--add`` copies the results of ``train`` or ``stitching.run`` into ``benchmarks/reports/learning``, with command,
commit and date; smoke runs are refused. From the files there the reports ``learning_T0.md`` …, their curves over the
number of garments and ``leaderboard.md`` are written. Models are ranked on one test set for each task; results on other
garments have tables of their own.
"""

import argparse
import io
import subprocess
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks.reconstruction.results import HEADLINES, USUAL, Entry, add, by_test_set, read_entries, shown
from benchmarks.reconstruction.tasks import TASKS
from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.files import write_whole

REPORTS = Path(__file__).resolve().parents[1] / "reports"
RESULTS = "learning"
CURVES, COLUMNS = 3, 5  # of the scores of ``HEADLINES``: drawn and shown by kind, and in the table of all tasks
COLOURS, MARKS = 10, "os^Dv*"  # of the lines of curves
LABEL_APART = 1.3  # least ratio of neighbouring tick labels on a logarithmic axis
PROGRAMS = (
    "`parameters` draws its answers with the programs that drew the test garments; on patterns of other origin it "
    "answers with similar ones that they draw. Where no remark says otherwise, its answers are means over all points "
    "of a garment; `panel_set` and `edge_tokens` answer from 4,096 points, `neural_tailor` from 4,096 or `points`, and "
    "`nearest` compares 512. `neural_tailor` (removed on 2026-11-27) follows the paper. `ceiling` is "
    "no model: the truth in the output format of `panel_set`."
)
NOTES: Mapping[str, str] = {
    **dict.fromkeys(("T0", "T1", "T1-scan"), PROGRAMS),
    "T3": "`f1` compares edges by name; `f1_symmetric` accepts answers in which panels of equal shape are exchanged, "
    "since nothing tells these apart. `f1_several` counts only seams of more than one edge on a side.",
}


def pages(entries: Sequence[Entry]) -> dict[str, str]:
    """File name to text of all reports."""
    tasks = dict.fromkeys(entry.task for entry in entries)
    found = {f"learning_{task}.md": _page(task, [e for e in entries if e.task == task]) for task in tasks}
    return {**found, "leaderboard.md": _leaderboard(entries)}


def curves(entries: Sequence[Entry]) -> dict[str, bytes]:
    """File name to PNG: the first scores of a task against the garments trained on, if these differ in number."""
    tasks = dict.fromkeys(entry.task for entry in entries)
    own = {task: by_test_set([e for e in entries if e.task == task])[0] for task in tasks}
    return {_curve_file(task): _drawn(task, some) for task, some in own.items() if _has_curve(some)}


def write_pages(reports: Path) -> list[Path]:
    """Write the reports of the results in a folder; the files. Raises ``ConfigError`` if there are none."""
    entries = read_entries(reports / RESULTS)
    if not entries:
        raise ConfigError(f"{reports / RESULTS} has no results: give --add OUT/report.json")
    texts = {name: text.encode() for name, text in pages(entries).items()}
    written = {**texts, **curves(entries)}
    for name, data in written.items():
        write_whole(reports / name, data)
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


def _first_scores(task: str, entries: Sequence[Entry], most: int = CURVES) -> list[str]:
    """Names of the scores that tables and curves show, the headline first."""
    names = [name for name in HEADLINES.get(task, USUAL) if any(e.score(name) for e in entries)]
    return names[:most]


# -------------------------------------------------------------------------------------------------------------- writing


def _page(task: str, entries: Sequence[Entry]) -> str:
    """The report of a task."""
    whole, *others = by_test_set(entries)
    names = list(dict.fromkeys(name for own in (whole, *others) for entry in own for name in entry.scores))
    parts = [f"# {task}", _about(task), *_ranking(whole, names), *_over_size(task, whole)]
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
        "The scores of each task that its report puts first; means with 95 % intervals. A table ranks models that were "
        "tested on the same garments. Scores of patterns: [definitions](../../docs/evaluate.md#scores).",
    ]
    for task in dict.fromkeys(entry.task for entry in entries):
        own = [entry for entry in entries if entry.task == task]
        whole, *others = by_test_set(own)
        names = _first_scores(task, own, COLUMNS)
        lines += [f"## {task}", _about(task) + f" [Report](learning_{task}.md)."]
        lines += [*_ranking(whole, names), *_on_others(others, names), *_left_out(task, own)]
    return "\n\n".join(lines) + "\n"


def _ranking(entries: Sequence[Entry], names: Sequence[str]) -> list[str]:
    """The scores of one test set; nothing without entries."""
    if not entries:
        return []
    rows = [[e.model, e.trained_on, _spent(e), *(e.score(name) for name in names)] for e in entries]
    about = f"Tested on {entries[0].tested:,} garments (patterns {entries[0].tests})."
    return [about, _table(["model", "trained on", "minutes", *names], rows)]


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


# ----------------------------------------------------------------------------------------------------------- the curves


def _over_size(task: str, entries: Sequence[Entry]) -> list[str]:
    """Table and picture of the first scores against the number of garments."""
    if not _has_curve(entries):
        return []
    sizes = sorted({entry.train + entry.fresh for entry in entries})
    rows = []
    for name in _first_scores(task, entries):
        for model, own in _by_model(entries).items():
            by_size = {entry.train + entry.fresh: entry.score(name) for entry in own}
            rows.append([name, model, *(by_size.get(size, "") for size in sizes)])
    about = "Score against the number of garments trained on, fresh ones included:"
    head = ["score", "model", *(f"{size:,}" for size in sizes)]
    return [about, _table(head, rows), f"![Score against the number of garments]({_curve_file(task)})"]


def _has_curve(entries: Sequence[Entry]) -> bool:
    """Whether a model was trained on sets of different sizes."""
    return any(len({e.train + e.fresh for e in own}) > 1 for own in _by_model(entries).values())


def _by_model(entries: Sequence[Entry]) -> dict[str, list[Entry]]:
    """The entries of each model, the best first, by the number of garments.

    A model that was trained for different times, or numbers of steps, has a row for each.
    """
    lengths: dict[str, set[str]] = {}
    for entry in entries:
        lengths.setdefault(entry.model, set()).add(entry.length)
    found: dict[str, list[Entry]] = {}
    for entry in entries:
        several = len(lengths[entry.model]) > 1
        name = f"{entry.model}, {entry.length}" if several else entry.model
        found.setdefault(name, []).append(entry)
    return {name: sorted(own, key=lambda e: e.train + e.fresh) for name, own in found.items()}


def _curve_file(task: str) -> str:
    return f"learning_{task}.png"


def _mark(number: int, *, fresh: bool) -> dict[str, Any]:
    """Colour and marks of the line of a model: ten colours, then the same with other marks, for up to 60 models."""
    mark = MARKS[number // COLOURS % len(MARKS)]
    return {"fmt": f"{mark}-", "color": f"C{number % COLOURS}"} | ({"markerfacecolor": "white"} if fresh else {})


def _drawn(task: str, entries: Sequence[Entry]) -> bytes:
    """A plot for each of the first scores, a line for each model; bars are 95 % intervals, hollow marks fresh garments.

    Raises ``ConfigError`` without matplotlib.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
        from matplotlib.ticker import FuncFormatter, NullLocator
    except ImportError as error:
        raise ConfigError("the curves need matplotlib: pip install 'gcd-dataset[bench]'") from error
    names = _first_scores(task, entries)
    figure = Figure(figsize=(4.2 * len(names) + 1.6, 3.4), layout="constrained")
    for k, name in enumerate(names):
        plot = figure.add_subplot(1, len(names), k + 1)
        for number, (model, own) in enumerate(_by_model(entries).items()):
            points = [(e.train + e.fresh, e.fresh, *e.values(name)) for e in own if len(e.values(name)) == 3]
            for is_fresh in (False, True):
                some = [(x, y, y - low, high - y) for x, fresh, y, low, high in points if bool(fresh) == is_fresh]
                if some:
                    x, y, below, above = zip(*some, strict=True)
                    label = f"{model}, fresh" if is_fresh else model
                    style = {"capsize": 2, "markersize": 5, "linewidth": 1.2, **_mark(number, fresh=is_fresh)}
                    plot.errorbar(x, y, yerr=(below, above), label=label, **style)
        plot.set_xscale("log")
        plot.set_xticks(_apart(sorted({e.train + e.fresh for e in entries})))
        plot.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
        plot.xaxis.set_minor_locator(NullLocator())
        plot.set_xlabel("garments trained on")
        plot.set_title(f"{task}: {name}", fontsize=10)
        plot.grid(alpha=0.3)
    marks: dict[str, Any] = {}
    for plot in figure.axes:  # a model may lack the first score
        marks |= {label: mark for mark, label in zip(*plot.get_legend_handles_labels(), strict=True)}
    labels = sorted(marks)
    figure.legend([marks[label] for label in labels], labels, loc="outside right upper", fontsize=8)
    file = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(file, format="png", metadata={"Software": None})
    return file.getvalue()


def _apart(numbers: Sequence[int]) -> list[int]:
    """Tick positions whose labels do not overlap on a logarithmic axis: of two near ones, the greater stays.

    >>> _apart([1000, 4000, 13_956, 16_000])
    [1000, 4000, 16000]
    """
    kept: list[int] = []
    for number in reversed(numbers):
        if not kept or kept[0] >= LABEL_APART * number:
            kept.insert(0, number)
    return kept


def _about(task: str) -> str:
    known = TASKS.get(task)
    about = "" if known is None else f"Input: {known.given}. Answer: {known.asked}."
    return " ".join(text for text in (about, NOTES.get(task, "")) if text)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _fact(name: str, value: Any) -> str:
    if name == "command":
        return f"`{value}`"
    return f"{value:,}" if isinstance(value, int) else str(value)


if __name__ == "__main__":
    sys.exit(main())
