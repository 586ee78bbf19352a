"""A training step as a CUDA graph, which one launch repeats.

A step of ``parameters`` on an H200 takes 27.8 ms recorded, as long as its kernels, 39.2 ms compiled, 46.2 ms plain.
"""

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import torch
from torch import Tensor, nn

WARM_UP = 3  # passes before the recording, in which kernels are loaded and tuned


def recorded(model: nn.Module, losses_of: Callable[[Any], Tensor], batch: Any) -> Callable[[Any], Tensor]:
    """``losses_of``, recorded for batches of one shape on a GPU: loss terms, and gradients of the model.

    ``losses_of`` waits for nothing on the device, and fills the gradients anew; do not set these to ``None`` later.
    ``batch``: a dataclass of tensors; its other fields are the same in all batches.
    """
    held = replace(batch, **{name: value.clone() for name, value in tensors_of(batch).items()})
    aside = torch.cuda.Stream()  # type: ignore[no-untyped-call]
    aside.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(aside):
        for _ in range(WARM_UP):
            losses_of(held)
    torch.cuda.current_stream().wait_stream(aside)
    model.zero_grad()  # the recorded pass then allocates gradients that stay in place
    graph = torch.cuda.CUDAGraph()
    # Other threads may use the device meanwhile, such as the one that receives fresh garments.
    with torch.cuda.graph(graph, capture_error_mode="thread_local"):
        losses = losses_of(held)

    def replayed(batch: Any) -> Tensor:
        replace_tensors(held, batch)
        graph.replay()
        return losses.clone()

    return replayed


def tensors_of(batch: Any) -> dict[str, Tensor]:
    """The tensors of a dataclass, by field."""
    values = {field.name: getattr(batch, field.name) for field in fields(batch)}
    return {name: value for name, value in values.items() if isinstance(value, Tensor)}


def replace_tensors(batch: Any, other: Any) -> None:
    """Replace the values of a batch's tensors by those of another, in place.

    Raises ``ValueError`` for tensors of other shapes, and for another value of a field that is no tensor.
    """
    shapes = [{name: tuple(value.shape) for name, value in tensors_of(some).items()} for some in (batch, other)]
    if shapes[0] != shapes[1]:
        raise ValueError(f"tensors of the shapes {shapes[1]}, not {shapes[0]}: give a batch of the same shapes")
    for field in fields(batch):
        if field.name not in shapes[0] and getattr(batch, field.name) != getattr(other, field.name):
            raise ValueError(f"another {field.name}: give a batch that differs by tensors only")
    torch._foreach_copy_(list(tensors_of(batch).values()), list(tensors_of(other).values()), non_blocking=True)
