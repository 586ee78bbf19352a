"""Copies of large arrays in the calling thread.

torch's threads spin after each call and take cores from workers that make garments: with 14 workers on 16 cores, a
loop that copied box meshes with torch received half as many garments.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np
import torch
from torch import Tensor

CHUNK = 1 << 15  # elements: torch converts larger tensors with several threads


def copy_tensor(value: Tensor) -> Tensor:
    """A copy of the tensor, in memory of its own."""
    return torch.from_numpy(value.detach().numpy().copy()) if _numpy_can_view(value) else value.clone()


def as_type(value: Tensor, dtype: torch.dtype) -> Tensor:
    """The tensor cast to a type; the same tensor if it has that type."""
    if value.numel() <= CHUNK or value.dtype == dtype or value.device.type != "cpu" or torch.get_num_threads() == 1:
        return value.to(dtype)
    result = torch.empty(value.shape, dtype=dtype)
    source, target = value.reshape(-1), result.view(-1)
    for cut in range(0, len(source), CHUNK):
        target[cut : cut + CHUNK].copy_(source[cut : cut + CHUNK])
    return result


def pin_tensor(value: Tensor) -> Tensor:
    """A copy in pinned memory. Raises ``RuntimeError`` without a GPU."""
    if not _numpy_can_view(value):
        return value.pin_memory()
    copy = torch.empty_like(value, pin_memory=True)
    np.copyto(copy.numpy(), value.detach().numpy())
    return copy


def concatenate(values: Sequence[Tensor], out: Tensor) -> None:
    """Concatenate tensors of one type along their first axis into ``out``."""
    if _numpy_can_view(out):
        np.concatenate([value.detach().numpy() for value in values], out=out.numpy())
    else:
        torch.cat(list(values), out=out)


def add(value: Tensor, start: int, out: Tensor) -> None:
    """Write ``value + start`` to ``out``; integers."""
    if _numpy_can_view(out):
        np.add(value.numpy(), start, out=out.numpy())
    else:
        torch.add(value, start, out=out)


def fill(out: Tensor, value: int) -> None:
    if _numpy_can_view(out):
        out.numpy().fill(value)
    else:
        out.fill_(value)


def _numpy_can_view(value: Tensor) -> bool:
    is_plain = value.device.type == "cpu" and value.layout is torch.strided and not (value.is_conj() or value.is_neg())
    return is_plain and _numpy_has(value.dtype)


@cache
def _numpy_has(dtype: torch.dtype) -> bool:
    """Whether NumPy has the type; it lacks bfloat16 and the 8-bit floats."""
    try:
        torch.empty(0, dtype=dtype).numpy()
    except TypeError:
        return False
    return True
