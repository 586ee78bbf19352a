"""Separation of a data set into package code, which loads items, and users' code, and its isolated random streams.

Package code draws no global random numbers, so it may run at any time, in a thread beside the training too. Users' code
may draw from the streams that the training draws from: it runs in the training thread or in a worker process.
"""

import copy
import hashlib
import random
from collections.abc import Callable
from functools import partial
from typing import Any, TypeAlias

import numpy as np
import torch
from torch.utils.data import Dataset

from gcd_dataset.loaders.base import Garments, SelectedGarments
from gcd_dataset.loaders.collate import collate_list, collate_packed, collate_padded
from gcd_dataset.loaders.mixed import MixedDataset
from gcd_dataset.loaders.transforms import Augmented

UserCode: TypeAlias = Callable[[Any, int], Any]
"""``(item, index)`` to the transformed item."""

COLLATES = (collate_list, collate_packed, collate_padded)


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


def separate_user_code(dataset: Dataset) -> tuple[Dataset, UserCode | None]:
    """A data set without users' transforms, and a function that applies them; ``None`` if there are none.

    A data set of a user's class stays as it is.
    """
    if isinstance(dataset, SelectedGarments):
        return _selected(dataset)
    if isinstance(dataset, Augmented):
        whole, first = separate_user_code(dataset.whole)
        return whole, partial(_chained, first, dataset._augmented)
    if isinstance(dataset, MixedDataset):
        return _mixed(dataset)
    if isinstance(dataset, Garments) and is_package_code(type(dataset)) and dataset.transform is not None:
        return _without_transform(dataset), dataset._transformed
    return dataset, None


def is_package_code(code: Any) -> bool:
    """Whether a class or ``collate_fn`` is of this package, and so draws no global random numbers."""
    if isinstance(code, type):
        return code.__module__.partition(".")[0] == __name__.partition(".")[0]
    return (code.func if isinstance(code, partial) else code) in COLLATES


def _without_transform(dataset: Garments) -> Any:
    plain = copy.copy(dataset)
    plain.transform = None
    return plain


def _selected(dataset: SelectedGarments) -> tuple[Dataset, UserCode | None]:
    whole, transform = separate_user_code(dataset.whole)
    if transform is None:
        return dataset, None
    plain = _without_transform(dataset)
    plain.whole = whole
    return plain, partial(_transform_selected, transform, dataset)


def _mixed(dataset: MixedDataset) -> tuple[Dataset, UserCode | None]:
    parts = [separate_user_code(part) for part in dataset.datasets]
    if dataset.transform is None and all(transform is None for _, transform in parts):
        return dataset, None
    plain = _without_transform(dataset)
    plain.datasets = tuple(part for part, _ in parts)
    return plain, partial(_transform_mixed, [transform for _, transform in parts], dataset)


def _chained(first: UserCode | None, second: UserCode, item: Any, index: int) -> Any:
    return second(item if first is None else first(item, index), index)


def _transform_selected(transform: UserCode, dataset: SelectedGarments, item: Any, index: int) -> Any:
    return transform(item, int(dataset.positions[index]))


def _transform_mixed(transforms: list[UserCode | None], dataset: MixedDataset, item: Any, index: int) -> Any:
    part, part_index = dataset.source(index)
    transform = transforms[part]
    return dataset._transformed(item if transform is None else transform(item, part_index), index)
