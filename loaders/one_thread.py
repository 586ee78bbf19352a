"""Large arrays put together by one thread.

Those of torch keep on turning for a while after each call, in the way of workers that make garments: with 14 of these
on 16 cores a loop that copied box meshes with them got half as many.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np
import torch
from torch import Tensor

__all__ = ["add", "as_type", "copied", "fill", "join", "pinned"]

AT_ONCE = 1 << 15  # numbers: of more torch has several threads convert them


def copied(value: Tensor) -> Tensor:
    """The same values in memory of their own."""
    return torch.from_numpy(value.detach().numpy().copy()) if _in_numpy(value) else value.clone()


def as_type(value: Tensor, dtype: torch.dtype) -> Tensor:
    """The values as another type; the same tensor where they are of it."""
    if value.numel() <= AT_ONCE or value.dtype == dtype or value.device.type != "cpu" or torch.get_num_threads() == 1:
        return value.to(dtype)
    changed = torch.empty(value.shape, dtype=dtype)
    source, target = value.reshape(-1), changed.view(-1)
    for cut in range(0, len(source), AT_ONCE):
        target[cut : cut + AT_ONCE].copy_(source[cut : cut + AT_ONCE])
    return changed


def pinned(value: Tensor) -> Tensor:
    """The same values in memory that a GPU copies from by itself. Raises ``RuntimeError`` without a GPU."""
    if not _in_numpy(value):
        return value.pin_memory()
    memory = torch.empty_like(value, pin_memory=True)
    np.copyto(memory.numpy(), value.detach().numpy())
    return memory


def join(values: Sequence[Tensor], out: Tensor) -> None:
    """Put values of one type one below the other."""
    if _in_numpy(out):
        np.concatenate([value.detach().numpy() for value in values], out=out.numpy())
    else:
        torch.cat(list(values), out=out)


def add(value: Tensor, start: int, out: Tensor) -> None:
    """Put whole numbers raised by ``start`` there."""
    if _in_numpy(out):
        np.add(value.numpy(), start, out=out.numpy())
    else:
        torch.add(value, start, out=out)


def fill(out: Tensor, value: int) -> None:
    """Put one number everywhere."""
    if _in_numpy(out):
        out.numpy().fill(value)
    else:
        out.fill_(value)


def _in_numpy(value: Tensor) -> bool:
    plain = value.device.type == "cpu" and value.layout is torch.strided and not (value.is_conj() or value.is_neg())
    return plain and _is_of_numpy(value.dtype)


@cache
def _is_of_numpy(dtype: torch.dtype) -> bool:
    """Not brain floats, nor those of 8 bits."""
    try:
        torch.empty(0, dtype=dtype).numpy()
    except TypeError:
        return False
    return True
