"""Isolation of users' code from the random state of the training.

torch, NumPy and Python have one global random stream each per process; a model draws its dropout masks from torch's.
A transform that draws from a global stream between two training steps would shift every later draw of the model; in a
thread the shift would even depend on timing.
"""

import hashlib
import random

import numpy as np
import torch

__all__ = ["isolated_rng"]


class isolated_rng:  # noqa: N801 -- a context manager, named as functions are
    """Context manager: saves the global random states of torch (CPU), NumPy and Python, and restores them on exit.

    After ``seed``, draws depend on its arguments alone. Enter it in the training thread: the streams are per process.

    >>> with isolated_rng() as random_state:
    ...     random_state.seed(0, 7)
    ...     first = torch.rand(3)
    ...     random_state.seed(0, 7)
    ...     again = torch.rand(3)
    >>> torch.equal(first, again)
    True
    """

    # A class, not a generator function: entered for every batch, and several times as fast.
    __slots__ = ("_saved",)

    def __enter__(self) -> "isolated_rng":
        self._saved = torch.get_rng_state(), np.random.get_state(), random.getstate()  # noqa: NPY002
        return self

    def seed(self, *key: int) -> None:
        """Seed all three streams from a hash of the key."""
        digest = hashlib.sha256(repr(key).encode()).digest()[:16]
        torch.default_generator.manual_seed(int.from_bytes(digest[:8], "little"))
        np.random.seed(np.frombuffer(digest, np.uint32))  # noqa: NPY002
        random.seed(digest)

    def __exit__(self, *error: object) -> None:
        torch_state, numpy_state, python_state = self._saved
        torch.set_rng_state(torch_state)
        np.random.set_state(numpy_state)  # noqa: NPY002
        random.setstate(python_state)
