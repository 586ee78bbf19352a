"""The interface between tasks, models and the training loop.

A ``Learner`` is a network with its loss and its answers. It prepares the examples of a ``GarmentSet`` once, on a
device; the loop (``train``) draws batches of them. ``TensorExamples`` is the usual form of examples and batches: a
frozen dataclass of tensors with one row for each example.
"""

import queue
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, Self, TypeVar, cast

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment
from torch import Tensor, nn

from gcd_dataset.errors import ConfigError
from gcd_dataset.workers import parallel_map

if TYPE_CHECKING:
    from benchmarks.reconstruction.garments import GarmentSet, Split
    from benchmarks.reconstruction.options import Config

Batch = TypeVar("Batch")
BatchOf = TypeVar("BatchOf", covariant=True)
Answer = TypeVar("Answer")


class Examples(Protocol[BatchOf]):
    """Examples to learn from."""

    def __len__(self) -> int: ...

    def batch(self, rows: Int[Tensor, " b"], chance: torch.Generator | None = None) -> BatchOf:
        """The examples ``rows`` (a CPU tensor), on the device of the examples.

        ``chance``: a CPU generator for augmentation, such as a new subset of the points; without one, the batch is
        always the same.
        """


class Learner(nn.Module, ABC, Generic[Batch, Answer]):
    """A network that the loop can train.

    The loop calls ``loss`` in bfloat16 autocast on a GPU; a loss that needs float32 disables autocast for itself.
    """

    is_recordable: ClassVar[bool] = False
    """Whether a compiled training on a GPU records a step (``recording``).

    The loss must wait for nothing on the device, and batches of equally many rows must differ by their tensors' values.
    """

    @abstractmethod
    def prepare(self, garments: "GarmentSet", *, device: torch.device, workers: int = 0) -> Examples[Batch]:
        """Inputs and targets of the garments, on the device; computed by ``workers`` processes."""

    def encoder(self) -> "Callable[[GarmentSet], TensorExamples] | None":
        """A function that computes the examples of garments on a CPU, and that can be pickled.

        Processes that make fresh garments call it. ``None``: the learner learns from fixed sets only.
        """
        return None

    def drawn_from(self, encoded: "TensorExamples") -> Examples[Batch]:
        """Examples that draw batches from the result of ``encoder``; by default its rows."""
        return cast(Examples[Batch], encoded)

    @abstractmethod
    def loss(self, batch: Batch) -> dict[str, Tensor]:
        """Weighted loss terms by name; their sum is minimised."""

    @abstractmethod
    def predict(self, batch: Batch) -> list[Answer]:
        """The answer to each example of a batch: a ``Pattern``, or an array."""

    def answers(self, examples: Examples[Batch], count: int, *, batch: int, workers: int = 0) -> Iterable[Answer]:
        """The answers to the first ``count`` examples; ``workers`` processes may share work that needs no network."""
        rows = torch.split(torch.arange(count), batch)
        return [answer for part in rows for answer in self.predict(examples.batch(part))]

    def tables(self, split: "Split", config: "Config", out: Path, *, workers: int) -> dict[str, Any]:
        """Further entries of the report, besides the scores of the answers; by default none."""
        return {}

    def compile_parts(self) -> None:
        """Compile the parts of the network that gain by it (``nn.Module.compile``). By default none."""


def uploaded(numbers: Tensor, device: torch.device) -> Tensor:
    """A tensor on a device; a GPU is not waited for."""
    if device.type == "cuda" and numbers.device.type == "cpu":
        numbers = numbers.pin_memory()  # from pageable memory the copy would wait for all work of the stream
    return numbers.to(device, non_blocking=True)


WORST = 1e6  # stands for costs that are no numbers
CHUNK = 64  # garments that a process encodes at once
Encoded = TypeVar("Encoded", bound="TensorExamples")


def encoded_by(encode: "Callable[[GarmentSet], Encoded]", garments: "GarmentSet", workers: int) -> "Encoded":
    """The examples of garments, encoded on CPUs by ``workers`` processes."""
    parts = (garments.select(range(k, min(k + CHUNK, len(garments)))) for k in range(0, len(garments), CHUNK))
    found = list(parallel_map(encode, parts, workers))
    return type(found[0]).join(found)


def mean_of(values: Float[Tensor, "*b e"], chosen: Bool[Tensor, "*b e"]) -> Tensor:
    """Mean of the chosen values; 0 if there are none."""
    return torch.where(chosen, values, 0.0).sum() / chosen.sum().clamp(min=1)


