"""A run around the training loop: its garments, examples and checks, its answers, scores and files.

``--out`` receives ``predictions/KEY.json`` and ``truth/KEY.json``, specification files that ``gcd score`` reads too
(answers that are no patterns: ``predictions/KEY.npz``); ``scores.csv``, a row for each test garment; ``report.json``
with mean scores, 95 % intervals, options and hashes of the data; ``curves.csv``; ``pictures/`` with answers beside
truth; ``weights.pt``; ``card.toml``, the model's card for ``gcd bench submit``; and ``evaluation.json`` with the scores
of drapes (``--drape``), beside the points that the answers were told from (T1), or the draped true patterns.
"""

import csv
import hashlib
import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from benchmarks.reconstruction.garments import GarmentSet, Split, fresh_garments
from benchmarks.reconstruction.judging import intervals, judge_of, means_of
from benchmarks.reconstruction.learners import Examples, FreshPool, Learner, TensorExamples
from benchmarks.reconstruction.options import OF_WEIGHTS, Config
from benchmarks.reconstruction.processes import first_rank_first, of_all_ranks, rank, ranks
from benchmarks.reconstruction.tasks import CHECKED, FRESH_SEED, GENERATED, TASKS, ReconstructionTask
from benchmarks.reconstruction.weights import WEIGHTS
from gcd_dataset.errors import ConfigError
from gcd_dataset.files import drafted, make_folder, write_whole
from gcd_dataset.generator.device import cores
from gcd_dataset.generator.drawing import png_bytes
from gcd_dataset.patternhash import PatternHash
from gcd_dataset.scoring.board import result_text
from gcd_dataset.scoring.folders import Drapes, score
from gcd_dataset.scoring.table import DRAPED

Check = Callable[[int, Learner[Any, Any]], Mapping[str, float]]
"""Called on the way with the step and the averaged learner. Its figures become columns of the curves; with ``BETTER``
among them, the weights of its highest value answer in the end."""
BETTER = "better"
CURVES, REPORT, SCORES, EVALUATION = "curves.csv", "report.json", "scores.csv", "evaluation.json"
CARD = "card.toml"
OF_GARMENTS = ("predictions", "subdivided", "truth", "inputs", "bodies")
"""Folders of the files of test garments."""
SKIRTS: Mapping[str, Any] = {"meta": {"upper": "none", "bottom": {"options": ["SkirtCircle", "Skirt2"]}}}
"""Design of the garments of smoke runs: all of one kind."""


@dataclass(frozen=True)
class Trained:
    """The end of a training."""

    learner: Learner[Any, Any]
    """The learner with averaged weights, in evaluation mode."""
    steps: int
    seconds: float
    """Time of the steps."""
    curve: list[dict[str, float]]
    """Rows of the curves: step, seconds, learning rate, mean loss and its terms since the row before, checks."""


# ------------------------------------------------------------------------------------------------------- the garments


def require_usable(config: Config, task: ReconstructionTask, model: Any, learner: Learner[Any, Any] | None) -> None:
    """Raise ``ConfigError`` for options that do not go together; a model without ``TASKS`` answers patterns."""
    known = getattr(model, "TASKS", tuple(each.name for each in TASKS.values() if each.answers_patterns))
    if task.name not in known:
        raise ConfigError(f"{config.model} does not answer {task.name}: give --task {', '.join(known)}")
    if config.source and config.resolution:
        raise ConfigError(f"--resolution {config.resolution:g}: the garments of --source are made: leave it out")
    if config.drape and not (task.answers_patterns and "pose" in task.extra):
        raise ConfigError(f"{task.name} has no patterns or no bodies to drape: leave out --drape")
    if learner is None and (config.sizes or config.fresh or config.weights):
        raise ConfigError(f"{config.model} has no network and no training: leave out --set, --fresh and --weights")
    if config.fresh and learner is not None and (learner.encoder() is None or config.source or config.leave_out):
        raise ConfigError("--fresh: needs a model that encodes garments, no --source, and no --leave-out")


