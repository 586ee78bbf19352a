"""Results of trained models: a file for each in ``benchmarks/reports/learning``, from the reports of the trainings."""

import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from benchmarks.reconstruction.models import MODELS, load_model, stitches
from benchmarks.reconstruction.stitching.net import StitchConfig
from benchmarks.reconstruction.tasks import task_named
from gcd_dataset.errors import ConfigError
from gcd_dataset.files import write_whole

LEAST_MADE = 0.5  # of the garments asked for; a set with fewer is shown with its own number
LEAST_TESTED = 0.9  # of the task's number of test garments; some cannot be draped
HEADLINES: Mapping[str, Sequence[str]] = {
    "T3": ("joined_perfect", "joined_f1", "subdivided_perfect", "subdivided_f1", "freesewing_whole", "freesewing_f1"),
    "T4": ("panel_label", "seam_f1", "edge_label"),
    "T5": ("error_cm", "error_degrees"),
    "T6": ("error_cm", "within_1cm", "ms"),
}
"""Scores of the table of all tasks; of the other tasks ``USUAL``, as far as they have them."""
USUAL = ("strict_within_1cm", "strict_unaided", "combinatorial", "edges_within_1cm", "iou", "stitch_f1", "sim_ok")
OUTSIDE: Mapping[str, str] = {
    "neural_tailor": "trained for minutes, below its published budget",
    "ceiling": "no model: the truth in the output format of `panel_set`",
}
"""Models that are not ranked, and why; nor are references without a training."""
LOWER = ("error_cm", "error_degrees", "ms")
"""Scores where lower is better."""
TABLES: Mapping[str, str] = {
    "one_to_one": "Test patterns, edges subdivided as drawn",
    "one_round": "The same, all seams predicted at once",
    "faultless_by_shape": "Bound: the truth with panels of equal shape exchanged",
    "several": "Edges joined wherever possible, scored on the seams of their parts (n to m)",
}
FREESEWING = 90  # its patterns in ``benchmarks/data``
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
    """A sentence of the report on this result."""
    tested: int = 0
    """Garments of the test set."""
    tests: str = ""
    """Identity of the test set: equal for the same patterns draped at the same resolution."""
    steps: int = 0
    """Steps that were asked for; 0: the training was given a time."""
    asked: float = 0.0
    """Minutes that were asked for; 0: unknown."""
    validation: Sequence[float] = ()
    """The headline on the validation set, by which a record is chosen; empty if it was not asked."""
    seeds: int = 1
    """Trainings that the scores are means of; the ends are then the lowest and the highest."""

    @property
    def trained_on(self) -> str:
        """The garments of the training, as the tables show them."""
        return f"{self.train:,}" + (f" + {self.fresh:,} fresh" if self.fresh else "")

    @property
    def budget(self) -> tuple[str, str, str]:
        """Garments, length and hardware of the training: models are ranked among those with the same."""
        return self.trained_on, self.length, str(self.facts.get("hardware", ""))

    @property
    def outside(self) -> str:
        """Why the entry is not ranked; empty if it is."""
        return OUTSIDE.get(self.model.split()[0], "" if self.minutes else "a reference without a training")

    @property
    def length(self) -> str:
        """The length that was asked for; empty for a reference without a training."""
        if not self.minutes:
            return ""
        if self.steps:
            return f"{self.steps:,} steps"
        minutes = self.asked or round(self.minutes, 1)
        return f"{minutes:g} minute{'s' if minutes != 1 else ''}"

    def score(self, name: str) -> str:
        """A score with its interval; empty if the entry has none."""
        return shown(self.values(name))

    def values(self, name: str) -> Sequence[float]:
        """Mean and ends of the interval of a score, if any, of the first table that has it; or nothing."""
        return self.scores.get(name) or next((t[name] for t in self.tables.values() if name in t), ())


def read_entries(folder: Path) -> list[Entry]:
    """The results in a folder, by task, then as the scores rank them. Raises ``ConfigError`` for unreadable ones."""
    found = [_entry(path) for path in sorted(folder.glob("*.json"))]
    tasks = sorted({entry.task for entry in found})
    return [entry for task in tasks for entry in ranked([e for e in found if e.task == task])]


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


