"""``Planned`` and ``read_plan``: the runs of a plan, each a call of ``train`` or ``stitching.run``.

A plan is a TOML file with a table for each group of runs; ``campaign`` tells its keys and starts the runs.
"""

import argparse
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any, NoReturn

from benchmarks.reconstruction.models import load_model
from benchmarks.reconstruction.stitching import run as stitching
from benchmarks.reconstruction.tasks import task_named
from benchmarks.reconstruction.train import MINUTES, SMOKE, add_arguments, options_from, require_usable
from gcd_dataset.errors import ConfigError

PROGRAMS = {"train": "benchmarks.reconstruction.train", "stitching.run": "benchmarks.reconstruction.stitching.run"}
OWN = ("program", "model", "spare", "expected")
"""Keys of a plan that are no options of the program."""
SPARE = EXPECTED = 1.0  # minutes


@dataclass(frozen=True)
class Planned:
    """A run of a plan."""

    name: str
    program: str
    """Key of ``PROGRAMS``."""
    model: str
    """First argument of ``train``; empty for ``stitching.run``."""
    options: Mapping[str, Any] = field(default_factory=dict)
    spare: float = SPARE
    """Minutes to load and to score, without drapes."""
    expected: float = EXPECTED
    """Minutes that the steps of a training are expected to take, if it is not given a time."""

    @property
    def command(self) -> list[str]:
        """The command without the options that the campaign adds."""
        return ["python", "-m", PROGRAMS[self.program], *([self.model] if self.model else []), *_flags(self.options)]

    @property
    def drapes(self) -> bool:
        """Whether its answers are draped."""
        return bool(self.options.get("drape"))

    @property
    def has_draped_garments(self) -> bool:
        """Whether the garments that it learns from and is tested on are draped."""
        return task_named(self.task).stage == "drape"

    @property
    def training(self) -> list[str]:
        """The command without ``--drape``."""
        return replace(self, options={key: value for key, value in self.options.items() if key != "drape"}).command

    @property
    def minutes(self) -> float:
        """Time of the training."""
        if self.options.get("smoke") or self.options.get("steps"):
            return self.expected
        if self.options.get("minutes"):
            return float(self.options["minutes"])
        return stitching.MINUTES if self.program == "stitching.run" else MINUTES * _is_network(self.model)

    @property
    def task(self) -> str:
        """Name of the task."""
        return str(self.options.get("task", "T3" if self.program == "stitching.run" else "T0"))

    @property
    def train(self) -> int:
        """Garments to train on."""
        given = int(self.options.get("train", 0))
        if not self.options.get("smoke"):
            return given
        return given or int(stitching.SMOKE["train"] if self.program == "stitching.run" else SMOKE["train"])

    @property
    def garments(self) -> str:
        """Equal for runs whose garments share a file of ``--data``; a larger set holds the smaller ones."""
        task = task_named(self.task)
        names = ("source", "resolution", "test") + (("smoke",) if self.program == "train" else ())
        return repr((dict(task.options), task.points, task.extra, [self.options.get(name) for name in names]))


def read_plan(path: Path) -> list[Planned]:
    """The runs of a plan, in its order. Raises ``ConfigError`` for an unusable one."""
    try:
        groups = tomllib.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: {error}: give a TOML file of runs") from error
    runs = [run for name, group in groups.items() for run in _runs(path, name, group)]
    names = [run.name for run in runs]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice or not runs:
        raise ConfigError(
            f"{path}: {'no runs' if not runs else f'two runs {twice[0]}'}: give runs with different names"
        )
    return runs


def _runs(path: Path, name: str, group: Any) -> list[Planned]:
    if not isinstance(group, dict):
        raise ConfigError(f"{path}: {name} is no table: give [{name}] with the options of its runs")
    lists = {key: value for key, value in group.items() if isinstance(value, list) and key != "set"}
    if not all(lists.values()):
        raise ConfigError(f"{path}: [{name}] has an empty list: give at least one value")
    found = []
    for values in product(*lists.values()):
        chosen = {**group, **dict(zip(lists, values, strict=True))}
        program = chosen.get("program", "train")
        if program not in PROGRAMS:
            raise ConfigError(f"{path}: [{name}] program {program!r}: give one of {', '.join(PROGRAMS)}")
        if program == "train" and "model" not in chosen:
            raise ConfigError(f"{path}: [{name}] has no model: give model = …")
        options = {key: value for key, value in chosen.items() if key not in OWN}
        for key in ("train", "steps", "minutes", "spare", "expected"):
            value = chosen.get(key, 0)
            if not isinstance(value, int | float) or not 0 <= value < float("inf"):
                raise ConfigError(f"{path}: [{name}] {key} = {value!r:.99}: give a number, 0 or more")
        title = "-".join([name, *(str(value) for value in values)])
        if "/" in title or not title.isprintable() or title in (".", ".."):
            raise ConfigError(f"{path}: {title!r:.99} is no name for a folder: rename [{name}]")
        times = float(chosen.get("spare", SPARE)), float(chosen.get("expected", EXPECTED))
        run = Planned(title, program, str(chosen.get("model", "")), options, *times)
        try:
            _require_usable(run)
        except ConfigError as error:
            raise ConfigError(f"{path}: [{name}] {error}") from error
        found.append(run)
    return found


class _Parser(argparse.ArgumentParser):
    """Raises ``ConfigError`` where others leave the program."""

    def error(self, message: str) -> NoReturn:
        raise ConfigError(message)


def _require_usable(run: Planned) -> None:
    """Raise ``ConfigError`` for options that the program would refuse on any machine."""
    parser = _Parser(allow_abbrev=False)
    given = [*run.command[3:], "--out", "out", "--device", "cpu"]
    if run.program == "stitching.run":
        stitching.add_arguments(parser)
        stitching.configs_from(stitching.parsed(parser, given))
    else:
        add_arguments(parser)
        require_usable(options_from(parser.parse_args(given[1:]), run.model))


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


def _is_network(model: str) -> bool:
    return hasattr(load_model(model), "build")