def load_split(config: Config, task: ReconstructionTask) -> Split:
    """The garments, of the training set this rank's share; the first rank makes them, the others read its cache."""
    share: dict[str, Any] = {"share": (rank(), ranks()), "tested": config.test, "seed": config.train_seed}
    with first_rank_first():
        workers = max(1, cores() - 1) if config.workers < 0 else config.workers
        data = Path(config.data) if config.data else Path(config.out).parent / "garments"
        make: dict[str, Any] = {"data": data, "workers": workers, **_recipe(config, task)}
        sources: dict[str, Any] = {"source": config.source, "test_source": config.test_source}
        split = task.load(config.train, **sources, checked=config.validate if config.source else 0, **share, **make)
        if config.validate and not config.source:
            split = replace(split, check=task.validation(config.validate, **make))
    if config.drape and "pose" not in split.test.ragged:
        raise ConfigError(f"{config.test_source or config.source}: no bodies to drape on: leave out --drape")
    return split.without(config.leave_out) if config.leave_out else split


def _recipe(config: Config, task: ReconstructionTask) -> dict[str, Any]:
    """Changes of the task's recipe, and the device of its drapes."""
    drapes = {"device": config.make_device} if task.stage == "drape" else {}
    resolution = {"resolution": config.resolution} if config.resolution else {}
    return {**drapes, **resolution, **({"design": SKIRTS} if config.smoke else {})}


