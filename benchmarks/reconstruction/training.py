"""The training loop: it knows no task, only a ``Learner`` and its examples.

What is drawn in step k depends on the seed and k alone, so a stopped training that is resumed from its checkpoint takes
the same steps as one that was never stopped. ``torchrun`` starts several ranks; each takes its part of every batch.
"""

import copy
import csv
import importlib.util
import math
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, Generic, Protocol, TypeVar, cast, runtime_checkable

import numpy as np
import torch
import torch.distributed as dist
from jaxtyping import Int
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from benchmarks.reconstruction.learners import Examples, Learner, TensorExamples
from gcd_dataset.devicenames import named_devices
from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.files import drafted, make_folder

Batch = TypeVar("Batch")
Check = Callable[[int, Learner[Any, Any]], Mapping[str, float]]
"""Called on the way with the step and the averaged learner; the figures returned become columns of the curves."""

CHECKPOINT, CURVES = "checkpoint.pt", "curves.csv"


class TrainingError(GcdError):
    """A training that cannot go on."""


class StoppedError(GcdError):
    """A training that reached the time limit of its call before its end; its checkpoint is written."""


@dataclass(frozen=True, slots=True)
class TrainConfig:
    """Options of a training.

    Raises ``ConfigError`` unless exactly one of ``steps`` and ``minutes`` is given, and for numbers out of range.
    """

    steps: int = 0
    """Optimiser steps."""
    minutes: float = 0.0
    """Time for the steps, checks not counted; the learning rate then follows the clock."""
    batch: int = 256
    """Examples of a step, of all ranks together."""
    lr: float = 5e-4
    """Highest learning rate."""
    warm_up: float = 0.05
    """Share of the training in which the learning rate rises."""
    rate_at: float = 0.5
    """Part of a step, in [0, 1], at whose progress its learning rate is taken."""
    betas: tuple[float, float] = (0.9, 0.98)
    """Decay of the means of AdamW."""
    weight_decay: float = 0.05
    """Weight decay, of matrices only unless ``decay_vectors``."""
    decay_vectors: bool = False
    largest_gradient: float = 1.0
    """Norm to which larger gradients are scaled."""
    ema: float = 0.999
    """Decay of the moving average of the weights, which answers; lower in the first steps; 0: the last weights."""
    bf16: bool = True
    """Autocast to bfloat16 on a GPU."""
    compile: bool = False
    """Compile the learner's parts, and record the step of a learner that allows it, before the time of the steps."""
    seed: int = 0
    log_every: int = 50
    """Steps of a row of the curves."""
    checks: int = 4
    """Calls of ``check`` in the course of the training."""
    checkpoint_minutes: float = 2.0
    """Time between checkpoints."""

    def __post_init__(self) -> None:
        if (self.steps != 0) == (self.minutes != 0) or self.steps < 0 or not 0 <= self.minutes < math.inf:
            raise ConfigError(f"steps {self.steps}, minutes {self.minutes:g}: give one of them, above 0")
        if self.batch < 1 or not 0 <= self.ema < 1:
            raise ConfigError(f"batch {self.batch}, ema {self.ema:g}: give a batch of 1 or more, an ema in [0, 1)")
        if not 0 < self.lr < math.inf or self.checks < 0:
            raise ConfigError(f"lr {self.lr:g}, checks {self.checks}: give a rate above 0, and 0 checks or more")

    @property
    def identity(self) -> dict[str, Any]:
        """The options that a resumed training must share."""
        free = ("log_every", "checks", "checkpoint_minutes", "compile")
        return {name: value for name, value in asdict(self).items() if name not in free}


@dataclass(frozen=True)
class Trained:
    """The end of a training."""

    learner: Learner[Any, Any]
    """The learner with averaged weights, in evaluation mode."""
    steps: int
    seconds: float
    """Time of the steps."""
    checked: float
    """Time of checks and checkpoints in this call [s]."""
    curve: list[dict[str, float]]
    """Rows of the curves: step, seconds, learning rate, mean loss and its terms since the row before, checks."""


@runtime_checkable
class Growing(Protocol):
    """Examples that change in the course of a training, such as a pool fed by a stream."""

    def advance(self, step: int) -> None:
        """Called before each step, in order."""

    def state_dict(self) -> dict[str, Any]:
        """The position of the stream."""

    def load_state_dict(self, state: dict[str, Any]) -> None: ...


