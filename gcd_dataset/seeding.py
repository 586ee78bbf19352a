"""Keyed random streams: one for each stage of each sample.

>>> rng(seed=7, index=12, stage=Stage.DESIGN, attempt=1).integers(100, size=3)
array([49, 76, 71])
"""

from enum import IntEnum

import numpy as np

__all__ = ["Stage", "rng"]


class Stage(IntEnum):
    """Stages of generation that draw random numbers; the value is part of the stream's key."""

    BODY = 1
    DESIGN = 2
    FABRIC = 3
    POINTS = 4
    AUGMENT = 5
    KIND = 6
    ARMS = 7
    SPLIT = 8
    DRAFT = 9
    APPEARANCE = 10
    VIEW = 11
    CAPTION = 12
    SCAN = 13
    SKETCH = 14
    MISFIT = 15
    OUTFIT = 16
    POSE = 17


def rng(seed: int, index: int, stage: Stage, attempt: int = 0) -> np.random.Generator:
    """The generator of one stage of one sample; it depends on these four numbers only.

    The stream is Philox (Salmon et al., SC 2011), keyed by a ``SeedSequence`` over the four numbers, so that
    neighbouring samples and attempts are independent.
    """
    entropy = (_natural(seed, "seed"), _natural(index, "index"), int(stage), _natural(attempt, "attempt"))
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(entropy)))


def _natural(number: int, name: str) -> int:
    if number < 0:
        raise ValueError(f"{name} is {number}: random streams need keys of 0 or more")
    return int(number)
