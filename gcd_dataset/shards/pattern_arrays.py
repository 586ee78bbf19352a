"""Reads the patterns of a split as arrays, without the other members."""

from collections.abc import Container, Iterator, Mapping
from typing import TYPE_CHECKING

from gcd_dataset.errors import ConfigError
from gcd_dataset.shards.codec import decode_fields
from gcd_dataset.shards.layout import Bytes, fields_of, members_of
from gcd_dataset.tensors import PatternTensor

if TYPE_CHECKING:
    from gcd_dataset.shards.reader import ShardReader


PATTERN_FIELDS = ("meta", "panels", "edges", "stitches")
BATCH = 256  # samples in one read


def stored_patterns(reader: "ShardReader", of: Container[int] | None = None) -> Iterator[tuple[int, PatternTensor]]:
    """Index and pattern of each sample in order; ``of``: indices to read, by default all.

    Raises ``ShardError`` naming shard and sample for a damaged sample, ``ConfigError`` for samples without patterns.
    """
    if missing := [field for field in PATTERN_FIELDS if field not in fields_of(reader.layout.members)]:
        raise ConfigError(
            f"{reader.store.location()}: its samples have no {missing[0]}: give a data set with all fields"
        )
    wanted = [position for position in range(len(reader)) if of is None or reader.number(position) in of]
    for first in range(0, len(wanted), BATCH):
        positions = wanted[first : first + BATCH]
        for position, members in zip(positions, reader.read_many(positions, members_of(PATTERN_FIELDS)), strict=True):
            with reader.naming(position):
                pattern = stored_pattern(members)
            yield reader.number(position), pattern


def stored_pattern(members: Mapping[str, Bytes]) -> PatternTensor:
    """The pattern of an encoded garment. Raises ``ShardError``."""
    field = decode_fields(members, PATTERN_FIELDS)
    meta = field["meta"]
    return PatternTensor(
        panels=field["panels"],
        edges=field["edges"],
        stitches=field["stitches"],
        panel_names=tuple(meta["panel_names"]),
        panel_labels=tuple(meta["panel_labels"]),
        edge_labels=tuple(meta["edge_labels"]),
        name=meta["key"],
    )
