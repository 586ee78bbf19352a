"""``score``: a folder of answers against true patterns, or against the test set of a task of the scoreboard."""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from gcd_dataset import __version__
from gcd_dataset.errors import ConfigError, SpecError
from gcd_dataset.scoring.answers import AnswerReader
from gcd_dataset.scoring.bodies import NEUTRAL, Wearers, wearers_of
from gcd_dataset.scoring.distances import input_files, read_shape
from gcd_dataset.scoring.garments import SPACING, Scored, read_true, remarks_of, score_pair, true_files
from gcd_dataset.scoring.inputs import INPUT_DRAPES, TASKS, TaskFolder, device_class, is_task_folder, read_task
from gcd_dataset.scoring.table import Summary, garment_table, line_of, summaries, summaries_by_kind, tree_of
from gcd_dataset.workers import parallel_map

One = TypeVar("One")
Shown = Callable[[Iterable[Scored], int, str], Iterable[Scored]]
"""Shows the progress of an iterable of a known length, with a word for what is done."""


@dataclass(frozen=True)
class Drapes:
    """How answers are draped."""

    inputs: Path | None = None
    """Folder of the meshes or points from which garments were predicted; without it the true patterns are draped."""
    partial: bool = False
    """Whether inputs show a part of the garment, as a scan does."""
    resolution: float = SPACING
    device: str = "auto"


