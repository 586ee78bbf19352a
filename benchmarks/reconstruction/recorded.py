"""``RecordedStep``: the loss and the gradients of a step as a CUDA graph, which one launch repeats.

A compiled step of small kernels is limited by the time to launch them. A graph launches them at once, and reads its
batch from memory that does not move (https://docs.pytorch.org/docs/stable/notes/cuda.html#cuda-graphs).
"""

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any, Generic, TypeVar, cast

import torch
from torch import Tensor, nn

Batch = TypeVar("Batch")
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
