"""The scoreboard: result files, each the scores of one model on a task's frozen test set, and the tables of them.

A model card is a TOML file::

    name = "panel_set"
    garments = 24000           # trained on
    minutes = 8.0              # of training, on all devices together
    weights = 14500000
    hardware = "one H200"
    url = "https://…"          # optional
    note = "…"                 # optional
    baseline = false           # true: a method of others below its published size or budget; not ranked
"""

import json
import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gcd_dataset.errors import ConfigError, SpecError
from gcd_dataset.jsonfile import JsonPath, read_json, read_toml
from gcd_dataset.metrics import bootstrap_means
from gcd_dataset.scoring.folders import Scores
from gcd_dataset.scoring.inputs import TASKS
from gcd_dataset.scoring.table import OF_ARRAYS

SCHEMA = 1
ROUNDING = 1e-4  # of means and scores in a result file
DEVICES = ("CPU", "GPU", "")  # that drape inputs and answers; empty without drapes
CARD: Mapping[str, type] = {"name": str, "garments": int, "minutes": float, "weights": int, "hardware": str}
MORE: Mapping[str, type] = {"url": str, "note": str, "baseline": bool}
WORDS: Mapping[type, str] = {str: "a text", int: "a whole number", float: "a number", bool: "true or false"}
HEADLINES = {
    "T3": "stitch_nm_perfect", "T3-subdivided": "garment_perfect", "T4": "panel_label", "T5": "error_cm",
    "T6": "error_cm", "T8": "error_cm",
}  # fmt: skip
"""The score that ranks a task's answers; of the other tasks ``STRICT``, or ``COMBINATORIAL`` without drapes."""
STRICT, COMBINATORIAL = "strict_within_1cm", "combinatorial"
COLUMNS = (
    "strict_within_1cm", "strict_unaided", "edges_within_1cm", "combinatorial", "garment_perfect", "iou",
    "stitch_f1", "stitch_nm_perfect", "stitch_nm_f1", "redrape_cd_cm",
    *OF_ARRAYS,
)  # fmt: skip


def result_of(scores: Scores, card: Path) -> dict[str, Any]:
    """The result file of a model's scores on a task, with its card.

    Raises ``SpecError`` for scores of other garments than a task's, ``ConfigError`` for a card with a missing, unknown
    or impossible entry.
    """
    if "task" not in scores.settings:
        raise SpecError("scores of other garments than a task's: give the folder that gcd bench inputs wrote")
    return {"schema": SCHEMA, "model": read_card(card), **scores.tree()}


def read_card(path: Path) -> dict[str, Any]:
    """A model card. Raises ``ConfigError``."""
    card = dict(read_toml(path))
    _require_card(card, path)
    return card


def tables(paths: Sequence[Path]) -> str:
    """Markdown tables of result files, one for each task, size of the test set and kinds of the devices that draped.

    Models of one table are ranked among those with equal garments, minutes and hardware; baselines stand below. Results
    with equal cards are trainings with several seeds, and one row. ``behind`` is the mean difference of the headline
    from the first row, paired by garment. Raises ``SpecError`` for a file that is no result, and for results on
    different test sets in one table.
    """
    groups = defaultdict[tuple[str, bool, str], list[tuple[Path, dict[str, Any]]]](list)
    for path in paths:
        result = _read_result(path)
        settings = result["settings"]
        draped = {"inputs draped on a": settings["device"], "answers on a": settings.get("draped_on")}
        devices = ", ".join(f"{what} {device}" for what, device in draped.items() if device)
        groups[settings["task"], settings["mini"], devices].append((path, result))
    return "\n".join(line for key, results in sorted(groups.items()) for line in _table(*key, results))


def _require_card(card: Mapping[str, Any], path: Path) -> None:
    """Raise ``ConfigError`` for a card with a missing, unknown or impossible entry."""
    if missing := [key for key in CARD if key not in card]:
        raise ConfigError(f"{path}: no {', '.join(missing)}: a model card has {', '.join(CARD)}")
    for key, value in card.items():
        kind = CARD.get(key, MORE.get(key))
        if kind is None:
            raise ConfigError(f"{path}: {key} is unknown: a model card has {', '.join((*CARD, *MORE))}")
        right = isinstance(value, kind) or (kind is float and isinstance(value, int))
        if not right or isinstance(value, bool) != (kind is bool):
            raise ConfigError(f"{path}: {key} is {value!r}: give {WORDS[kind]}")
        if kind in (int, float) and not 0 <= value < math.inf:
            raise ConfigError(f"{path}: {key} is {value}: give a number of 0 or more")


def _read_result(path: Path) -> dict[str, Any]:
    found, at = read_json(path, "result file"), JsonPath(str(path))
    if not isinstance(found, dict) or found.get("schema") != SCHEMA:
        raise SpecError(f"{path}: no result file of schema {SCHEMA}: make it with gcd bench submit")
    model, settings, figures = (at.mapping(found.get(part), part) for part in ("model", "settings", "figures"))
    _require_card(model, path)
    at.text(at.mapping(settings.get("hashes"), "hashes").get("truth"), "hash of the truth")
    devices = (settings.get("device"), settings.get("draped_on", ""))
    if settings.get("task") not in list(TASKS) or any(device not in DEVICES for device in devices):
        raise SpecError(f"{path}: its settings name no task and device: make it with gcd bench submit")
    for name, figure in figures.items():
        for part in ("mean", "low", "high"):
            at.number(at.mapping(figure, name).get(part), f"{part} of {name}")
    garments = at.list_of(found, "garments")
    for row in garments:
        at.text(at.mapping(row, "a garment").get("name"), "name of a garment")
    for name in figures.keys() & {*HEADLINES.values(), STRICT, COMBINATORIAL}:
        values = [at.number(row.get(name), f"{name} of garment {row['name']}") for row in garments]
        if not garments or abs(np.mean(values) - figures[name]["mean"]) > ROUNDING:
            raise SpecError(f"{path}: the mean of {name} is not that of its garments: make it with gcd bench submit")
    return {**found, "settings": {**settings, "mini": bool(settings.get("mini"))}}