def train(
    learner: Learner[Batch, Any],
    examples: Examples[Batch],
    config: TrainConfig,
    *,
    device: torch.device,
    out: Path | None = None,
    check: Check | None = None,
    stop_after: int | None = None,
    limit: float = math.inf,
    of: Mapping[str, str | int] | None = None,
) -> Trained:
    """Train a learner, or continue from the checkpoint in ``out``.

    ``of``: what is trained on what, such as the model, its sizes and hashes of the garments; a checkpoint of another
    training is refused. ``out``: folder of the checkpoint and the curves; ``None``: neither is written. ``stop_after``:
    stop after this step as a job's time limit does, with a checkpoint. ``limit``: time of this call [s].

    Raises ``StoppedError``, with a checkpoint in ``out``, for a training that the limit, SIGINT or SIGTERM ends;
    ``TrainingError`` for a loss that is not finite; ``ConfigError`` for a checkpoint of another training.
    """
    called = time.perf_counter()
    torch.manual_seed(config.seed)
    run = _Run(learner.to(device), config, device, of)
    curves = _Curves(None if out is None or rank() else make_folder(out))
    if out is not None and (out / CHECKPOINT).exists():
        position = run.restore(out / CHECKPOINT)
        curves.resume(run.step)
        if isinstance(examples, Growing):
            examples.load_state_dict(dict(position))
    if config.compile and run.progress < 1:
        examples = run.compile(examples)
    next_check, aside = math.floor(run.progress * config.checks) + 1, 0.0
    with _signals() as is_signalled:
        saved, mark = time.perf_counter(), time.perf_counter()
        while run.progress < 1 and (stop_after is None or run.step < stop_after):
            run.take_step(examples)
            run.wait()
            elapsed = time.perf_counter() - mark
            run.seconds, mark = run.seconds + elapsed, mark + elapsed
            is_over = run.agree_on_time(is_over=is_signalled() or mark - called > limit) and run.progress < 1
            is_last = is_over or run.progress >= 1 or run.step == stop_after
            checked: Mapping[str, float] = {}
            if check is not None and run.progress * config.checks >= next_check:
                next_check = math.floor(run.progress * config.checks) + 1
                checked = check(run.step, run.averaged) if not rank() else {}
            if checked or is_last or run.step % config.log_every == 0:
                curves.add(run.row(checked))
            if out is not None and (is_last or mark - saved > 60.0 * config.checkpoint_minutes):
                run.save(out / CHECKPOINT, examples)
                saved = time.perf_counter()
            aside, mark = aside + time.perf_counter() - mark, time.perf_counter()
            if is_over:
                curves.close()
                cause = "a signal" if is_signalled() else "the limit"
                raise StoppedError(f"stopped by {cause} at {run.progress:.0%}: repeat the command to continue")
    curves.close()
    return Trained(run.averaged, run.step, run.seconds, aside, curves.rows)


def learning_rate(progress: float, warm_up: float) -> float:
    """Learning rate relative to the highest at a progress in [0, 1]: linear warm-up, then half a cosine."""
    if progress < warm_up:
        return progress / warm_up
    return 0.5 + 0.5 * math.cos(math.pi * min(1.0, (progress - warm_up) / (1 - warm_up)))


def training_device(name: str) -> str:
    """``cpu``, ``cuda`` or ``cuda:N``; ``auto`` is the GPU where there is one.

    Raises ``ConfigError`` for another name, and for a GPU that this machine does not have.
    """
    count = torch.cuda.device_count()
    if name == "auto":
        return "cuda" if count else "cpu"
    devices = named_devices(name)
    if len(devices) > 1:
        raise ConfigError(f"device {name}: give one; torchrun starts a process for each of several GPUs")
    if devices[0] != "cpu" and int(devices[0].removeprefix("cuda:")) >= count:
        raise ConfigError(f"device {name}: this machine has {count} GPUs that torch can use: give another, cpu or auto")
    return name


