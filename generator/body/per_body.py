"""Data derived from a body, kept as long as the body: records are frozen."""

import weakref
from collections.abc import Callable
from functools import wraps
from typing import TypeVar

from gcd_dataset.records import Body

Derived = TypeVar("Derived")


def kept_per_body(compute: Callable[[Body], Derived]) -> Callable[[Body], Derived]:
    """``compute``, called once for each ``Body`` object; its result is dropped with the body."""
    kept: dict[int, tuple[weakref.ref[Body], Derived]] = {}

    @wraps(compute)
    def found(body: Body) -> Derived:
        known = kept.get(id(body))
        if known is not None and known[0]() is body:
            return known[1]
        result, key = compute(body), id(body)
        kept[key] = weakref.ref(body, lambda _: kept.pop(key, None)), result
        return result

    return found
