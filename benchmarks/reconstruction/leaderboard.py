"""Reports of trained models: one per task, and a table of all.

    python -m benchmarks.reconstruction.leaderboard                                     writes the reports again
    python -m benchmarks.reconstruction.leaderboard --add OUT/report.json --command "python -m … --out OUT"

``--add`` copies the results of ``train`` or ``stitching.run`` into ``benchmarks/reports/learning``, with command,
commit and date. From the files there the reports ``learning_T0.md`` … and ``leaderboard.md`` are written.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks.reconstruction.tasks import TASKS
from gcd_dataset.errors import ConfigError
from gcd_dataset.files import write_whole

__all__ = ["Entry", "add", "main", "pages", "read_entries"]

REPORTS = Path(__file__).resolve().parents[1] / "reports"
RESULTS = "learning"
HEADLINES: Mapping[str, Sequence[str]] = {
    "T3": ("f1_symmetric", "perfect_symmetric", "f1_several_symmetric"),
}
"""Scores of the table of all tasks; of the other tasks ``USUAL``, as far as they have them."""
USUAL = ("within_1cm", "topology_exact", "iou", "stitch_f1", "panel_count_acc")
PROGRAMS = (
    "`parameters` draws its answers with the programs that drew the test garments; on patterns of other origin it "
    "answers with similar ones that they draw. `neural_tailor` follows the paper, with extensions that its docstring "
    "lists."
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
    "foreign": "Patterns of another origin (T7): FreeSewing's designs",
}


@dataclass(frozen=True)
class Entry:
    """The results of one model."""

    task: str
    model: str
    train: int
    """Garments to train on."""
    minutes: float
    scores: Mapping[str, Sequence[float]]
    """Mean and ends of the 95 % interval of each score."""
    facts: Mapping[str, Any] = field(default_factory=dict)
    """Hardware, parameters, steps, data hashes, command, commit, date."""
    tables: Mapping[str, Mapping[str, Sequence[float]]] = field(default_factory=dict)
    """Further scores by the title of their table."""

    def score(self, name: str) -> str:
        """A score with its interval; empty if the entry has none."""
        values = self.scores.get(name) or next((t[name] for t in self.tables.values() if name in t), None)
        return _shown(values) if values else ""


def read_entries(folder: Path) -> list[Entry]:
    """The results in a folder, by task, then as the scores rank them. Raises ``ConfigError`` for unreadable ones."""
    found = [_entry(path) for path in sorted(folder.glob("*.json"))]
    return sorted(found, key=lambda entry: (entry.task, -_rank(entry), entry.model, entry.train))


def add(path: Path, folder: Path, *, command: str, commit: str, date: str) -> Path:
    """Copy a ``report.json`` into the folder; the new file. Raises ``ConfigError`` for another kind of file."""
    entry = _read(path)
    entry = {**entry, "command": command, "commit": commit, "date": date}
    kind = _of(entry, path)
    name = f"{kind.task}_{kind.model}_{kind.train}.json".lower().replace(" ", "_")
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / name, (json.dumps(entry, indent=1) + "\n").encode())
    return folder / name


def pages(entries: Sequence[Entry]) -> dict[str, str]:
    """File name to text of all reports."""
    tasks = dict.fromkeys(entry.task for entry in entries)
    found = {f"learning_{task}.md": _page(task, [e for e in entries if e.task == task]) for task in tasks}
    return {**found, "leaderboard.md": _leaderboard(entries)}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command. Returns the exit code."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="leaderboard", description=__doc__, formatter_class=formatter)
    parser.add_argument("--reports", type=Path, default=REPORTS, help="folder of the reports (%(default)s)")
    parser.add_argument("--add", type=Path, help="report.json to add")
    parser.add_argument("--command", default="", help="the command that made it")
    parser.add_argument("--commit", default="", help="the commit that it ran from; default: the present one")
    args = parser.parse_args(arguments)
    folder = args.reports / RESULTS
    try:
        if args.add:
            if not args.command:
                raise ConfigError("--add: also give the --command that made the results")
            date = datetime.now(UTC).strftime("%Y-%m-%d")
            add(args.add, folder, command=args.command, commit=args.commit or _commit(), date=date)
        entries = read_entries(folder)
        if not entries:
            raise ConfigError(f"{folder} has no results: give --add OUT/report.json")
    except ConfigError as error:
        print(f"leaderboard: {error}", file=sys.stderr)
        return 1
    for name, text in pages(entries).items():
        write_whole(args.reports / name, text.encode())
        print(args.reports / name)
    return 0


# -------------------------------------------------------------------------------------------------------------- reading


def _entry(path: Path) -> Entry:
    return _of(_read(path), path)


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
    try:
        facts |= {f"{name} set": _data(part) for name, part in found["data"].items()}
        if "one_to_one" in found:
            arguments = found["arguments"]
            variants = [name for name in ("placed", "autosew", "one_round") if arguments.get(name)]
            tables = {title: _scores(found[name]) for name, title in TABLES.items() if name in found}
            name = " ".join(["stitches", *variants])
            scores = _scores(found["one_to_one"])
            return Entry("T3", name, int(arguments["train"]), found["train_s"] / 60, scores, facts, tables)
        kinds = {f"Of {kind}": {k: [v] for k, v in of.items()} for kind, of in found["scores_of_kinds"].items()}
        train = found["data"]["train"]["count"]
        return Entry(found["task"], found["model"], train, found["minutes"], found["scores"], facts, kinds)
    except (KeyError, TypeError, AttributeError) as error:
        raise ConfigError(f"{path}: {error!r} is missing: train again with this version") from error


def _data(part: Mapping[str, Any]) -> str:
    return f"{part['count']} garments, patterns {str(part['patterns'])[:16]}, samples {str(part['ids'])[:16]}"


def _scores(table: Mapping[str, Any]) -> dict[str, list[float]]:
    return {name: list(values) for name, values in table.items() if isinstance(values, list)}


def _rank(entry: Entry) -> float:
    for name in (*HEADLINES.get(entry.task, ()), *USUAL):
        if name in entry.scores:
            return float(entry.scores[name][0])
    return 0.0


# -------------------------------------------------------------------------------------------------------------- writing


def _page(task: str, entries: Sequence[Entry]) -> str:
    """The report of a task."""
    names = list(dict.fromkeys(name for entry in entries for name in entry.scores))
    head = ["model", "trained on", "minutes", *names]
    rows = [[e.model, f"{e.train:,}", f"{e.minutes:.1f}", *(e.score(name) for name in names)] for e in entries]
    parts = [f"# {task}", _about(task), _table(head, rows)]
    for entry in entries:
        parts.append(f"## {entry.model}, {entry.train:,} garments")
        shown = {title: table for title, table in entry.tables.items() if table}
        columns = list(dict.fromkeys(name for table in shown.values() for name in table))
        if shown:
            cells = [[title, *(_shown(table.get(name)) for name in columns)] for title, table in shown.items()]
            parts.append(_table(["on", *columns], cells))
        parts.append("\n".join(f"- {name}: {_fact(name, value)}" for name, value in entry.facts.items()))
    return "\n\n".join(parts) + "\n"


def _leaderboard(entries: Sequence[Entry]) -> str:
    lines = ["# Leaderboard", "The scores of each task that its report puts first; means with 95 % intervals."]
    for task in dict.fromkeys(entry.task for entry in entries):
        own = [entry for entry in entries if entry.task == task]
        names = [name for name in (*HEADLINES.get(task, ()), *USUAL) if any(e.score(name) for e in own)]
        names = names[: max(3, len(HEADLINES.get(task, ())))]
        rows = [[e.model, f"{e.train:,}", f"{e.minutes:.1f}", *(e.score(name) for name in names)] for e in own]
        lines += [f"## {task}", _about(task) + f" [Report](learning_{task}.md)."]
        lines.append(_table(["model", "trained on", "minutes", *names], rows))
    return "\n\n".join(lines) + "\n"


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


def _commit() -> str:
    given = ["git", "-C", str(REPORTS), "rev-parse", "--short", "HEAD"]
    return subprocess.run(given, capture_output=True, text=True, check=True).stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
