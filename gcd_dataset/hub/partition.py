"""Divides a data set into splits that share neither designs nor bodies nor patterns."""

import hashlib
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Int

from gcd_dataset.errors import ConfigError
from gcd_dataset.shards.codec import read_meta
from gcd_dataset.shards.layout import FAILED, FIELDS, Bytes, fields_of
from gcd_dataset.shards.npy import read_npy
from gcd_dataset.shards.reader import ShardReader

__all__ = ["BODY", "DESIGN", "SHARES", "families", "leaks", "parse_shares", "partition"]

SHARES: Mapping[str, float] = {"train": 0.90, "validation": 0.05, "test": 0.05}
"""Split to its share of the garments, close to GarmentCodeData's official split."""

META, DESIGN, BODY, OUTLINES = "meta", "design", "body", "edges"  # fields
NEUTRAL = "neutral"  # name of the neutral body in a sample


def partition(reader: ShardReader, shares: Mapping[str, float] = SHARES) -> dict[str, list[int]]:
    """Split to positions of samples in ``reader``, without empty splits.

    The split of a garment depends only on the designs of its family, so it keeps its split when the data set grows.
    Raises ``ConfigError`` for shares that are negative or do not add up to 1.
    """
    if not shares or min(shares.values()) < 0 or abs(sum(shares.values()) - 1.0) > 1e-6:
        raise ConfigError(
            f"shares {', '.join(f'{share:g}' for share in shares.values())}: give shares of 0 or more that add up to 1"
        )
    family = families(reader)
    chance = _chances(reader, family)
    ends = np.cumsum(list(shares.values()))
    number = np.minimum(np.searchsorted(ends, chance, side="right"), len(ends) - 1)
    wanted = [split for split, share in enumerate(shares.values()) if share > 0]
    for split in wanted:
        # In a data set of few designs: fill an empty split with the family nearest to the end of its interval.
        if not (number == split).any() and len(np.unique(number)) < len(chance) >= len(wanted):
            movable = np.flatnonzero(np.bincount(number, minlength=len(ends))[number] > 1)
            number[movable[np.argmin(np.abs(chance[movable] - ends[split]))]] = split
    chosen = number[family]
    parts = {name: np.flatnonzero(chosen == split).tolist() for split, name in enumerate(shares)}
    return {name: positions for name, positions in parts.items() if positions}


def families(reader: ShardReader) -> Int[np.ndarray, " n"]:
    """Family number of each sample: the connected components of garments that share a design, a body or a pattern.

    The neutral body, and bodies without shape weights, connect no garments. Two designs may give the same pattern on
    one body: they differ in parameters that are not used, such as the sleeves of a strapless bodice.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    design, body = _numbered(reader, DESIGN), _numbered(reader, BODY)
    n, designs = len(design), int(design.max()) + 1
    connects = ~np.isin(body, _unspecific_bodies(reader, design, body))
    # A data set downloaded in part may have no outlines.
    pattern = _numbered(reader, OUTLINES) if OUTLINES in fields_of(reader.layout.members) else np.arange(n)
    bodies = int(body.max()) + 1
    rows = np.concatenate([np.arange(n), np.flatnonzero(connects), np.arange(n)])
    columns = np.concatenate([n + design, n + designs + body[connects], n + designs + bodies + pattern])
    size = n + designs + bodies + int(pattern.max()) + 1
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(size, size))
    labels = connected_components(graph, directed=False)[1][:n]
    return np.unique(labels, return_inverse=True)[1]


def leaks(readers: Mapping[str, ShardReader]) -> list[str]:
    """One line for each pair of splits that share designs.

    Split ``failed`` is left out: its designs may be in any other split too.
    """
    problems, names = [], [name for name in readers if name != FAILED]
    for number, first in enumerate(names):
        for second in names[number + 1 :]:
            shared = set(_hashes(readers[first], DESIGN).tolist()) & set(_hashes(readers[second], DESIGN).tolist())
            if shared:
                problems.append(f"{first} and {second} share {len(shared)} design{'s' if len(shared) > 1 else ''}")
    return problems


def _numbered(reader: ShardReader, field: str) -> Int[np.ndarray, " n"]:
    """A number for each sample, equal where the field's members have equal CRC-32 and size."""
    return np.unique(_hashes(reader, field), return_inverse=True)[1]


def _hashes(reader: ShardReader, field: str) -> Int[np.ndarray, " n"]:
    members = reader.layout.members
    rows, column = reader.rows(range(len(reader))), members.index(fields_of(members)[field])
    table = reader.index.table
    return table.crc[rows, column].astype(np.int64) << 20 ^ table.size[rows, column].astype(np.int64)


def _unspecific_bodies(reader: ShardReader, design: np.ndarray, body: np.ndarray) -> list[int]:
    """Numbers of the bodies without shape weights, or neutral, among the bodies with several designs."""
    pairs = np.unique(np.stack([body, design]), axis=1)[0]
    shared = np.flatnonzero(np.bincount(pairs) > 1)
    first = {int(number): int(np.flatnonzero(body == number)[0]) for number in shared}
    return [
        number
        for number, position in first.items()
        if _is_unspecific(reader.read(position, [FIELDS[META], FIELDS[BODY]]))
    ]


def _is_unspecific(members: Mapping[str, Bytes]) -> bool:
    return read_meta(members[FIELDS[META]])["body"] == NEUTRAL or not len(read_npy(members[FIELDS[BODY]]))


def _chances(reader: ShardReader, family: np.ndarray) -> np.ndarray:
    """A number in [0, 1) for each family, from the smallest hash of its designs."""
    hashes = _hashes(reader, DESIGN)
    smallest = np.full(int(family.max()) + 1, np.iinfo(np.int64).max)
    np.minimum.at(smallest, family, hashes)
    digests = [hashlib.sha256(f"split:{value}".encode()).digest() for value in smallest.tolist()]
    return np.array([int.from_bytes(digest[:6], "big") / 2**48 for digest in digests])


def parse_shares(text: str) -> dict[str, float]:
    """``90,5,5`` as shares of train, validation and test that add up to 1. Raises ``ConfigError``."""
    try:
        parts: Sequence[float] = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise ConfigError(f"shares {text!r}: give per cent for train, validation and test: 90,5,5") from error
    if len(parts) != len(SHARES):
        raise ConfigError(f"shares {text!r}: give per cent for train, validation and test: 90,5,5")
    return dict(zip(SHARES, (part / 100 for part in parts), strict=True))
