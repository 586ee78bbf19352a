"""Train a model on a task: one loop for all tasks, models and machines.

    python -m benchmarks.reconstruction.train --model panel_set --task T0 --smoke --out out     a minute on two cores
    python -m benchmarks.reconstruction.train --model my/model.py:build --task T1 --train 4000 --minutes 8 --out out
    torchrun --nproc-per-node 4 -m benchmarks.reconstruction.train --model parameters --task T1 --train 160000 \
        --minutes 15 --compile --validate 500 --out out

The garments are made from seeds and kept in ``--data``, or read from ``--source``. A repeated call goes on from the
checkpoint in ``--out``; SIGINT or SIGTERM ends a call with a checkpoint and exit code 3. What is drawn in step k
depends on the seed, k and the rank alone. ``torchrun`` starts several ranks: each reads its share of the garments,
draws its part of every batch from it, and the gradients are averaged. Answers, scores and files of a run: ``runs``.
"""

import copy
import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.reconstruction.learners import Examples, Learner
from benchmarks.reconstruction.models import load_model
from benchmarks.reconstruction.options import Config, parsed
from benchmarks.reconstruction.processes import (
    agreed,
    averaged_over_ranks,
    ending_signals,
    one_of_several,
    rank,
    ranks,
    same_on_all_ranks,
)
from benchmarks.reconstruction.recording import recorded
from benchmarks.reconstruction.runs import (
    BETTER,
    Check,
    Trained,
    Watch,
    answered,
    draped,
    examples_of,
    kept_report,
    load_split,
    require_usable,
    show,
)
from benchmarks.reconstruction.tasks import task_named
from benchmarks.reconstruction.weights import load_weights, read_checkpoint, save_weights
from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.files import drafted, make_folder

CHECKPOINT, UNFINISHED = "checkpoint.pt", 3
BETAS, LARGEST_GRADIENT = (0.9, 0.98), 1.0
CHECKPOINT_S = 120.0  # between checkpoints


class StoppedError(GcdError):
    """A training that a signal ended; its checkpoint is written."""


# ------------------------------------------------------------------------------------------------------------- the loop


def train(
    learner: Learner[Any, Any],
    examples: Examples[Any],
    config: Config,
    *,
    device: torch.device,
    out: Path | None = None,
    check: Check | None = None,
) -> Trained:
    """Train a learner, or go on from the checkpoint in ``out``, which receives checkpoints and curves.

    Raises ``StoppedError`` for a training that a signal ends; ``ConfigError`` for weights or a checkpoint of another
    network, and for a loss that is not finite.
    """
    state = _State(learner.to(device), config, device)
    path = None if out is None else make_folder(out) / CHECKPOINT
    rows = state.restore(path, examples) if path is not None and path.exists() else []
    if config.compile and state.progress < 1:
        learner.compile_parts()
        state.losses_of(state.batch(examples))  # compiles now, not in the time of the steps
        if learner.is_recordable and device.type == "cuda":
            state.losses_of = recorded(learner, state.losses_of, state.batch(examples))
    next_check = math.floor(state.progress * config.checks) + 1
    with ending_signals() as is_signalled:
        saved = mark = time.perf_counter()
        while state.progress < 1:
            state.take_step(examples)
            elapsed = time.perf_counter() - mark
            state.seconds, is_over = agreed(state.seconds + elapsed, is_over=is_signalled())
            mark += elapsed
            is_last, checked = is_over or state.progress >= 1, dict[str, float]()
            if check is not None and state.progress * config.checks >= next_check:
                next_check = math.floor(state.progress * config.checks) + 1
                if path is not None:
                    state.save(path, examples, rows)  # the training outlives a check that fails
                checked = state.checked(check)
            if checked or is_last or state.step % config.log_every == 0:
                rows.append(state.row(checked))
                show(rows, out)
            if path is not None and (is_last or mark - saved > CHECKPOINT_S):
                state.save(path, examples, rows)
                saved = time.perf_counter()
            mark = time.perf_counter()
            if is_over and state.progress < 1:
                raise StoppedError(f"stopped by a signal at {state.progress:.0%}: repeat the command to go on")
    if state.best is not None:
        state.averaged.load_state_dict(state.best[1])
    if out is not None and not rank():
        save_weights(out, state.averaged, state.optimizer, learner)
    return Trained(state.averaged, state.step, state.seconds, rows)


