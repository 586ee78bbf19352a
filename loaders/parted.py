"""A data set in two parts: one that only reads or makes garments, and what users have put on top of it.

The first may run anywhere and at any time, in a thread beside the training too. The second is code of others, which
may draw from random numbers that the training draws from: it runs in the thread that trains, or in a worker process.
"""

import copy
from collections.abc import Callable
from functools import partial
from typing import Any, TypeAlias

from torch.utils.data import Dataset

from gcd_dataset.loaders.base import Garments, SelectedGarments
from gcd_dataset.loaders.collate import collate_list, collate_packed, collate_padded
from gcd_dataset.loaders.mixed import MixedDataset
from gcd_dataset.loaders.transforms import Augmented

__all__ = ["Change", "is_ours", "parted"]

Change: TypeAlias = Callable[[Any, int], Any]
"""Item and its number to what the data set gives."""

COLLATES = (collate_list, collate_packed, collate_padded)


def parted(dataset: Dataset) -> tuple[Dataset, Change | None]:
    """A data set that gives items without transforms, and what makes of such an item the one of ``dataset``.

    A data set of others' making is all theirs, and stays as it is. ``None``: there is nothing to do.
    """
    if isinstance(dataset, SelectedGarments):
        return _selected(dataset)
    if isinstance(dataset, Augmented):
        whole, before = parted(dataset.whole)
        return whole, partial(_after, before, dataset._changed)
    if isinstance(dataset, MixedDataset):
        return _mixed(dataset)
    if isinstance(dataset, Garments) and is_ours(type(dataset)) and dataset.transform is not None:
        return _without(dataset), dataset._transformed
    return dataset, None


def is_ours(code: Any) -> bool:
    """Whether a class or a ``collate_fn`` is of this package: it draws no random numbers but its own."""
    if isinstance(code, type):
        return code.__module__.partition(".")[0] == __name__.partition(".")[0]
    return (code.func if isinstance(code, partial) else code) in COLLATES


def _without(dataset: Garments) -> Any:
    plain = copy.copy(dataset)
    plain.transform = None
    return plain


def _selected(dataset: SelectedGarments) -> tuple[Dataset, Change | None]:
    whole, change = parted(dataset.whole)
    if change is None:
        return dataset, None
    plain = _without(dataset)
    plain.whole = whole
    return plain, partial(_of_whole, change, dataset)


def _mixed(dataset: MixedDataset) -> tuple[Dataset, Change | None]:
    parts = [parted(part) for part in dataset.datasets]
    if dataset.transform is None and all(change is None for _, change in parts):
        return dataset, None
    plain = _without(dataset)
    plain.datasets = tuple(part for part, _ in parts)
    return plain, partial(_of_parts, [change for _, change in parts], dataset)


def _after(before: Change | None, change: Change, item: Any, number: int) -> Any:
    return change(item if before is None else before(item, number), number)


def _of_whole(change: Change, dataset: SelectedGarments, item: Any, number: int) -> Any:
    return change(item, int(dataset.positions[number]))


def _of_parts(changes: list[Change | None], dataset: MixedDataset, item: Any, number: int) -> Any:
    part, place = dataset.source(number)
    change = changes[part]
    return dataset._transformed(item if change is None else change(item, place), number)
