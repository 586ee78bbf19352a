"""Reports of trained models: one per task, and a table of all.

    python -m benchmarks.reconstruction.leaderboard                                     writes the reports again
    python -m benchmarks.reconstruction.leaderboard --add OUT/report.json --command "python -m … --out OUT"

``--add`` copies the results of ``train`` or ``stitching.run`` into ``benchmarks/reports/learning``, with command,
commit and date; smoke runs are refused. From the files there the reports ``learning_T0.md`` …, their curves over the
number of garments and ``leaderboard.md`` are written. Models are ranked on one test set for each task; results on other
garments have tables of their own.
"""

import argparse
import hashlib
import io
import json
import math
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.reconstruction.models import MODELS, load_model
from benchmarks.reconstruction.stitching import run as stitching
from benchmarks.reconstruction.tasks import TASKS, task_named
from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.files import write_whole

__all__ = [
    "REPORTS",
    "RESULTS",
    "Entry",
    "add",
    "commit_here",
    "curves",
    "main",
    "pages",
    "read_entries",
    "write_pages",
]

REPORTS = Path(__file__).resolve().parents[1] / "reports"
RESULTS = "learning"
LEAST_MADE = 0.5  # of the garments asked for; a set with fewer is shown with its own number
LEAST_TESTED = 0.9  # of the task's number of test garments; some cannot be draped
HEADLINES: Mapping[str, Sequence[str]] = {
    "T3": ("f1_symmetric", "perfect_symmetric", "f1_several_symmetric"),
    "T4": ("panel_label", "seam_f1", "edge_label"),
    "T5": ("error_cm", "error_degrees"),
    "T6": ("error_cm", "within_1cm", "ms"),
}
"""Scores of the table of all tasks; of the other tasks ``USUAL``, as far as they have them."""
USUAL = ("within_1cm", "topology_exact", "iou", "stitch_f1", "sim_ok", "panel_count_acc")
CURVES, COLUMNS = 3, 5  # of these scores: drawn and shown by kind, and in the table of all tasks
LABEL_APART = 1.3  # least ratio of neighbouring tick labels on a logarithmic axis
LOWER = ("error_cm", "error_degrees", "ms")
"""Scores of which the lower is the better."""
PROGRAMS = (
    "`parameters` draws its answers with the programs that drew the test garments; on patterns of other origin it "
    "answers with similar ones that they draw. `neural_tailor` follows the paper, with extensions that its docstring "
    "lists. `ceiling` is no model: the truth in the output format of `panel_set`."
)
NOTES: Mapping[str, str] = {
    **dict.fromkeys(("T0", "T1", "T1-scan"), PROGRAMS),
    "T3": "`f1` compares edges by name; `f1_symmetric` accepts answers in which panels of equal shape are exchanged, "
    "since nothing tells these apart. `f1_several` counts only seams of more than one edge on a side.",
}
TABLES: Mapping[str, str] = {
    "one_to_one": "Test patterns, edges subdivided as drawn",
    "one_round": "The same, all seams predicted at once",
    "faultless_by_shape": "Bound: the truth with panels of equal shape exchanged",
    "several": "Edges joined wherever possible, scored on the seams of their parts (n to m)",
}
FOREIGN = "Patterns of another origin (T7): FreeSewing's designs"