class _State:
    """Weights, their average, optimiser, step and time."""

    def __init__(self, learner: Learner[Any, Any], config: Config, device: torch.device) -> None:
        self.learner, self.config, self.device = learner, config, device
        if device.type == "cuda":
            torch.set_float32_matmul_precision("high")  # TF32 outside autocast
        trained = [p for p in learner.parameters() if p.requires_grad]
        groups = [
            {"params": [p for p in trained if (p.ndim > 1) == decays], "weight_decay": config.weight_decay * decays}
            for decays in (True, False)
        ]
        self.optimizer = torch.optim.AdamW(groups, lr=config.lr, betas=BETAS, fused=device.type == "cuda")
        if config.weights:
            load_weights([Path(path) for path in config.weights.split(",")], learner, self.optimizer)
        same_on_all_ranks(learner.state_dict().values())
        self.averaged = copy.deepcopy(learner).requires_grad_(False).eval()
        self._pairs = list(zip(self.averaged.state_dict().values(), learner.state_dict().values(), strict=True))
        self.step, self.seconds = 0, 0.0
        self.best: tuple[float, dict[str, Tensor]] | None = None
        self.losses_of: Callable[[Any], Tensor] = self._pass
        self._names, self._losses = list[str](), list[Tensor]()
        self._ended: torch.cuda.Event | None = None

    @property
    def progress(self) -> float:
        """Share of the training that is done."""
        if self.config.steps:
            return self.step / self.config.steps
        return self.seconds / (60.0 * self.config.minutes) if self.config.minutes else 1.0

    def take_step(self, examples: Examples[Any]) -> None:
        if hasattr(examples, "advance"):  # a pool that fresh garments renew
            examples.advance(self.step)
        for group in self.optimizer.param_groups:
            group["lr"] = self.config.lr * learning_rate(self._progress_of_step(), self.config.warm_up)
        losses = self.losses_of(self.batch(examples))
        averaged_over_ranks([p.grad for p in self.learner.parameters() if p.grad is not None])
        nn.utils.clip_grad_norm_(self.learner.parameters(), LARGEST_GRADIENT)
        self.optimizer.step()
        _average(self._pairs, self.config.ema, self.step)
        self._losses.append(torch.cat([losses.sum()[None], losses]))
        self.step += 1
        if self.device.type == "cuda":  # wait for the step before the last: a step starts in less time than it takes
            before, self._ended = self._ended, torch.cuda.Event()  # type: ignore[no-untyped-call]
            self._ended.record(torch.cuda.current_stream(self.device))
            last = self._ended if self.step % self.config.log_every == 0 else before
            if last is not None:
                last.synchronize()

    def batch(self, examples: Examples[Any]) -> Any:
        """The batch of the step: this rank's part."""
        seed = np.random.SeedSequence((self.config.seed, self.step, *([rank()] if rank() else [])))
        number = int(seed.generate_state(1, np.uint64)[0] >> np.uint64(1))
        torch.manual_seed(number)
        chance = torch.Generator().manual_seed(number)
        own = len(range(rank(), self.config.batch, ranks()))
        return examples.batch(torch.randint(len(examples), (own,), generator=chance), chance)

    def _pass(self, batch: Any) -> Tensor:
        """Loss terms of a batch; fills the gradients of the learner."""
        self.learner.train().zero_grad()
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.device.type == "cuda"):
            parts = self.learner.loss(batch)
        self._names = list(parts)
        losses = torch.stack([part.float() for part in parts.values()])
        torch.autograd.backward(losses.sum())
        return losses.detach()

    def _progress_of_step(self) -> float:
        """Progress in the middle of the step that begins, so that the first step has a learning rate above 0."""
        if self.config.steps:
            return min(1.0, (self.step + 0.5) / self.config.steps)
        return min(1.0, (self.step + 1) / max(self.step, 1) * self.progress) if self.step else 1e-3

    def checked(self, check: Check) -> dict[str, float]:
        """The figures of a check, on the first rank; the best weights are kept."""
        found = {} if rank() else dict(check(self.step, self.averaged))
        value = found.pop(BETTER, None)
        if value is not None and (self.best is None or value > self.best[0]):
            self.best = value, {name: own.clone() for name, own in self.averaged.state_dict().items()}
        return found

    def row(self, checked: Mapping[str, float]) -> dict[str, float]:
        """A row of the curves. Raises ``ConfigError`` for a loss that is not finite."""
        means = dict(zip(["loss", *self._names], torch.stack(self._losses).mean(dim=0).tolist(), strict=True))
        if not math.isfinite(means["loss"]):
            raise ConfigError(f"step {self.step}: the loss is {means['loss']}: lower --lr {self.config.lr:g}")
        self._losses.clear()
        rate = float(self.optimizer.param_groups[0]["lr"])
        return {"step": self.step, "seconds": round(self.seconds, 2), "lr": rate, **means, **checked}

    # ----------------------------------------------------------------------------------------------- checkpoints

    def save(self, path: Path, examples: Examples[Any], rows: Sequence[Mapping[str, float]]) -> None:
        """Write the checkpoint, on the first rank."""
        if rank():
            return
        state = {
            "config": self.config.identity,
            **{name: getattr(self, name).state_dict() for name in ("learner", "averaged", "optimizer")},
            "progress": (self.step, self.seconds, self.best),
            "rows": list(rows),
            "examples": examples.state_dict() if hasattr(examples, "state_dict") else {},
        }
        with drafted(path) as draft:
            torch.save(state, draft)

    def restore(self, path: Path, examples: Examples[Any]) -> list[dict[str, float]]:
        """Go on from a checkpoint; the rows of its curves. Raises ``ConfigError`` for one of another training."""
        state = read_checkpoint(path, self.config.identity, self.device)
        for name in ("learner", "averaged", "optimizer"):
            getattr(self, name).load_state_dict(state[name])
        self.step, self.seconds, self.best = state["progress"]
        if hasattr(examples, "load_state_dict"):
            examples.load_state_dict(state["examples"])
        rows: list[dict[str, float]] = state["rows"]
        return rows


