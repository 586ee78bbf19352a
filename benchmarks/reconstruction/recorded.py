"""``RecordedStep``: the loss and the gradients of a step as a CUDA graph, which one launch repeats.

A compiled step of small kernels is limited by the time to launch them. A graph launches them at once, and reads its
batch from memory that does not move (https://docs.pytorch.org/docs/stable/notes/cuda.html#cuda-graphs).
"""

from collections.abc import Callable
from typing import Generic, TypeVar

import torch
from torch import Tensor, nn

from benchmarks.reconstruction.learners import TensorExamples

__all__ = ["RecordedStep"]

Batch = TypeVar("Batch", bound=TensorExamples)
WARM_UP = 3  # passes before the recording, in which kernels are loaded and tuned


class RecordedStep(Generic[Batch]):
    """A pass forward and backward, recorded for batches of one shape.

    The gradients that the parameters of the model hold are overwritten by each call; they must not be set to ``None``.
    """

    def __init__(self, model: nn.Module, losses_of: Callable[[Batch], Tensor], batch: Batch) -> None:
        """``losses_of``: loss terms of a batch on a GPU; it waits for nothing on the device."""
        self._batch, self._losses_of = batch[:], losses_of
        aside = torch.cuda.Stream(batch.device)  # type: ignore[no-untyped-call]
        aside.wait_stream(torch.cuda.current_stream(batch.device))
        with torch.cuda.stream(aside):
            for _ in range(WARM_UP):
                model.zero_grad()
                self._pass()
        torch.cuda.current_stream(batch.device).wait_stream(aside)
        model.zero_grad()  # the recorded pass then allocates gradients that stay in place
        self._graph = torch.cuda.CUDAGraph()
        # Other threads may use the device meanwhile, such as the one that receives fresh garments.
        with torch.cuda.graph(self._graph, capture_error_mode="thread_local"):
            self._losses = self._pass()

    def __call__(self, batch: Batch) -> Tensor:
        """The loss terms; the parameters hold the gradients. Raises ``ValueError`` for a batch of another shape."""
        self._batch.copy_(batch)
        self._graph.replay()
        return self._losses.clone()

    def _pass(self) -> Tensor:
        losses = self._losses_of(self._batch)
        torch.autograd.backward(losses.sum())
        return losses.detach()