@dataclass(frozen=True)
class Scores:
    """The scores of all garments."""

    garments: tuple[Scored, ...]
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Versions, options, and hashes of what the answers were compared with."""
    remarks: tuple[str, ...] = ()
    """What a user should know: names that do not match, repairs."""

    def lines(self, *, by_kind: bool = False) -> Iterator[str]:
        """The report: a table of the garments, and a line for each figure."""
        yield garment_table(self.garments)
        yield ""
        yield f"score.garments {len(self.garments)} garments"
        yield f"score.failed {sum(bool(garment.failure) for garment in self.garments)} garments"
        yield from map(line_of, self.figures())
        for kind, rows in summaries_by_kind(self.garments).items() if by_kind else ():
            word = "".join(char if char.isalnum() else "_" for char in kind)
            yield f"score.{word}.garments {sum(garment.kind == kind for garment in self.garments)} garments"
            yield from (line_of(row, f"score.{word}") for row in rows)

    def figures(self) -> list[Summary]:
        """Every score over the garments."""
        return summaries(self.garments)

    def tree(self) -> dict[str, Any]:
        """Settings, figures and the scores of each garment, for a JSON file."""
        return tree_of(self.garments, self.figures(), summaries_by_kind(self.garments), self.settings)


def _unshown(garments: Iterable[Scored], total: int, word: str) -> Iterable[Scored]:
    return garments


def score(
    answers: Path,
    truth: Path,
    *,
    repair: bool = False,
    bodies: str | None = None,
    drapes: Drapes | None = None,
    workers: int = 1,
    shown: Shown = _unshown,
) -> Scores:
    """The scores of a folder of answers. A missing answer gets the worst of every score.

    ``truth``: a folder of true specification files, or a folder of ``write_inputs``, which has bodies and inputs of its
    own, and of T4, T5, T6 and T8 answers that are no patterns: see ``scoring.arrays``. ``repair``: see
    ``AnswerReader``. ``bodies``: see ``wearers_of``. ``drapes``: also drape the answers.

    Raises ``GcdError`` for folders, true patterns, bodies and inputs that are missing or cannot be read.
    """
    task = read_task(truth) if is_task_folder(truth) else None
    arrays = task is not None and TASKS[task.task].truth is not None
    if arrays and (repair or bodies or drapes):
        raise ConfigError(f"{truth}: answers are no patterns: leave out --repair, --bodies and --drape")
    if task:
        task.require_frozen()
        truth, bodies = task.truth, bodies or str(task.bodies)
        if drapes and task.task in INPUT_DRAPES:  # its inputs are points, with which drapes are compared
            drapes = Drapes(task.inputs, INPUT_DRAPES[task.task], drapes.resolution, drapes.device)
    files = true_files(truth)
    hashes = {"truth": _hash_of(files)}
    settings: dict[str, Any] = {"gcd_dataset": __version__, "numpy": np.__version__, "hashes": hashes}
    settings |= {"task": task.task, "mini": task.mini, "device": task.device} if task else {}
    if task and arrays:
        return _score_arrays(task, answers, files, settings, shown)
    settings["repair"] = repair
    wearers = wearers_of(bodies or NEUTRAL)
    reader = AnswerReader(repair, (lambda name: wearers.wearer(name, legs_apart=False)[1]) if bodies else None)
    found = reader.read(answers, files.keys())
    remarks = [*(f"{answers}: {line}" for line in remarks_of(found, files))]
    remarks += [f"{answer.path}: {line}" for answer in found.values() for line in answer.remarks]
    pairs = (
        (name, read_true(path), *((one.pattern, one.failure) if (one := found.get(name)) else (None, "")))
        for name, path in sorted(files.items())
    )
    garments = list(shown(parallel_map(score_pair, pairs, workers), len(files), "scored"))
    if drapes:
        given = _inputs(drapes.inputs, files)
        shapes = {name: read_shape(path) for name, path in given.items()}
        wearers.require(files)
        settings |= {"drape": True, "resolution": drapes.resolution, "partial": drapes.partial}
        settings["draped_on"] = device_class(drapes.device)
        hashes["bodies"] = _bodies_hash(bodies or NEUTRAL)
        if drapes.inputs:
            hashes["inputs"] = _hash_of(given)
        from gcd_dataset.scoring.draping import with_drapes

        draped = with_drapes(
            garments,
            wearers,
            own=Wearers(answers, NEUTRAL, {}),
            inputs=shapes if drapes.inputs else None,
            partial=drapes.partial,
            spacing=drapes.resolution,
            device=drapes.device,
            workers=workers,
        )
        garments = list(shown(draped, len(files), "draped"))
    return Scores(tuple(garments), settings, tuple(remarks))


def _score_arrays(
    task: TaskFolder, answers: Path, files: Mapping[str, Path], settings: Mapping[str, Any], shown: Shown
) -> Scores:
    from gcd_dataset.scoring.arrays import answer_files, score_arrays

    found = answer_files(task, answers)
    given = {path.stem for path in task.inputs.iterdir()}
    asked = {name: path for name, path in files.items() if name in given}
    remarks = [f"{answers}: {line}" for line in remarks_of(found, asked)]
    if left := len(files) - len(asked):
        remarks.append(f"{task.inputs}: {left} of {len(files)} garments have no input, and no score")
    scored = (score_arrays(task, name, read_true(path), found.get(name)) for name, path in sorted(asked.items()))
    return Scores(tuple(shown(scored, len(asked), "scored")), settings, tuple(remarks))


def _inputs(folder: Path | None, names: Iterable[str]) -> dict[str, Path]:
    """The input of every garment; empty without a folder. Raises ``SpecError`` for a garment without one."""
    if folder is None:
        return {}
    files = input_files(folder)
    if missing := sorted(set(names) - files.keys()):
        raise SpecError(f"{folder}: no input for {missing[0]} ({len(missing)} in all): add {missing[0]}.ply")
    return {name: files[name] for name in names}


def _bodies_hash(named: str) -> str:
    path = Path(named)
    if not path.exists():
        return hashlib.sha256(named.encode()).hexdigest()
    return _hash_of({str(file.relative_to(path)): file for file in (path.rglob("*") if path.is_dir() else [path])})


def _hash_of(files: Mapping[str, Path]) -> str:
    """SHA-256 of names and contents."""
    found = hashlib.sha256()
    for name, path in sorted(files.items()):
        if path.is_file():
            with path.open("rb") as file:
                content = hashlib.file_digest(file, "sha256").hexdigest()
            found.update(f"{name}\n{content}\n".encode())
    return found.hexdigest()
