"""The options of a training: a dataclass whose fields are the options of the command."""

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from benchmarks.reconstruction.models import load_model
from gcd_dataset.errors import ConfigError

MINUTES = 8.0  # of a training without --steps
SMOKE: Mapping[str, Any] = {"train": 16, "test": 8, "resolution": 4.0, "workers": 0}
"""Options of the smallest run."""
OF_WEIGHTS = (
    "model", "task", "train", "train_seed", "source", "leave_out", "fresh", "resolution", "sizes", "weights", "smoke",
    "steps", "minutes", "batch", "lr", "warm_up", "weight_decay", "ema", "seed",
)  # fmt: skip
"""Options that the weights of a training depend on."""


def option(default: Any, text: str) -> Any:
    """A field of ``Config``, and an option of the command."""
    return field(default=default, metadata={"help": text})


@dataclass(frozen=True)
class Config:
    """Options of a training. Raises ``ConfigError`` for numbers out of range."""

    model: str = option("panel_set", "a model of benchmarks/reconstruction/models, or path/to/file.py:build")
    task: str = option("T0", "a task of benchmarks/reconstruction/tasks.py")
    out: str = option("out", "folder of the results; a repeated call goes on there")
    train: int = option(4000, "garments to train on")
    train_seed: int = option(0, "seed of these: another one gives --weights garments that they were not trained on")
    test: int = option(0, "garments to test on; 0: as many as the task names")
    validate: int = option(0, "most garments of each part of the validation set, which chooses the weights and the "
                           "record; 500: all; 0: the last weights answer, and 32 garments are watched")  # fmt: skip
    data: str = option("", "folder that keeps generated garments; empty: garments beside --out")
    source: str = option("", "folder, URL or Hub repository of garments to use instead of generated ones")
    test_source: str = option("", "another source of the garments to test on: a folder as for --source, a task such as "
                              "T1-scan, or generated; its results lie in a folder of --out")  # fmt: skip
    leave_out: str = option("", "kind of garment to test on, and not to train on: dress, skirt, …")
    fresh: int = option(0, "room for the garments of --train and those made in the training; 0: none are made")
    make_device: str = option("auto", "device that drapes garments, such as cuda:3 beside a training on the others")
    make_only: bool = option(default=False, text="make the garments of --data, then stop")
    resolution: float = option(0.0, "edge length of generated meshes and of drapes [cm]; 0: the task's own")
    workers: int = option(-1, "processes that make, encode and score; -1: all cores but one, shared by the ranks")
    drape: bool = option(default=False, text="also score drapes of the answers; a finished run is only draped")
    sizes: Mapping[str, float] = field(
        default_factory=dict, metadata={"help": "sizes of the network, such as width=256"}
    )
    weights: str = option(
        "", "weights.pt to begin from, with the moments beside it; or several, with commas: their mean"
    )
    smoke: bool = option(default=False, text="few coarse garments and a tiny network, for two cores")
    steps: int = option(0, "optimiser steps; 0: as many as --minutes allows; with --weights none, these are tested")
    minutes: float = option(0.0, f"time of the steps alone; {MINUTES:g} without --steps")
    batch: int = option(256, "garments of a step, of all ranks together")
    lr: float = option(5e-4, "highest learning rate: linear warm-up, then half a cosine")
    warm_up: float = option(0.05, "share of the training in which the learning rate rises")
    weight_decay: float = option(0.05, "weight decay, of matrices only")
    ema: float = option(0.999, "decay of the average of the weights, which answers; lower in the first steps")
    checks: int = option(4, "times at which garments outside the training are answered and scored")
    log_every: int = option(50, "steps of a row of the curves")
    seed: int = option(0, "seed of weights and order")
    device: str = option("auto", "auto, cpu or cuda")
    compile: bool = option(default=False, text="compile the network, and record a step of a model that allows it")

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            low = -1 if name == "workers" else 0
            if isinstance(value, int | float) and not low <= value < math.inf:
                raise ConfigError(f"--{name.replace('_', '-')} {value}: give {low} or more")
        if bool(self.steps) == bool(self.minutes) and (self.steps or not self.weights):
            raise ConfigError(f"--steps {self.steps} --minutes {self.minutes:g}: give one of them, above 0")
        if not (self.lr and self.batch and self.log_every) or max(self.ema, self.warm_up) >= 1:
            given = f"--lr {self.lr:g} --batch {self.batch} --log-every {self.log_every}"
            below = f"--ema {self.ema:g} --warm-up {self.warm_up:g}"
            raise ConfigError(f"{given} {below}: give the first three above 0, the others below 1")
        if self.fresh and self.fresh < self.train:
            raise ConfigError(f"--fresh {self.fresh}: give room for the {self.train} garments of --train, and more")

    @property
    def results(self) -> Path:
        """The folder of the answers and their scores: a test source has its own, beside the weights that it tests."""
        return Path(self.out) / f"on-{Path(self.test_source).name}" if self.test_source else Path(self.out)

    @property
    def identity(self) -> dict[str, Any]:
        """The options that a training that goes on must share, with the numbers that are split off a source."""
        split_off = ("test", "validate") if self.source else ()
        return {name: getattr(self, name) for name in (*OF_WEIGHTS, *split_off)}


def parsed(arguments: Sequence[str] | None) -> Config:
    """The options given; for others the usual ones of the model (``USUAL``, ``SMOKE``), then those of ``Config``."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="train", description=__doc__, formatter_class=formatter, allow_abbrev=False)
    for each in fields(Config):
        text, flag = each.metadata["help"], f"--{each.name.replace('_', '-')}"
        if each.name == "sizes":
            parser.add_argument("--set", nargs="*", dest="sizes", metavar="NAME=NUMBER", help=text)
        elif isinstance(each.default, bool):
            parser.add_argument(flag, action="store_true", default=None, help=text)
        else:
            parser.add_argument(flag, type=type(each.default), help=f"{text} ({each.default})")
    given = {name: value for name, value in vars(parser.parse_args(arguments)).items() if value is not None}
    module, smoke = load_model(given.get("model", Config.model)), given.get("smoke", False)
    usual = {**(SMOKE if smoke else {}), **getattr(module, "SMOKE" if smoke else "USUAL", {})}
    if given.get("steps") or given.get("minutes"):
        usual = {name: value for name, value in usual.items() if name not in ("steps", "minutes")}
    if given.get("source"):
        usual.pop("resolution", None)
    chosen = {**({} if {**usual, **given}.keys() & {"steps", "minutes"} else {"minutes": MINUTES}), **usual, **given}
    sizes = {**(getattr(module, "SMALL", {}) if smoke else {}), **_numbers(given.get("sizes", []))}
    return Config(**{**chosen, "sizes": sizes})


def _numbers(texts: Sequence[str]) -> dict[str, float]:
    try:
        pairs = [text.split("=") for text in texts]
        return {name: int(value) if value.lstrip("-").isdigit() else float(value) for name, value in pairs}
    except ValueError as error:
        raise ConfigError(f"--set {' '.join(texts)}: give NAME=NUMBER, such as width=256") from error