@dataclass(frozen=True)
class Entry:
    """The results of one model."""

    task: str
    model: str
    train: int
    """Garments to train on."""
    minutes: float
    """Time that the steps took."""
    scores: Mapping[str, Sequence[float]]
    """Mean and ends of the 95 % interval of each score."""
    facts: Mapping[str, Any] = field(default_factory=dict)
    """Hardware, parameters, steps, data hashes, command, commit, date."""
    tables: Mapping[str, Mapping[str, Sequence[float]]] = field(default_factory=dict)
    """Further scores by the title of their table."""
    kinds: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Mean scores on the test garments of each kind."""
    left_out: str = ""
    """Kind of garment that is tested on and not trained on."""
    fresh: int = 0
    """Garments made during the training, besides ``train``."""
    remark: str = ""
    """What the scores do not tell."""
    tested: int = 0
    """Garments of the test set."""
    tests: str = ""
    """Which garments these are: equal for the same patterns, draped at the same resolution."""
    steps: int = 0
    """Steps that were asked for; 0: the training was given a time."""
    asked: float = 0.0
    """Minutes that were asked for; 0: unknown."""

    @property
    def trained_on(self) -> str:
        """The garments of the training, as the tables show them."""
        return f"{self.train:,}" + (f" + {self.fresh:,} fresh" if self.fresh else "")

    @property
    def length(self) -> str:
        """How long the training was to be; empty for a reference without one."""
        if not self.minutes:
            return ""
        if self.steps:
            return f"{self.steps:,} steps"
        minutes = self.asked or round(self.minutes, 1)
        return f"{minutes:g} minute{'s' if minutes != 1 else ''}"

    def score(self, name: str) -> str:
        """A score with its interval; empty if the entry has none."""
        return _shown(self.values(name))

    def values(self, name: str) -> Sequence[float]:
        """Mean and ends of the interval of a score, if any, of the first table that has it; or nothing."""
        return self.scores.get(name) or next((t[name] for t in self.tables.values() if name in t), ())


def read_entries(folder: Path) -> list[Entry]:
    """The results in a folder, by task, then as the scores rank them. Raises ``ConfigError`` for unreadable ones."""
    found = [_entry(path) for path in sorted(folder.glob("*.json"))]
    tasks = sorted({entry.task for entry in found})
    return [entry for task in tasks for entry in _ranked([e for e in found if e.task == task])]


def add(path: Path, folder: Path, *, command: str, commit: str, date: str, remark: str = "") -> Path:
    """Copy a ``report.json`` into the folder; the new file. Raises ``ConfigError`` for another file or a smoke run.

    It replaces the result of the same model and options, task and garments, trained for as long and tested alike.
    """
    entry = _read(path)
    entry = {**entry, "command": command, "commit": commit, "date": date, "remark": remark}
    kind = _checked(_of(entry, path), path)
    if _is_smoke(entry):
        raise ConfigError(f"{path}: a smoke run, which tells nothing about a model: run it again without --smoke")
    variant = ("_fresh" if kind.fresh else "") + (f"_without_{kind.left_out}" if kind.left_out else "")
    variant += re.sub(r"^(.+) (steps|min).*$", r"_\1\2", kind.length).replace(",", "")
    name = f"{kind.task}_{kind.model}_{kind.train}{variant}".lower().replace(" ", "_")
    file = folder / f"{name}.json"
    if file.exists() and _test_set(_entry(file)) != _test_set(kind):
        digest = hashlib.sha256(kind.tests.encode()).hexdigest()[:8]
        file = folder / f"{name}_test{kind.tested}_{digest}.json"
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(file, (json.dumps(entry, indent=1) + "\n").encode())
    return file


def pages(entries: Sequence[Entry]) -> dict[str, str]:
    """File name to text of all reports."""
    tasks = dict.fromkeys(entry.task for entry in entries)
    found = {f"learning_{task}.md": _page(task, [e for e in entries if e.task == task]) for task in tasks}
    return {**found, "leaderboard.md": _leaderboard(entries)}


def curves(entries: Sequence[Entry]) -> dict[str, bytes]:
    """File name to PNG: the first scores of a task against the garments trained on, if these differ in number."""
    tasks = dict.fromkeys(entry.task for entry in entries)
    own = {task: _by_test_set([e for e in entries if e.task == task])[0] for task in tasks}
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


# -------------------------------------------------------------------------------------------------------------- reading


def _entry(path: Path) -> Entry:
    return _checked(_of(_read(path), path), path)


def _read(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: {error}: give the report.json of a training") from error
    if not isinstance(found, dict) or not ("scores" in found or "one_to_one" in found):
        raise ConfigError(f"{path} has no scores: give the report.json of train or stitching.run")
    if isinstance(found.get("foreign"), dict):
        found["foreign"].pop("each", None)
    return found


def _of(found: Mapping[str, Any], path: Path) -> Entry:
    shared = ("parameters", "steps", "command", "commit", "date")
    facts = {name: found[name] for name in shared if name in found} | {"hardware": found.get("device", "unknown")}
    remark = str(found.get("remark", ""))
    try:
        facts |= {f"{name} set": _data(part) for name, part in found["data"].items()}
        if "one_to_one" in found:
            arguments = found["arguments"]
            variants = [name for name in ("placed", "autosew", "one_round") if arguments.get(name)]
            variants += _unusual(arguments, _usual_of_stitches())
            tables = {title: _scores(found[name]) for name, title in TABLES.items() if name in found}
            if "foreign" in found:
                tables[f"{FOREIGN}, {found['foreign']['garments']} patterns"] = _scores(found["foreign"])
            name = " ".join(["stitches", *variants])
            scores, kinds = _scores(found["one_to_one"]), _with_several(found)
            left_out = arguments.get("leave_out", "")
            tables |= _tables_of(kinds)
            minutes = found["train_s"] / 60
            train = int(arguments["train"])
            return Entry(
                "T3", name, train, minutes, scores, facts, tables, kinds, left_out, remark=remark, **_tests(found),
                steps=int(arguments.get("steps", 0)), asked=float(arguments.get("minutes", 0)),
            )  # fmt: skip
        options, kinds = found.get("options", {}), found["scores_of_kinds"]
        left_out, count = options.get("leave_out", ""), int(found["data"]["train"]["count"])
        train = int(options.get("train") or count)
        if count < LEAST_MADE * train and not left_out:
            train = count  # a folder may hold fewer garments than asked for
        unusual = _unusual(options, _usual_of(found["model"]))
        model = " ".join(
            [found["model"], *(f"{name}={size}" for name, size in options.get("sizes", {}).items()), *unusual]
        )
        return Entry(
            found["task"], model, train, found["minutes"], found["scores"], facts, _tables_of(kinds), kinds,
            left_out, int(found.get("fresh", 0)), remark, **_tests(found),
            steps=int(options.get("steps", 0)), asked=float(options.get("minutes", 0)),
        )  # fmt: skip
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ConfigError(f"{path}: {error!r}: no report of this version: train again") from error


def _unusual(given: Mapping[str, Any], usual: Mapping[str, Any]) -> list[str]:
    """``name=value`` of the options that differ from the usual ones."""
    return [f"{name}={given[name]}" for name, value in usual.items() if given.get(name, value) != value]


def _usual_of(model: str) -> dict[str, Any]:
    """The usual options of a training, besides its length."""
    usual = getattr(load_model(model), "USUAL", {}) if model in MODELS else {}
    return {name: usual[name] for name in ("batch", "lr") if name in usual} | {"seed": 0}


@cache
def _usual_of_stitches() -> dict[str, Any]:
    """The usual options of T3, besides its length."""
    parser = argparse.ArgumentParser()
    stitching.add_arguments(parser)
    names = ("foreign", "width", "heads", "layers", "pair_width", "batch", "lr", "seed")
    return {name: parser.get_default(name) for name in names}


def _checked(entry: Entry, path: Path) -> Entry:
    """The entry. Raises ``ConfigError`` for an unknown task, and for scores that are no finite numbers."""
    task_named(entry.task)
    if not isinstance(entry.scores, Mapping):
        raise ConfigError(f"{path}: scores are {entry.scores!r:.99}: give a map of names to numbers")
    each = {"minutes": [entry.minutes], **entry.scores}
    each |= {f"{title}, {name}": values for title, table in entry.tables.items() for name, values in table.items()}
    for name, values in each.items():
        numbers = isinstance(values, Sequence) and all(isinstance(value, int | float) for value in values)
        if not numbers or len(values) not in (1, 3) or not all(map(math.isfinite, values)):
            raise ConfigError(f"{path}: {name} is {values!r:.99}: give a mean, or a mean and the ends of its interval")
    return entry


def _tests(found: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of an entry that tell the test set."""
    part = found["data"]["test"]
    resolution = part.get("recipe", {}).get("recipe", {}).get("resolution")
    drapes = f", meshes of {resolution:g} cm" if resolution else ""
    return {"tested": int(part["count"]), "tests": f"{str(part['patterns'])[:16]}{drapes}"}