@contextmanager
def _signals() -> Iterator[Callable[[], bool]]:
    """A function that tells whether SIGINT or SIGTERM arrived; the second of a kind acts as before."""
    owner, before, received = os.getpid(), dict[int, Any](), list[int]()

    def note(number: int, frame: object) -> None:
        signal.signal(number, before[number])
        if os.getpid() == owner:
            received.append(number)
        else:  # a process that was forked meanwhile, such as a worker
            os.kill(os.getpid(), number)

    if threading.current_thread() is threading.main_thread():  # others cannot set handlers
        before |= {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(received)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def one_of_several_ranks(device: str) -> Iterator[torch.device]:
    """The device of this rank; under ``torchrun``, the ranks are joined for the length of the block."""
    several = int(os.environ.get("WORLD_SIZE", "1")) > 1
    if not several:
        yield torch.device(device)
        return
    cuda = device.startswith("cuda")
    own = torch.device("cuda", int(os.environ["LOCAL_RANK"])) if cuda else torch.device(device)
    if cuda:
        torch.cuda.set_device(own)
    dist.init_process_group("nccl" if cuda else "gloo")
    try:
        yield own
    finally:
        dist.destroy_process_group()


def rank() -> int:
    """The number of this process among those of ``torchrun``; 0 without them."""
    return dist.get_rank() if dist.is_initialized() else 0


# -------------------------------------------------------------------------------------------------------------- the run


class _Run:
    """The state of a training."""

    def __init__(
        self,
        learner: Learner[Any, Any],
        config: TrainConfig,
        device: torch.device,
        of: Mapping[str, str | int] | None = None,
    ) -> None:
        self.learner, self.config, self.device = learner, config, device
        self.identity = {**(of or {}), **config.identity}
        self.step, self.seconds = 0, 0.0
        if device.type == "cuda":
            torch.set_float32_matmul_precision("high")  # TF32 outside autocast
        self.averaged = copy.deepcopy(learner).requires_grad_(False).eval()
        self._pairs = list(zip(self.averaged.state_dict().values(), learner.state_dict().values(), strict=True))
        matrices = [p for p in learner.parameters() if p.requires_grad and p.ndim > 1]
        vectors = [p for p in learner.parameters() if p.requires_grad and p.ndim <= 1]
        decays = config.weight_decay, config.weight_decay if config.decay_vectors else 0.0
        groups = [{"params": p, "weight_decay": d} for p, d in zip((matrices, vectors), decays, strict=True)]
        self.optimizer = torch.optim.AdamW(groups, lr=config.lr, betas=config.betas, fused=device.type == "cuda")
        self.model: nn.Module = learner
        if _ranks() > 1:
            self.model = DistributedDataParallel(learner, find_unused_parameters=False)
        self._recorded: RecordedStep[Any] | None = None
        self._ended: torch.cuda.Event | None = None
        self._names: list[str] = []
        self._losses_since: list[Tensor] = []  # the last row of the curves

    @property
    def progress(self) -> float:
        """Share of the training that is done."""
        if self.config.steps:
            return self.step / self.config.steps
        return self.seconds / (60.0 * self.config.minutes)

    def take_step(self, examples: Examples[Any]) -> None:
        config = self.config
        if isinstance(examples, Growing):
            examples.advance(self.step)
        rate = config.lr * learning_rate(self._progress_after(), config.warm_up)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        losses = self._with_gradients(examples)
        nn.utils.clip_grad_norm_(self.learner.parameters(), config.largest_gradient)
        self.optimizer.step()
        _average(self._pairs, config.ema, self.step)
        self.step += 1
        self._losses_since.append(torch.cat([losses.sum()[None], losses]))

    def wait(self) -> None:
        """Wait until a GPU has taken the step before the last; every ``log_every`` steps, until it has taken the last.

        A recorded step starts in less time than it takes: without this, the steps that wait would not be timed.
        """
        if self.device.type != "cuda":
            return
        before, self._ended = self._ended, torch.cuda.Event()  # type: ignore[no-untyped-call]
        self._ended.record(torch.cuda.current_stream(self.device))
        last = self._ended if self.step % self.config.log_every == 0 else before
        if last is not None:
            last.synchronize()

    def compile(self, examples: Examples[Any]) -> Examples[Any]:
        """Compile the learner's parts and record its step, by passes that take no step and draw no random number.

        Returns the examples for the steps.
        """
        self.learner.compile_parts()
        random = torch.get_rng_state()
        random_cuda = torch.cuda.get_rng_state(self.device) if self.device.type == "cuda" else None
        is_recorded = self.learner.is_recordable and self.device.type == "cuda" and self.model is self.learner
        if is_recorded:
            examples = self.learner.of_one_shape(examples)
        self._with_gradients(examples)
        self.optimizer.zero_grad()
        if is_recorded:
            self._recorded = RecordedStep(self.learner, self._losses, self._batch(examples))
        torch.set_rng_state(random)
        if random_cuda is not None:
            torch.cuda.set_rng_state(random_cuda, self.device)
            torch.cuda.synchronize(self.device)
        return examples

    def _with_gradients(self, examples: Examples[Any]) -> Tensor:
        """Loss terms of the step's batch; fills the gradients of the learner."""
        batch = self._batch(examples)
        if self._recorded is not None:
            return self._recorded(batch)
        losses = self._losses(batch)
        self.optimizer.zero_grad()
        torch.autograd.backward(losses.sum())
        return losses.detach()

    def _batch(self, examples: Examples[Any]) -> Any:
        """The batch of the step, or this rank's part of it."""
        chance = torch.Generator().manual_seed(_seed_of(self.config.seed, self.step))
        rows = torch.randint(len(examples), (self.config.batch,), generator=chance)
        return examples.batch(rows[rank() :: _ranks()], chance)

    def _losses(self, batch: Any) -> Tensor:
        """The loss terms of a batch."""
        self.model.train()
        on = self.config.bf16 and self.device.type == "cuda"
        with torch.autocast(self.device.type, torch.bfloat16, enabled=on):
            parts = self.model(batch)
        self._names = list(parts)
        return torch.stack([part.float() for part in parts.values()])

    def _progress_after(self) -> float:
        """Progress after the step that begins, so that the first step has a learning rate above 0."""
        if self.config.steps:
            return min(1.0, (self.step + self.config.rate_at) / self.config.steps)
        return min(1.0, (self.step + 1) / max(self.step, 1) * self.progress) if self.step else 1e-3

    def agree_on_time(self, *, is_over: bool) -> bool:
        """All ranks take the time and the decision of the first, and so stop at the same step."""
        if _ranks() > 1:
            said = torch.tensor([self.seconds, is_over], dtype=torch.float64, device=self.device)
            dist.broadcast(said, 0)
            self.seconds, over = said.tolist()
            return bool(over)
        return is_over

    def row(self, checked: Mapping[str, float]) -> dict[str, float]:
        """A row of the curves. Raises ``TrainingError`` for a loss that is not finite."""
        means = dict(zip(["loss", *self._names], torch.stack(self._losses_since).mean(dim=0).tolist(), strict=True))
        if not math.isfinite(means["loss"]):
            raise TrainingError(f"step {self.step}: the loss is {means['loss']}: lower lr {self.config.lr:g}")
        self._losses_since.clear()
        rate = float(self.optimizer.param_groups[0]["lr"])
        return {"step": self.step, "seconds": round(self.seconds, 2), "lr": rate, **means, **checked}

    # ----------------------------------------------------------------------------------------------- checkpoints

    def save(self, path: Path, examples: Examples[Any]) -> None:
        """Write the checkpoint, on the first rank."""
        if rank():
            return
        state = {
            "config": self.identity,
            "learner": self.learner.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "step": self.step,
            "seconds": self.seconds,
            "random": torch.get_rng_state(),
            "random_cuda": torch.cuda.get_rng_state(self.device) if self.device.type == "cuda" else None,
            "examples": examples.state_dict() if isinstance(examples, Growing) else {},
        }
        with drafted(path) as draft:
            torch.save(state, draft)

    def restore(self, path: Path) -> Mapping[str, Any]:
        """Continue from a checkpoint; the state of its examples. Raises ``ConfigError`` for one of other options."""
        try:
            state = torch.load(path, map_location=self.device, weights_only=True)
        except (RuntimeError, EOFError, ValueError, UnpicklingError) as error:
            raise ConfigError(f"{path}: no checkpoint ({error!s:.99}): delete it, the training starts again") from error
        ours, theirs = self.identity, state["config"]
        for name in dict.fromkeys([*ours, *theirs]):
            if ours.get(name) != theirs.get(name):
                given = f"of a training with {name} {theirs.get(name)}, not {ours.get(name)}"
                raise ConfigError(f"{path}: {given}: give another folder")
        self.learner.load_state_dict(state["learner"])
        self.averaged.load_state_dict(state["averaged"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.step, self.seconds = state["step"], state["seconds"]
        torch.set_rng_state(state["random"].cpu())
        if state["random_cuda"] is not None:
            torch.cuda.set_rng_state(state["random_cuda"].cpu(), self.device)
        position: Mapping[str, Any] = state["examples"]
        return position


@torch.no_grad()
def _average(pairs: Sequence[tuple[Tensor, Tensor]], decay: float, step: int) -> None:
    """Update pairs of average and weights after step ``step``: the mean of few steps at first, then with the decay.

    The number of the step is no tensor, so nothing waits for the device.
    """
    weight = 1.0 - min(decay, (1 + step) / (10 + step)) if decay and step else 1.0
    floating = [pair for pair in pairs if pair[0].is_floating_point()]
    torch._foreach_lerp_([a for a, _ in floating], [c for _, c in floating], weight)
    for a, c in pairs:
        if not a.is_floating_point():
            a.copy_(c)


def _seed_of(seed: int, step: int) -> int:
    return int(np.random.SeedSequence((seed, step)).generate_state(1, np.uint64)[0] >> np.uint64(1))


def _ranks() -> int:
    return dist.get_world_size() if dist.is_initialized() else 1


# ----------------------------------------------------------------------------------------------------------- the curves


class _Curves:
    """The rows of a training, in memory, in a CSV file, on stderr, and for TensorBoard where it is installed."""

    def __init__(self, folder: Path | None) -> None:
        self.rows: list[dict[str, float]] = []
        self._folder = folder
        self._board = None
        if folder is not None and importlib.util.find_spec("tensorboard") is not None:
            from torch.utils.tensorboard import SummaryWriter

            self._board = SummaryWriter(str(folder / "tensorboard"))

    def resume(self, step: int) -> None:
        """Keep the rows of an earlier run up to its checkpoint."""
        if self._folder is not None and (self._folder / CURVES).exists():
            with (self._folder / CURVES).open(newline="") as file:
                rows = [{name: float(v) for name, v in row.items() if v != ""} for row in csv.DictReader(file)]
            self.rows = [{**row, "step": int(row["step"])} for row in rows if row["step"] <= step]

    def add(self, row: dict[str, float]) -> None:
        """Add a row and write all."""
        self.rows.append(row)
        if self._folder is None:
            return
        shown = " ".join(f"{name} {value:.4g}" for name, value in row.items())
        print(shown, file=sys.stderr, flush=True)
        names = list(dict.fromkeys(name for entry in self.rows for name in entry))
        with drafted(self._folder / CURVES) as draft, draft.open("w", newline="") as file:
            writer = csv.DictWriter(file, names, restval="")
            writer.writeheader()
            writer.writerows(self.rows)
        if self._board is not None:
            for name, value in row.items():
                self._board.add_scalar(name, value, int(row["step"]))

    def close(self) -> None:
        if self._board is not None:
            self._board.close()


WARM_UP = 3  # passes before the recording, in which kernels are loaded and tuned


class RecordedStep(Generic[Batch]):
    """A pass forward and backward, recorded for batches of one shape.

    The gradients that the parameters of the model hold are overwritten by each call; they must not be set to ``None``.
    """

    def __init__(self, model: nn.Module, losses_of: Callable[[Batch], Tensor], batch: Batch) -> None:
        """``losses_of``: loss terms of a batch on a GPU; it waits for nothing on the device.

        ``batch``: a dataclass of tensors; its other fields are the same in all batches.
        """
        copies = {name: value.clone() for name, value in tensors_of(batch).items()}
        self._batch, self._losses_of = cast(Batch, replace(cast(Any, batch), **copies)), losses_of
        device = next(iter(tensors_of(batch).values())).device
        with torch.cuda.device(device):
            self._record(model, device)

    def _record(self, model: nn.Module, device: torch.device) -> None:
        aside = torch.cuda.Stream(device)  # type: ignore[no-untyped-call]
        aside.wait_stream(torch.cuda.current_stream(device))
        with torch.cuda.stream(aside):
            for _ in range(WARM_UP):
                model.zero_grad()
                self._pass()
        torch.cuda.current_stream(device).wait_stream(aside)
        model.zero_grad()  # the recorded pass then allocates gradients that stay in place
        self._graph = torch.cuda.CUDAGraph()
        # Other threads may use the device meanwhile, such as the one that receives fresh garments.
        with torch.cuda.graph(self._graph, capture_error_mode="thread_local"):
            self._losses = self._pass()

    def __call__(self, batch: Batch) -> Tensor:
        """The loss terms; the parameters hold the gradients. Raises ``ValueError`` as ``replace_tensors`` does."""
        replace_tensors(self._batch, batch)
        self._graph.replay()
        return self._losses.clone()

    def _pass(self) -> Tensor:
        losses = self._losses_of(self._batch)
        torch.autograd.backward(losses.sum())
        return losses.detach()


def tensors_of(batch: Any) -> dict[str, Tensor]:
    """The tensors of a dataclass, by field."""
    values = {field.name: getattr(batch, field.name) for field in fields(batch)}
    return {name: value for name, value in values.items() if isinstance(value, Tensor)}


def replace_tensors(batch: Batch, other: Batch) -> None:
    """Replace the values of a batch's tensors by those of another, in place.

    Raises ``ValueError`` for tensors of other shapes, and for another value of a field that is no tensor.
    """
    shapes = [{name: tuple(value.shape) for name, value in tensors_of(some).items()} for some in (batch, other)]
    if shapes[0] != shapes[1]:
        raise ValueError(f"tensors of the shapes {shapes[1]}, not {shapes[0]}: give a batch of the same shapes")
    for field in fields(batch):  # type: ignore[arg-type]
        if field.name not in shapes[0] and getattr(batch, field.name) != getattr(other, field.name):
            raise ValueError(f"another {field.name}: give a batch that differs by tensors only")
    torch._foreach_copy_(list(tensors_of(batch).values()), list(tensors_of(other).values()), non_blocking=True)


WAITING = 256  # examples that wait to be taken


class FreshPool(Generic[Batch]):
    """The latest examples: those given at first, then fresh ones as they are made, the oldest replaced.

    Before each step the examples that are ready are taken; a step never waits. A training with a pool therefore depends
    on the speed of the machine. A resumed training goes on with the next garments of the stream.
    """

    def __init__(
        self,
        learner: Learner[Batch, Any],
        first: TensorExamples,
        stream: Callable[[int], Iterator[tuple[int, TensorExamples]]],
        *,
        room: int,
    ) -> None:
        """``first``: examples to begin with, on the device; ``stream``: indices and encoded garments from an index on,
        on a CPU, in order.

        Raises ``ConfigError`` without room for the first examples.
        """
        if len(first) > room:
            raise ConfigError(f"room {room}: give room for the {len(first)} examples to begin with")
        self._stream, filled = stream, len(first)
        self._store = first[torch.arange(room, device=first.device) % filled]
        self._filled = self._next = filled
        self._view = learner.drawn_from(self._store)
        self._ready: queue.Queue[tuple[int, TensorExamples] | BaseException] | None = None
        self._following = 0  # index after the last example received; those of garments left out are counted
        self.received = 0
        """Fresh examples received, in this run and those that it continues."""

    def __len__(self) -> int:
        return self._filled

    def batch(self, rows: Int[Tensor, " b"], chance: torch.Generator | None = None) -> Batch:
        """The examples ``rows``, as the learner draws them."""
        return self._view.batch(rows, chance)

    def advance(self, step: int) -> None:
        """Take what is ready; the first call starts the stream. Raises the stream's error."""
        if self._ready is None:
            self._ready = queue.Queue(WAITING)
            thread = threading.Thread(target=_fill, args=(self._ready, self._stream(self._following)), daemon=True)
            thread.start()
        taken: list[TensorExamples] = []
        while len(taken) < WAITING:
            try:
                one = self._ready.get_nowait()
            except queue.Empty:
                break
            if isinstance(one, BaseException):
                raise one
            self._following = one[0] + 1
            taken.append(one[1])
        if taken:
            self._put(type(taken[0]).join(taken))

    def _put(self, fresh: TensorExamples) -> None:
        room = len(self._store)
        rows = (self._next + torch.arange(len(fresh))) % room
        self._store.put(rows, fresh)
        self._next = int((self._next + len(fresh)) % room)
        self._filled = min(room, self._filled + len(fresh))
        self.received += len(fresh)

    def state_dict(self) -> dict[str, Any]:
        """The number of examples received, and the index at which the stream continues."""
        return {"received": self.received, "following": self._following}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue the stream after the examples received before."""
        self.received, self._following = state["received"], state["following"]


def _fill(
    ready: "queue.Queue[tuple[int, TensorExamples] | BaseException]", stream: Iterator[tuple[int, TensorExamples]]
) -> None:
    try:
        for one in stream:
            ready.put(one)
    except Exception as error:  # noqa: BLE001 - raised in the training
        ready.put(error)
