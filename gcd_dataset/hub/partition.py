"""Splits from which a model cannot know what it is tested on: no design, and no body, is in two of them."""

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
"""Shares of the garments, nearly those of GarmentCodeData's official split."""

META, DESIGN, BODY = "meta", "design", "body"  # fields
NEUTRAL = "neutral"  # what a sample calls the body that is nobody's


def partition(reader: ShardReader, shares: Mapping[str, float] = SHARES) -> dict[str, list[int]]:
    """Split to positions of samples in ``reader``, without splits that get none.

    Where a garment goes is decided by its family's designs alone, so that it stays there when the data set grows.
    Raises ``ConfigError`` for shares that are not those of a whole.
    """
    if not shares or min(shares.values()) < 0 or abs(sum(shares.values()) - 1.0) > 1e-6:
        raise ConfigError(f"shares {', '.join(f'{share:g}' for share in shares.values())}: give some that add up to 1")
    family = families(reader)
    chance = _chances(reader, family)
    ends = np.cumsum(list(shares.values()))
    number = np.minimum(np.searchsorted(ends, chance, side="right"), len(ends) - 1)
    wanted = [place for place, share in enumerate(shares.values()) if share > 0]
    for place in wanted:
        # So that a data set of a few designs has all its splits too: the family next to an empty one moves over.
        if not (number == place).any() and len(np.unique(number)) < len(chance) >= len(wanted):
            crowded = np.flatnonzero(np.bincount(number, minlength=len(ends))[number] > 1)
            number[crowded[np.argmin(np.abs(chance[crowded] - ends[place]))]] = place
    chosen = number[family]
    parts = {name: np.flatnonzero(chosen == place).tolist() for place, name in enumerate(shares)}
    return {name: positions for name, positions in parts.items() if positions}


def families(reader: ShardReader) -> Int[np.ndarray, " n"]:
    """Number of the family of each sample: garments that share a design or a body, directly or through others.

    The neutral body, which is nobody's in particular, makes no family, nor do bodies that have no shape.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    design, body = _same(reader, DESIGN), _same(reader, BODY)
    n, designs = len(design), int(design.max()) + 1
    worn = ~np.isin(body, _nobodies(reader, design, body))
    rows = np.concatenate([np.arange(n), np.flatnonzero(worn)])
    columns = np.concatenate([n + design, n + designs + body[worn]])
    size = n + designs + int(body.max()) + 1
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(size, size))
    labels = connected_components(graph, directed=False)[1][:n]
    return np.unique(labels, return_inverse=True)[1]


def leaks(readers: Mapping[str, ShardReader]) -> list[str]:
    """What is in two splits, one line each pair of splits; nothing where all is well.

    Drapes that failed, in split ``failed``, may be of designs of any other.
    """
    told, names = [], [name for name in readers if name != FAILED]
    for place, first in enumerate(names):
        for second in names[place + 1 :]:
            shared = _marks(readers[first], DESIGN) & _marks(readers[second], DESIGN)
            if shared:
                told.append(f"{first} and {second} share {len(shared)} design{'s' if len(shared) > 1 else ''}")
    return told


def _same(reader: ShardReader, field: str) -> Int[np.ndarray, " n"]:
    """A number for each sample, the same where the field's member is the same, by hash and size."""
    return np.unique(_hashes(reader, field), return_inverse=True)[1]


def _hashes(reader: ShardReader, field: str) -> Int[np.ndarray, " n"]:
    members = reader.layout.members
    rows, column = reader.rows(range(len(reader))), members.index(fields_of(members)[field])
    table = reader.index.table
    return table.crc[rows, column].astype(np.int64) << 20 ^ table.size[rows, column].astype(np.int64)


def _marks(reader: ShardReader, field: str) -> set[int]:
    return set(_hashes(reader, field).tolist())


def _nobodies(reader: ShardReader, design: np.ndarray, body: np.ndarray) -> list[int]:
    """Bodies in several designs that are the neutral one, or have no shape."""
    pairs = np.unique(np.stack([body, design]), axis=1)[0]
    shared = np.flatnonzero(np.bincount(pairs) > 1)
    first = {int(number): int(np.flatnonzero(body == number)[0]) for number in shared}
    return [number for number, place in first.items() if _is_nobody(reader.read(place, [FIELDS[META], FIELDS[BODY]]))]


def _is_nobody(members: Mapping[str, Bytes]) -> bool:
    return read_meta(members[FIELDS[META]])["body"] == NEUTRAL or not len(read_npy(members[FIELDS[BODY]]))


def _chances(reader: ShardReader, family: np.ndarray) -> np.ndarray:
    """A number in [0, 1) for each family, from the smallest mark of its designs."""
    marks = _hashes(reader, DESIGN)
    smallest = np.full(int(family.max()) + 1, np.iinfo(np.int64).max)
    np.minimum.at(smallest, family, marks)
    digests = [hashlib.sha256(f"split:{mark}".encode()).digest() for mark in smallest.tolist()]
    return np.array([int.from_bytes(digest[:6], "big") / 2**48 for digest in digests])


def parse_shares(text: str) -> dict[str, float]:
    """``90,5,5`` as shares of train, validation and test. Raises ``ConfigError``."""
    try:
        parts: Sequence[float] = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise ConfigError(f"shares {text!r}: write per cent for train, validation and test: 90,5,5") from error
    if len(parts) != len(SHARES):
        raise ConfigError(f"shares {text!r}: write per cent for train, validation and test: 90,5,5")
    return dict(zip(SHARES, (part / 100 for part in parts), strict=True))