def _is_smoke(found: Mapping[str, Any]) -> bool:
    """Whether a report is of a smoke run, which its command, its options or its garments of one kind tell."""
    options = {**found.get("options", {}), **found.get("arguments", {})}
    design = found["data"]["test"].get("recipe", {}).get("recipe", {}).get("design")
    return bool(options.get("smoke") or design or "--smoke" in found["command"].split())


def _data(part: Mapping[str, Any]) -> str:
    return f"{part['count']} garments, patterns {str(part['patterns'])[:16]}, samples {str(part['ids'])[:16]}"


def _scores(table: Mapping[str, Any]) -> dict[str, list[float]]:
    return {name: list(values) for name, values in table.items() if isinstance(values, list)}


def _with_several(found: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    """The scores of each kind of T3, with those that only seams n to m have."""
    several, kinds = found.get("several_of_kinds", {}), found.get("scores_of_kinds", {})
    return {
        kind: own | {name: mean for name, mean in several.get(kind, {}).items() if name not in {*own, "garments"}}
        for kind, own in kinds.items()
    }


def _tables_of(kinds: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, list[float]]]:
    return {f"Of {kind}": {name: [value] for name, value in scores.items()} for kind, scores in kinds.items()}


def _ranked(entries: Sequence[Entry]) -> list[Entry]:
    """Entries of a task, the best first by the first score that all of them have."""
    names = [name for entry in entries[:1] for name in HEADLINES.get(entry.task, USUAL)]
    shared = next((name for name in names if all(name in entry.scores for entry in entries)), "")
    sign = 1 if shared in LOWER else -1

    def rank(entry: Entry) -> tuple[float, str, int, str]:
        return sign * float(entry.scores[shared][0]) if shared else 0.0, entry.model, entry.train, entry.left_out

    return sorted(entries, key=rank)


