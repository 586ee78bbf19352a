"""Samples copied from one data set into the shards of another."""

from collections.abc import Callable, Sequence
from pathlib import Path

from gcd_dataset.shards.access import writing
from gcd_dataset.shards.growing import GrowingShard, shard_record
from gcd_dataset.shards.index import ShardTable, empty_table, scan_shard
from gcd_dataset.shards.layout import Layout
from gcd_dataset.shards.manifest import ShardRecord
from gcd_dataset.shards.reader import ShardReader

__all__ = ["copy_shard"]

BATCH = 32  # samples that are read together


def copy_shard(
    path: Path, reader: ShardReader, positions: Sequence[int], layout: Layout, tell: Callable[[int], None]
) -> tuple[ShardRecord, ShardTable]:
    """The samples at these positions as a shard of ``layout``'s members; gone on with where an earlier call was left.

    ``tell``: called with the bytes that each step has added. Raises ``ShardError`` for a sample that is not what was
    written, ``OutputError`` where the shard cannot be.
    """
    samples = reader.index.table.sample[reader.rows(positions)].tolist()
    if path.exists():
        table = scan_shard(path, layout)
        if table.sample.tolist() == sorted(samples):
            tell(int(table.size.sum()))
            return shard_record(path, table), table
        with writing(path):
            path.unlink()
    shard = GrowingShard(path, empty_table(layout), layout)
    try:
        done = set(shard.table().sample.tolist())
        tell(int(shard.table().size.sum()))
        todo = [(place, sample) for place, sample in zip(positions, samples, strict=True) if sample not in done]
        for start in range(0, len(todo), BATCH):
            batch = todo[start : start + BATCH]
            content = reader.read_many([place for place, _ in batch], layout.members)
            for (_, sample), members in zip(batch, content, strict=True):
                shard.append(sample, members)
                tell(sum(len(data) for data in members.values()))
        return shard.finish(), shard.table()
    finally:
        shard.release()