@torch.no_grad()
def squared_distances(one: Float[Tensor, "*b n d"], other: Float[Tensor, "*b m d"]) -> Float[Tensor, "*b n m"]:
    """Squares of the distances between points, in float32, for few dimensions.

    On a GPU ``torch.cdist`` rounds positions to TF32, which exceeds the distances of neighbours, or starts a block of
    threads for each pair.
    """
    found = one.new_zeros(*one.shape[:-1], other.shape[-2], dtype=torch.float32)
    for first, second in zip(one.float().unbind(-1), other.float().unbind(-1), strict=True):
        apart = first[..., :, None] - second[..., None, :]
        found.addcmul_(apart, apart)
    return found


@torch.no_grad()
def least_cost(cost: Float[Tensor, "b r c"], asked: Bool[Tensor, "b r"]) -> Int[Tensor, "b r"]:
    """The column of each row ``asked`` for, different columns at least total cost; 0 for the other rows.

    The device is waited for. There are at least as many columns as rows. Costs that are not finite are large.
    """
    found = torch.zeros(asked.shape, dtype=torch.int64)
    tables = torch.nan_to_num(cost.float(), nan=WORST, posinf=WORST, neginf=-WORST).cpu().numpy()
    for one, table, chosen in zip(found, tables, asked.cpu().numpy(), strict=True):
        rows = np.flatnonzero(chosen)
        one[rows] = torch.from_numpy(linear_sum_assignment(table[rows])[1])
    return uploaded(found, cost.device)


class TensorExamples:
    """Base of frozen dataclasses whose fields are tensors with one row for each example."""

    def __len__(self) -> int:
        return len(self._columns()[0])

    def __getitem__(self, rows: Tensor | slice) -> Self:
        return type(self)(*(column[rows] for column in self._columns()))

    def batch(self, rows: Int[Tensor, " b"], chance: torch.Generator | None = None) -> Self:
        """The examples ``rows``, without augmentation."""
        return self[uploaded(rows, self.device)]

    @property
    def device(self) -> torch.device:
        """The device of the tensors."""
        found: torch.device = self._columns()[0].device
        return found

    def to(self, device: torch.device) -> Self:
        """The same examples on a device."""
        return type(self)(*(column.to(device) for column in self._columns()))

    def put(self, rows: Int[Tensor, " b"], others: Self) -> None:
        """Replace the examples ``rows`` by others, in place."""
        for column, values in zip(self._columns(), others._columns(), strict=True):
            column[uploaded(rows, column.device)] = uploaded(values, column.device)

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        """The examples of several parts, in order."""
        return cls(*(torch.cat(columns) for columns in zip(*(part._columns() for part in parts), strict=True)))

    def _columns(self) -> list[Any]:
        return [getattr(self, field.name) for field in fields(self)]  # type: ignore[arg-type]


Sizes = TypeVar("Sizes")
NONE: Mapping[str, Any] = {}


def sizes_from(
    model: str,
    kind: type[Sizes],
    options: Mapping[str, Any],
    *,
    own: Sequence[str] = (),
    without: Sequence[str] = (),
    least: Mapping[str, int] = NONE,
    heads: Mapping[str, str] = NONE,
) -> tuple[Sizes, dict[str, Any]]:
    """The configuration of a network, and the options ``own``, which it has no fields for.

    ``without``: fields that the network does not use. ``least``: least values of sizes, 1 for others. ``heads``: names
    of widths, each with the name of the number of heads that share it. Raises ``ConfigError`` for an unusable option.
    """
    names = [*(field.name for field in fields(kind) if field.name not in without), *own]  # type: ignore[arg-type]
    unknown = set(options) - set(names)
    if unknown:
        raise ConfigError(f"no size {min(unknown)} of {model}: choose of {', '.join(names)}")
    for name, value in options.items():
        if isinstance(value, int) and value < least.get(name, 1):
            raise ConfigError(f"{name} {value} of {model}: give {least.get(name, 1)} or more")
    config = kind(**{name: value for name, value in options.items() if name not in own})
    for width, count in heads.items():
        if getattr(config, width) % getattr(config, count):
            given = f"{width} {getattr(config, width)} is no multiple of {count} {getattr(config, count)}"
            raise ConfigError(f"{given} of {model}: change one")
    return config, {name: options[name] for name in own if name in options}


# ------------------------------------------------------------------------------------------------------- fresh examples


WAITING = 256  # examples that wait to be taken


class FreshPool(Generic[Batch]):
    """The latest examples: those given at first, then fresh ones as they are made, the oldest replaced.

    Before each step the examples that are ready are taken; a step never waits. A training with a pool therefore depends
    on the speed of the machine. A training that goes on takes the next garments of the stream.
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