def _test_set(entry: Entry) -> tuple[int, str]:
    return entry.tested, entry.tests


def _by_test_set(entries: Sequence[Entry]) -> list[list[Entry]]:
    """Ranked entries of each test set of a task, without those that leave out a kind; the usual test set first.

    The usual one has about as many garments as the task says, and of such ones the most entries, the latest at a tie.
    """
    found: dict[tuple[int, str], list[Entry]] = {}
    for entry in entries:
        if not entry.left_out:
            found.setdefault(_test_set(entry), []).append(entry)

    def usual(own: Sequence[Entry]) -> tuple[bool, int, str]:
        whole = own[0].tested >= LEAST_TESTED * task_named(own[0].task).tested
        return whole, len(own), max(str(entry.facts.get("date", "")) for entry in own)

    return [_ranked(own) for own in sorted(found.values(), key=usual, reverse=True)] or [[]]


def _first_scores(task: str, entries: Sequence[Entry], most: int = CURVES) -> list[str]:
    """Names of the scores that tables and curves show, the headline first."""
    names = [name for name in HEADLINES.get(task, USUAL) if any(e.score(name) for e in entries)]
    return names[:most]


# -------------------------------------------------------------------------------------------------------------- writing


def _page(task: str, entries: Sequence[Entry]) -> str:
    """The report of a task."""
    whole, *others = _by_test_set(entries)
    names = list(dict.fromkeys(name for own in (whole, *others) for entry in own for name in entry.scores))
    parts = [f"# {task}", _about(task), *_ranking(whole, names), *_over_size(task, whole)]
    parts += [*_on_others(others, names), *_left_out(task, entries)]
    for entry in entries:
        without = f", without {entry.left_out}" if entry.left_out else ""
        length = f", {entry.length}" if entry.length else ""
        parts.append(f"## {entry.model}, {entry.trained_on} garments{without}{length}")
        parts += [entry.remark] if entry.remark else []
        shown = {title: table for title, table in entry.tables.items() if table}
        columns = list(dict.fromkeys(name for table in shown.values() for name in table))
        if shown:
            cells = [[title, *(_shown(table.get(name)) for name in columns)] for title, table in shown.items()]
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
        whole, *others = _by_test_set(own)
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
    names, rows = _first_scores(task, entries), []
    whole = _by_test_set(entries)[0]
    for entry in sorted((e for e in entries if e.left_out), key=lambda e: (e.model, e.train, e.left_out)):
        peers = [e for e in whole if (e.model, e.train, e.fresh) == (entry.model, entry.train, 0)]
        peers.sort(key=lambda e: (e.length != entry.length, abs(e.minutes - entry.minutes)))
        known = peers[0].kinds.get(entry.left_out, {}) if peers else {}
        cells = [
            cell for name in names for cell in (_shown([known[name]] if name in known else None), entry.score(name))
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
                    style: dict[str, Any] = {"color": f"C{number}", "capsize": 2, "markersize": 5, "linewidth": 1.2}
                    style |= {"markerfacecolor": "white"} if is_fresh else {}
                    plot.errorbar(x, y, yerr=(below, above), fmt="o-", label=label, **style)
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
    """Increasing numbers without those whose labels a greater one would cover on a logarithmic axis.

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


def _shown(values: Sequence[float] | None) -> str:
    if not values:
        return ""
    if len(values) == 1:
        return f"{values[0]:.3g}"
    return f"{values[0]:.3g} ({values[1]:.3g} to {values[2]:.3g})"


def _fact(name: str, value: Any) -> str:
    if name == "command":
        return f"`{value}`"
    return f"{value:,}" if isinstance(value, int) else str(value)


if __name__ == "__main__":
    sys.exit(main())