def _table(task: str, mini: bool, devices: str, results: Sequence[tuple[Path, dict[str, Any]]]) -> Iterable[str]:
    first = results[0]
    for path, result in results:
        if result["settings"]["hashes"]["truth"] != first[1]["settings"]["hashes"]["truth"]:
            raise SpecError(f"{path}: other true patterns than {first[0]}: make both again with this version")
    columns = [name for name in COLUMNS if any(name in result["figures"] for _, result in results)]
    headline = HEADLINES.get(task, STRICT if STRICT in columns else COMBINATORIAL)
    columns.sort(key=lambda name: name != headline)
    models = defaultdict[str, list[dict[str, Any]]](list)
    for _, result in results:
        card = {"baseline": False, **result["model"], "minutes": float(result["model"]["minutes"])}
        own = models[json.dumps(card, sort_keys=True)]
        own += [result] if result not in own else []

    def order(row: Mapping[str, Any]) -> tuple[bool, float]:
        mean = row["figures"][headline]["mean"] if headline in row["figures"] else math.inf
        return bool(row["model"].get("baseline")), mean if headline.startswith("error") or mean == math.inf else -mean

    rows = sorted((_pooled(seeds, columns, headline) for seeds in models.values()), key=order)
    count = len(first[1]["garments"])
    yield f"## {task}: {count} garments{' (mini)' if mini else ''}{f', {devices}' if devices else ''}"
    yield ""
    yield f"| rank | model | {' | '.join(columns)} | behind | garments | minutes | weights | hardware | seeds |"
    yield f"|{'---|' * (len(columns) + 8)}"
    ranks = defaultdict[tuple[Any, ...], int](int)
    for row in rows:
        model, figures = row["model"], row["figures"]
        budget = (model["garments"], model["minutes"], model["hardware"])
        ranks[budget] += not model.get("baseline")
        rank = "–" if model.get("baseline") else f"{ranks[budget]}"
        found = [figures.get(name) for name in columns]
        cells = [f"{one['mean']:.3f} [{one['low']:.3f}, {one['high']:.3f}]" if one else "" for one in found]
        cells.append(_behind(rows[0]["garments"], row["garments"]))
        facts = [f"{model['garments']:,}", f"{model['minutes']:g}", f"{model['weights']:,}"]
        facts += [_plain(model["hardware"]), str(row["seeds"])]
        yield f"| {' | '.join([rank, _named(model), *cells, *facts])} |"
    yield ""
    yield f"Ranked by `{headline}` among models with equal garments, minutes and hardware; in brackets: 95 % intervals,"
    yield "or the lowest and the highest mean of several seeds. `behind`: difference from the first row, by garment."
    yield ""


def _pooled(seeds: Sequence[Mapping[str, Any]], columns: Sequence[str], headline: str) -> dict[str, Any]:
    """The row of a model: figures that all its seeds have, and the headline of each garment, if these have it."""
    shared = [name for name in columns if all(name in result["figures"] for result in seeds)]
    figures = {name: seeds[0]["figures"][name] for name in shared}
    if len(seeds) > 1:
        means = {name: [result["figures"][name]["mean"] for result in seeds] for name in shared}
        figures = {name: {"mean": np.mean(m), "low": min(m), "high": max(m)} for name, m in means.items()}
    found = defaultdict[str, list[float]](list)
    for result in seeds if headline in shared else ():
        for garment in result["garments"]:
            found[garment["name"]].append(garment[headline])
    garments = {name: float(np.mean(values)) for name, values in found.items()}
    return {"model": seeds[0]["model"], "figures": figures, "garments": garments, "seeds": len(seeds)}


def _behind(best: Mapping[str, float], own: Mapping[str, float]) -> str:
    """The mean difference with its interval over the garments; empty for the best itself, and without scores."""
    if best == own or best.keys() != own.keys():
        return ""
    apart = np.array([[own[garment] - best[garment]] for garment in best])
    low, high = bootstrap_means(apart, np.random.default_rng(0))
    return f"{apart.mean():+.3f} [{low[0]:+.3f}, {high[0]:+.3f}]"


def _named(model: Mapping[str, Any]) -> str:
    name = _plain(model["name"])
    return f"[{name}]({_plain(model['url'])})" if model.get("url") else name


def _plain(text: str) -> str:
    """Text of a stranger in a cell of a Markdown table."""
    return "".join(char for char in text if char.isprintable() and char not in "|[]()<>`\\")


def result_text(result: Mapping[str, Any]) -> str:
    """A result as JSON, with null for numbers that JSON lacks."""

    def finite(tree: Any) -> Any:
        if isinstance(tree, Mapping):
            return {key: finite(value) for key, value in tree.items()}
        if isinstance(tree, list):
            return [finite(value) for value in tree]
        return (round(tree, 6) if math.isfinite(tree) else None) if isinstance(tree, float) else tree

    return json.dumps(finite(result), indent=1, allow_nan=False) + "\n"