# -------------------------------------------------------------------------------------------------------------- reading


def _entry(path: Path) -> Entry:
    return _checked(_of(_read(path), path), path)


def _read(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: {error}: give the report.json of a training") from error
    if not isinstance(found, dict) or not ("scores" in found or "one_to_one" in found):
        raise ConfigError(f"{path} has no scores: give the report.json of train")
    if isinstance(found.get("foreign"), dict):
        found["foreign"].pop("each", None)
    return found


def _of(found: Mapping[str, Any], path: Path) -> Entry:
    shared = ("parameters", "steps", "command", "commit", "date")
    facts = {name: found[name] for name in shared if name in found} | {"hardware": found.get("device", "unknown")}
    try:
        facts |= {f"{name} set": _data(part) for name, part in found["data"].items()}
        tables = {title: _scores(found[name]) for name, title in TABLES.items() if name in found}
        if "foreign" in found:
            tables[f"{FOREIGN}, {found['foreign']['garments']} patterns"] = _scores(found["foreign"])
        if of_seams := "one_to_one" in found:
            task, scores, kinds = "T3", _scores_of_seams(found), _kinds_of_seams(found)
        else:
            task, scores, kinds = found["task"], found["scores"], found["scores_of_kinds"]
        options = found["arguments"] if "arguments" in found else found.get("options", {})
        left_out, count = options.get("leave_out", ""), int(found["data"]["train"]["count"])
        train = int(options.get("train") or count)
        if count < LEAST_MADE * train and not left_out and not of_seams:
            train = count  # a folder may hold fewer garments than asked for
        minutes = found["minutes"] if "minutes" in found else found["train_s"] / 60
        return Entry(
            task, _model_of(found, options), train, minutes, scores, facts, tables | _tables_of(kinds), kinds, left_out,
            int(found.get("fresh", 0)), str(found.get("remark", "")), **_tests(found),
            steps=int(options.get("steps", 0)), asked=float(options.get("minutes", 0)),
            validation=tuple(found.get("validation", {}).get("scores", {}).get(task_named(task).headline, ())),
        )  # fmt: skip
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ConfigError(f"{path}: {error!r}: no report of this version: train again") from error


def _model_of(found: Mapping[str, Any], options: Mapping[str, Any]) -> str:
    """The model with its unusual options."""
    model = found.get("model", "stitches")
    usual = _usual_of_stitches() if "arguments" in found else _usual_of(model)
    sizes = [f"{name}={size}" for name, size in options.get("sizes", {}).items()]
    return " ".join([model, *sizes, *(["one_round"] if options.get("one_round") else []), *_unusual(options, usual)])


def _unusual(given: Mapping[str, Any], usual: Mapping[str, Any]) -> list[str]:
    """``name=value`` of the options that differ from the usual ones."""
    return [f"{name}={given[name]}" for name, value in usual.items() if given.get(name, value) != value]


def _usual_of(model: str) -> dict[str, Any]:
    """The usual options of a training, besides its length."""
    usual = getattr(load_model(model), "USUAL", {}) if model in MODELS else {}
    return {name: usual[name] for name in ("batch", "lr") if name in usual} | {"seed": 0}


def _usual_of_stitches() -> dict[str, Any]:
    """The usual options of T3, besides its length."""
    sizes = {name: getattr(StitchConfig(), name) for name in ("foreign", "width", "heads", "layers", "pair_width")}
    return {**sizes, **{name: stitches.USUAL[name] for name in ("batch", "lr")}, "seed": 0}


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


def _scores_of_seams(found: Mapping[str, Any]) -> dict[str, list[float]]:
    """The scores of T3: joined edges first, then edges subdivided as drawn, then FreeSewing's patterns."""
    scores = {**_of_seams(found.get("several", {}), "joined"), **_of_seams(found["one_to_one"], "subdivided")}
    if (foreign := found.get("foreign", {})).get("garments") == FREESEWING:  # other numbers do not compare
        whole = [FREESEWING * value for value in foreign["perfect_symmetric"]]
        scores |= {"freesewing_whole": whole, "freesewing_f1": foreign["f1_symmetric"]}
    return scores


def _kinds_of_seams(found: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The scores of each kind of T3; a kind may have no edges to join."""
    several = found.get("several_of_kinds", {})
    return {
        kind: {**_of_seams(several.get(kind, {}), "joined"), **_of_seams(own, "subdivided")}
        for kind, own in found.get("scores_of_kinds", {}).items()
    }


def _of_seams(table: Mapping[str, Any], title: str) -> dict[str, Any]:
    """F1 of the seams, and the share of the garments with all seams right, up to panels of equal shape."""
    names = {"perfect": "perfect_symmetric", "f1": "f1_symmetric"}
    return {f"{title}_{name}": table[own] for name, own in names.items() if own in table}


def ranked(entries: Sequence[Entry]) -> list[Entry]:
    """Entries of a task, the best first by the first score that all of them have."""
    names = [name for entry in entries[:1] for name in HEADLINES.get(entry.task, USUAL)]
    shared = next((name for name in names if all(name in entry.scores for entry in entries)), "")
    sign = 1 if shared in LOWER else -1

    def rank(entry: Entry) -> tuple[float, str, int, str]:
        return sign * float(entry.scores[shared][0]) if shared else 0.0, entry.model, entry.train, entry.left_out

    return sorted(entries, key=rank)


def pooled(entries: Sequence[Entry]) -> list[Entry]:
    """The entries, with one for all trainings that differ in their seed alone: mean, lowest and highest mean score."""
    alike: dict[tuple[Any, ...], list[Entry]] = {}
    for entry in entries:
        model = re.sub(r" seed=\d+", "", entry.model)
        alike.setdefault((entry.task, model, entry.budget, entry.left_out, _test_set(entry)), []).append(entry)
    return [_mean_of(own, str(key[1])) if len(own) > 1 else own[0] for key, own in alike.items()]


def _mean_of(entries: Sequence[Entry], model: str) -> Entry:
    def spread(rows: Sequence[Sequence[float]]) -> Sequence[float]:
        means = [row[0] for row in rows if row]
        return [sum(means) / len(means), min(means), max(means)] if len(means) == len(entries) else ()

    names = [name for name in entries[0].scores if all(entry.scores.get(name) for entry in entries)]
    scores = {name: spread([entry.scores[name] for entry in entries]) for name in names}
    validation = spread([entry.validation for entry in entries])
    return replace(entries[0], model=model, scores=scores, validation=validation, seeds=len(entries))


def _tables_of(kinds: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, list[float]]]:
    return {f"Of {kind}": {name: [value] for name, value in scores.items()} for kind, scores in kinds.items()}


def _test_set(entry: Entry) -> tuple[int, str]:
    return entry.tested, entry.tests


def by_test_set(entries: Sequence[Entry]) -> list[list[Entry]]:
    """Pooled entries of each test set of a task, the best first, without a left out kind; the usual test set first.

    The usual one has about as many garments as the task says, and of such ones the most entries, the latest at a tie.
    """
    found: dict[tuple[int, str], list[Entry]] = {}
    for entry in entries:
        if not entry.left_out:
            found.setdefault(_test_set(entry), []).append(entry)

    def usual(own: Sequence[Entry]) -> tuple[bool, int, str]:
        whole = own[0].tested >= LEAST_TESTED * task_named(own[0].task).tested
        return whole, len(own), max(str(entry.facts.get("date", "")) for entry in own)

    return [ranked(pooled(own)) for own in sorted(found.values(), key=usual, reverse=True)] or [[]]


def shown(values: Sequence[float] | None) -> str:
    """A mean, with the ends of its interval if given; empty for ``None``."""
    if not values:
        return ""
    if len(values) == 1:
        return f"{values[0]:.3g}"
    return f"{values[0]:.3g} ({values[1]:.3g} to {values[2]:.3g})"
