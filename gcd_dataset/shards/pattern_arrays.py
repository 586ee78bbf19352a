"""The patterns of a split as arrays, and nothing else of its samples."""

from collections.abc import Container, Iterator

from gcd_dataset.errors import ConfigError
from gcd_dataset.shards.codec import decode_field
from gcd_dataset.shards.layout import FIELDS, fields_of
from gcd_dataset.shards.reader import ShardReader
from gcd_dataset.tensors import PatternTensor

__all__ = ["stored_patterns"]

WANTED = ("meta", "panels", "edges", "stitches")  # fields
TOGETHER = 256  # samples that are asked for at once


def stored_patterns(reader: ShardReader, of: Container[int] | None = None) -> Iterator[tuple[int, PatternTensor]]:
    """Index and pattern of each sample, in order; ``of``: the indices of those that are wanted.

    Raises ``ShardError`` with shard and sample for a damaged one, ``ConfigError`` for samples without patterns.
    """
    if missing := [field for field in WANTED if field not in fields_of(reader.layout.members)]:
        raise ConfigError(f"{reader.store.place()}: its samples have no {missing[0]}: bring the whole of them")
    wanted = [position for position in range(len(reader)) if of is None or reader.number(position) in of]
    for first in range(0, len(wanted), TOGETHER):
        positions = wanted[first : first + TOGETHER]
        for position, members in zip(
            positions, reader.read_many(positions, [FIELDS[field] for field in WANTED]), strict=True
        ):
            with reader.naming(position):
                field = {name: decode_field(name, members) for name in WANTED}
            meta = field["meta"]
            yield (
                reader.number(position),
                PatternTensor(
                    panels=field["panels"],
                    edges=field["edges"],
                    stitches=field["stitches"],
                    panel_names=tuple(meta["panel_names"]),
                    panel_labels=tuple(meta["panel_labels"]),
                    edge_labels=tuple(meta["edge_labels"]),
                    name=meta["key"],
                ),
            )