def workers_of(config: Config) -> int:
    """Processes of this rank."""
    return max(1, cores() // ranks() - 1) if config.workers < 0 else config.workers


def examples_of(
    learner: Learner[Any, Any], split: Split, config: Config, task: ReconstructionTask, device: torch.device
) -> Examples[Any]:
    """The examples of the training set, renewed by fresh garments if asked for."""
    workers = workers_of(config)
    examples = learner.prepare(split.train, device=device, workers=workers)
    if not config.fresh:
        return examples
    encode = learner.encoder()
    assert encode is not None  # ``require_usable``
    make = {"points": task.points, "extra": task.extra, "workers": workers, **task.options, **_recipe(config, task)}

    def stream(first: int) -> Iterator[tuple[int, TensorExamples]]:
        return fresh_garments(encode, FRESH_SEED + rank(), first=first, **make)

    return FreshPool(learner, encode(split.train).to(device), stream, room=config.fresh // ranks())


@dataclass(frozen=True)
class Watch:
    """Losses and scores of garments outside the training, and a picture of the first of them."""

    garments: GarmentSet
    examples: Examples[Any]
    config: Config
    task: ReconstructionTask

    def __call__(self, step: int, learner: Learner[Any, Any]) -> Mapping[str, float]:
        """Columns ``check_…`` of the curves; with ``validate``, the headline as ``BETTER``."""
        judge, workers = judge_of(self.task, watching=True), workers_of(self.config)
        count, size = len(self.garments), max(self.config.batch, CHECKED)
        terms: dict[str, float] = {}
        for rows in torch.split(torch.arange(count), size):
            with torch.no_grad():
                losses: Mapping[str, Tensor] = learner.loss(self.examples.batch(rows))
            for name, loss in losses.items():
                terms[f"check_loss_{name}"] = terms.get(f"check_loss_{name}", 0.0) + float(loss) * len(rows) / count
        answers = list(learner.answers(self.examples, count, batch=size, workers=workers))
        picture = make_folder(Path(self.config.out) / "pictures") / f"step_{step:06d}.png"
        write_whole(picture, png_bytes(judge.picture(answers, self.garments)))
        means = means_of(judge.scores(answers, self.garments, workers=workers))
        headline = -means[self.task.headline] if self.task.lower_is_better else means[self.task.headline]
        best = {BETTER: headline} if self.config.validate else {}
        return {"check_loss": sum(terms.values()), **terms, **{f"check_{n}": v for n, v in means.items()}, **best}


def show(rows: Sequence[Mapping[str, float]], out: Path | None) -> None:
    """Print the last row of the curves and write all, on the first rank."""
    if out is None or rank():
        return
    print(" ".join(f"{name} {value:.4g}" for name, value in rows[-1].items()), file=sys.stderr, flush=True)
    names = list(dict.fromkeys(name for row in rows for name in row))
    with drafted(out / CURVES) as draft, draft.open("w", newline="") as file:
        writer = csv.DictWriter(file, names, restval="")
        writer.writeheader()
        writer.writerows(rows)


# --------------------------------------------------------------------------------------------------------- the answers


def kept_report(config: Config) -> dict[str, Any] | None:
    """The report in the folder, if any. Raises ``ConfigError`` for one of other options."""
    path = config.results / REPORT
    if not path.exists():
        return None
    try:
        found: dict[str, Any] = json.loads(path.read_text())
        theirs = found["options"]
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path}: no report of a run ({error!s:.99}): delete it") from error
    for name in (*OF_WEIGHTS, "test", "validate", "test_source"):
        if theirs.get(name) != getattr(config, name):
            given = f"of a run with {name} {theirs.get(name)}, not {getattr(config, name)}"
            raise ConfigError(f"{path}: {given}: give another folder, or delete it")
    print(f"{path} is of this run: delete it to answer again", file=sys.stderr)
    return found


def answered(
    config: Config,
    task: ReconstructionTask,
    model: Any,
    split: Split,
    trained: Trained | None,
    device: torch.device,
    times: Mapping[str, float],
) -> dict[str, Any]:
    """Answer for the test garments, score, write the results; the report. Other ranks only count their garments."""
    data = {"train": _described(split.train)}
    if rank():
        return {}
    begun, workers, test, out = time.perf_counter(), workers_of(config), split.test, make_folder(config.results)

    def answers_for(garments: GarmentSet) -> list[Any]:
        if trained is None:
            return list(model.answers(split.train, garments, device=device, workers=workers))
        examples = trained.learner.prepare(garments, device=device, workers=workers)
        return list(trained.learner.answers(examples, len(garments), batch=config.batch, workers=workers))

    answers = answers_for(test)
    scores = judge_of(task).scores(answers, test, workers=workers)
    validated = {}
    if config.validate:
        chosen = judge_of(task).scores(answers_for(split.check), split.check, workers=workers)
        validated = {"validation": {"count": len(split.check), "scores": intervals(chosen)}}
    _write(out, task, test, answers, scores)
    kinds = {kind: [s for s, k in zip(scores, test.kinds, strict=True) if k == kind] for kind in sorted({*test.kinds})}
    report = {
        "model": config.model,
        "task": task.name,
        "tested_on": config.test_source or config.source or GENERATED,
        "headline": task.headline,
        "scores": intervals(scores),
        **validated,
        "scores_of_kinds": {kind: means_of(own) for kind, own in kinds.items()},
        "data": {**data, "test": {"count": len(test), "patterns": test.patterns_hash, "ids": test.ids_hash,
                                  "recipe": test.recipe}},
        "options": asdict(config),
        "ranks": ranks(),
        "device": torch.cuda.get_device_name() if device.type == "cuda" else "cpu",
        "steps": trained.steps if trained else 0,
        "minutes": trained.seconds / 60 if trained else 0.0,
        "train_s": trained.seconds if trained else 0.0,
        "parameters": sum(p.numel() for p in trained.learner.parameters()) if trained else 0,
        "first_loss": trained.curve[0]["loss"] if trained and trained.curve else None,
        "last_loss": trained.curve[-1]["loss"] if trained and trained.curve else None,
        **({"weights_sha256": hashlib.sha256(Path(config.out, WEIGHTS).read_bytes()).hexdigest()} if trained else {}),
        **{name: round(value, 2) for name, value in times.items()},
        **(trained.learner.tables(split, config, out, workers=workers) if trained else {}),
    }  # fmt: skip
    report["test_s"] = round(time.perf_counter() - begun, 2)
    write_whole(out / REPORT, json.dumps(report, indent=1).encode())
    write_whole(out / CARD, _card(report, config).encode())
    return report


def _card(report: Mapping[str, Any], config: Config) -> str:
    """The card of a result file, in TOML; trainings that differ in their seed alone have the same."""
    entries = {
        "name": " ".join([Path(config.model).stem, *(f"{name}={size}" for name, size in config.sizes.items())]),
        "garments": report["data"]["train"]["count"] + report["fresh"],
        "minutes": (config.minutes or round(report["minutes"], 1)) * bool(report["steps"]),
        "weights": report["parameters"],
        "hardware": f"{report['ranks']} × {report['device']}",
        "baseline": not report["parameters"],
    }
    return "".join(f"{name} = {json.dumps(value, ensure_ascii=False)}\n" for name, value in entries.items())


def _described(garments: GarmentSet) -> dict[str, Any]:
    """Number, hashes and recipe of the garments of all ranks, which hold every so manieth of a set."""
    told: Any = of_all_ranks((garments.keys, garments.pattern_hash(rank(), ranks())))
    keys = [key for row in zip_longest(*(own for own, _ in told)) for key in row if key is not None]
    whole = sum((own for _, own in told), start=PatternHash())
    ids = hashlib.sha256("\n".join(keys).encode()).hexdigest()
    return {"count": len(keys), "patterns": whole.text, "ids": ids, "recipe": garments.recipe}


def _write(
    out: Path, task: ReconstructionTask, test: GarmentSet, answers: Sequence[Any], scores: Sequence[Any]
) -> None:
    for folder in OF_GARMENTS:  # answers of an earlier run would be scored as answers of this one
        for old in (out / folder).glob("*_?????????.*"):
            old.unlink()
    (out / EVALUATION).unlink(missing_ok=True)
    with drafted(out / SCORES) as draft, draft.open("w", newline="") as file:
        writer = csv.DictWriter(file, ["key", "kind", *asdict(scores[0])])
        writer.writeheader()
        for key, kind, score in zip(test.keys, test.kinds, scores, strict=True):
            writer.writerow({"key": key, "kind": kind, **asdict(score)})
    judge = judge_of(task)
    judge.write(answers, test, out)
    write_whole(make_folder(out / "pictures") / "test.png", png_bytes(judge.picture(answers, test)))


def draped(report: dict[str, Any], config: Config, task: ReconstructionTask) -> dict[str, Any]:
    """The report with the scores of the draped answers, which ``evaluation.json`` holds for each garment."""
    if all(name in report["scores"] for name in DRAPED):
        return report
    out, tested = config.results, config.test_source if config.test_source in TASKS else task.name
    inputs = out / "inputs" if tested in ("T1", "T1-scan") and task.stage == "drape" else None  # T0 writes none
    device, spacing = "auto" if config.device == "cuda" else config.device, float(task.options["resolution"])
    drapes = Drapes(inputs, inputs is not None and tested == "T1-scan", config.resolution or spacing, device)
    workers, bodies = max(1, workers_of(config)), str(out / "bodies")
    found = score(out / "predictions", out / "truth", bodies=bodies, drapes=drapes, workers=workers).tree()
    write_whole(out / EVALUATION, result_text(found).encode())
    kinds = {
        kind: {**means, **{name: found["by_kind"][kind][name]["mean"] for name in DRAPED}}
        for kind, means in report["scores_of_kinds"].items()
    }
    figures = {name: [found["figures"][name][part] for part in ("mean", "low", "high")] for name in DRAPED}
    report = {**report, "scores": {**report["scores"], **figures}, "scores_of_kinds": kinds}
    write_whole(out / REPORT, json.dumps(report, indent=1).encode())
    return report