def learning_rate(progress: float, warm_up: float) -> float:
    """Learning rate relative to the highest at a progress in [0, 1]: linear warm-up, then half a cosine."""
    if progress < warm_up:
        return progress / warm_up
    return 0.5 + 0.5 * math.cos(math.pi * min(1.0, (progress - warm_up) / (1 - warm_up)))


@torch.no_grad()
def _average(pairs: Sequence[tuple[Tensor, Tensor]], decay: float, step: int) -> None:
    """Update pairs of average and weights after step ``step``: the mean of few steps at first, then with the decay."""
    weight = 1.0 - min(decay, (1 + step) / (10 + step)) if decay and step else 1.0
    floating = [pair for pair in pairs if pair[0].is_floating_point()]
    torch._foreach_lerp_([a for a, _ in floating], [c for _, c in floating], weight)
    for a, c in pairs:
        if not a.is_floating_point():
            a.copy_(c)


def run(config: Config) -> Mapping[str, Sequence[float]]:
    """Make the garments, train, answer, score, drape; the scores, or none with ``make_only`` and on other ranks."""
    task, model, out = task_named(config.task), load_model(config.model), Path(config.out)
    torch.manual_seed(config.seed)
    learner = model.build(config.sizes) if hasattr(model, "build") else None
    require_usable(config, task, model, learner)
    if config.smoke:
        torch.set_num_threads(1)  # fastest for tiny networks
    with one_of_several(config.device) as device:
        begun = time.perf_counter()
        split = load_split(config, task)
        loaded = time.perf_counter()
        print(f"{len(split.train)} garments to train on: {loaded - begun:.0f} s", file=sys.stderr)
        if config.make_only:
            return {}
        report, trained, received = kept_report(config), None, 0
        if report is None and learner is not None:
            examples = examples_of(learner.to(device), split, config, task, device)
            watch = Watch(split.check, learner.prepare(split.check, device=device), config, task)
            trained = train(learner, examples, config, device=device, out=out, check=watch)
            received = getattr(examples, "received", 0)
        if report is None:
            times = {"load_s": loaded - begun, "fresh": received}
            report = answered(config, task, model, split, trained, device, times)
        if rank():
            return {}
    scores: Mapping[str, Sequence[float]] = draped(report, config, task)["scores"] if config.drape else report["scores"]
    return scores


def main(arguments: Sequence[str] | None = None) -> int:
    """Train a model, and print the scores of its answers. Returns the exit code."""
    try:
        config = parsed(arguments)
        for name, (mean, low, high) in run(config).items():
            print(f"{config.task}.{Path(config.model).stem}.{name} {mean:.4g} ({low:.4g} to {high:.4g})")
    except GcdError as error:
        print(f"train: {error}", file=sys.stderr)
        return UNFINISHED if isinstance(error, StoppedError) else 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
