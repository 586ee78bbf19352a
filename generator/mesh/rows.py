"""Sets and orders of row numbers, several times as fast as NumPy's for the sizes of meshes."""

import numpy as np
from jaxtyping import Int

WHOLE = 63  # bits of a positive 64-bit integer


def distinct(rows: Int[np.ndarray, "*n"], size: int) -> Int[np.ndarray, " m"]:
    """The different row numbers below ``size``, ascending.

    >>> distinct(np.array([[3, 1], [1, 0]]), 5).tolist()
    [0, 1, 3]
    """
    found = np.zeros(size, bool)
    found[rows] = True
    return np.flatnonzero(found)


def stable_order(keys: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """The order that sorts keys, none below zero; equal ones stay in place.

    >>> stable_order(np.array([7, 2, 7, 0])).tolist()
    [3, 1, 0, 2]
    """
    bits = len(keys).bit_length()
    if int(keys.max(initial=0)).bit_length() + bits > WHOLE:
        return np.argsort(keys, kind="stable")
    places = keys << bits
    places |= np.arange(len(keys))
    places.sort()  # sorting numbers takes half the time of sorting their places
    places &= (1 << bits) - 1
    return places
