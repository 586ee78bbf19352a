"""Divides a data set into splits that share neither designs nor bodies nor patterns."""

import hashlib
from collections.abc import Mapping
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from gcd_dataset.errors import ConfigError
from gcd_dataset.shards.codec import decode_fields
from gcd_dataset.shards.layout import FAILED, META, Bytes, worn_name
from gcd_dataset.shards.meta import read_meta
from gcd_dataset.shards.reader import ShardReader

SHARES: Mapping[str, float] = {"train": 0.90, "validation": 0.05, "test": 0.05}
"""Split to its share of the garments, close to GarmentCodeData's official split."""

DESIGN = "design.txt"
NEUTRAL = "neutral"  # name of the neutral body in a sample


class Traits(NamedTuple):
    """What connects garments; equal numbers stand for equal designs, bodies, patterns."""

    sample: Int[np.ndarray, " n"]
    """The sample of each garment: an outfit has several."""
    design: Int[np.ndarray, " n"]
    body: Int[np.ndarray, " n"]
    pattern: Int[np.ndarray, " n"]
    is_common: Bool[np.ndarray, " n"]
    """Whether the body is the neutral one, or has no shape weights."""


def partition(reader: ShardReader, shares: Mapping[str, float] = SHARES) -> dict[str, list[int]]:
    """Split to positions of samples in ``reader``, without empty splits.

    The split of a garment depends only on the designs of its family, so it has the same split in a larger data set
    of the same seed.
    Raises ``ConfigError`` for shares that are negative or do not add up to 1.
    """
    if not shares or min(shares.values()) < 0 or abs(sum(shares.values()) - 1.0) > 1e-6:
        raise ConfigError(
            f"shares {', '.join(f'{share:g}' for share in shares.values())}: give shares of 0 or more that add up to 1"
        )
    traits = traits_of(reader)
    family = families(traits)
    chance = _chances(traits.design, family[traits.sample])
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


def families(traits: Traits) -> Int[np.ndarray, " s"]:
    """Family number of each sample: a connected component of the samples that share a design, a body or a pattern.

    The neutral body, and bodies without shape weights, connect no garments. Two designs may give the same pattern on
    one body: they differ in parameters that are not used, such as the sleeves of a strapless bodice.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n, everyone, specific = traits.sample[-1] + 1, np.arange(len(traits.sample)), np.flatnonzero(~traits.is_common)
    nodes, rows, columns = n, [], []
    for trait, garments in ((traits.design, everyone), (traits.body, specific), (traits.pattern, everyone)):
        values, numbers = np.unique(trait, return_inverse=True)
        rows.append(traits.sample[garments])
        columns.append(nodes + numbers[garments])
        nodes += len(values)
    row, column = np.concatenate(rows), np.concatenate(columns)
    graph = coo_array((np.ones(len(row), np.int8), (row, column)), shape=(nodes, nodes))
    labels = connected_components(graph, directed=False)[1][:n]
    return np.unique(labels, return_inverse=True)[1]


def leaks(readers: Mapping[str, ShardReader]) -> list[str]:
    """One line for each pair of splits that share designs. Reads all garments.

    Split ``failed`` is left out: its designs may be in any other split too.
    """
    others = {name: reader for name, reader in readers.items() if name != FAILED}
    designs = {name: set(traits_of(reader).design.tolist()) for name, reader in others.items() if len(others) > 1}
    return [
        f"{first} and {second} share {count} design{'s' if count > 1 else ''}"
        for first, second in combinations(designs, 2)
        if (count := len(designs[first] & designs[second]))
    ]


def traits_of(reader: ShardReader) -> Traits:
    """What connects the samples of a split. Reads all of them."""
    wanted = [member for member in reader.layout.members if member.endswith((META, DESIGN, "pattern.z"))]
    rows = []
    for position, members in enumerate(reader.read_many(range(len(reader)), wanted)):
        meta = read_meta(members[META])
        edges = [worn_name(number, "edges") for number in range(len(meta.get("outfit", [meta])))]
        arrays = decode_fields(members, ["body", *edges])
        hashes = {field: _hash(np.ascontiguousarray(array).data) for field, array in arrays.items()}
        common = not len(arrays["body"]) or meta["body"] == NEUTRAL
        for number, field in enumerate(edges):
            own = _hash(members[worn_name(number, DESIGN)])
            rows.append((position, own, hashes["body"], hashes[field], common))
    sample, design, body, pattern, is_common = np.array(rows, np.int64).T
    return Traits(sample, design, body, pattern, is_common.astype(bool))


def _hash(data: Bytes) -> int:
    return int.from_bytes(hashlib.sha256(data).digest()[:8], "big") >> 1


def _chances(design: Int[np.ndarray, " n"], family: Int[np.ndarray, " n"]) -> np.ndarray:
    """A number in [0, 1) for each family, from the smallest hash of its designs."""
    smallest = np.full(int(family.max()) + 1, np.iinfo(np.int64).max)
    np.minimum.at(smallest, family, design)
    digests = [hashlib.sha256(f"split:{value}".encode()).digest() for value in smallest.tolist()]
    return np.array([int.from_bytes(digest[:6], "big") / 2**48 for digest in digests])


def parse_shares(text: str) -> dict[str, float]:
    """``90,5,5`` as shares of train, validation and test that add up to 1. Raises ``ConfigError``."""
    try:
        return {name: float(part) / 100 for name, part in zip(SHARES, text.split(","), strict=True)}
    except ValueError as error:  # also of zip
        raise ConfigError(f"shares {text!r}: give per cent for train, validation and test: 90,5,5") from error
