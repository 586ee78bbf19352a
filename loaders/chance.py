"""Random numbers for code of users that runs between two steps of a training: none of the training's own.

torch, NumPy and Python each have one stream of random numbers for a whole process, which a model draws dropout from.
Whoever draws from it while garments are loaded shifts what the model draws next; a thread would even do so at chance.
"""

import hashlib
import random

import numpy as np
import torch

__all__ = ["own_chance"]


class own_chance:  # noqa: N801 -- a context manager, named as functions are
    """Lends ``torch.rand`` on the CPU, ``numpy.random`` and ``random``, which go on afterwards as if unused.

    What is drawn after ``begin`` depends on its numbers alone. To be entered by the thread that trains, since the
    streams belong to the process.

    >>> with own_chance() as chance:
    ...     chance.begin(0, 7)
    ...     first = torch.rand(3)
    ...     chance.begin(0, 7)
    ...     again = torch.rand(3)
    >>> torch.equal(first, again)
    True
    """

    # A class: entered for every batch, where a generator would take several times as long.
    __slots__ = ("_kept",)

    def __enter__(self) -> "own_chance":
        self._kept = torch.get_rng_state(), np.random.get_state(), random.getstate()  # noqa: NPY002
        return self

    def begin(self, *key: int) -> None:
        """Begin the streams named by some numbers."""
        seed = hashlib.sha256(repr(key).encode()).digest()[:16]
        torch.default_generator.manual_seed(int.from_bytes(seed[:8], "little"))
        np.random.seed(np.frombuffer(seed, np.uint32))  # noqa: NPY002
        random.seed(seed)

    def __exit__(self, *error: object) -> None:
        of_torch, of_numpy, of_python = self._kept
        torch.set_rng_state(of_torch)
        np.random.set_state(of_numpy)  # noqa: NPY002
        random.setstate(of_python)
