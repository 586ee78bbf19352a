"""Samples copied from one data set into the shards of another."""

from collections.abc import Callable, Sequence
from pathlib import Path

from gcd_dataset.shards.access import writing
from gcd_dataset.shards.growing import GrowingShard, shard_record
from gcd_dataset.shards.index import ShardTable, empty_table, whole_samples
from gcd_dataset.shards.layout import Layout, part_path
from gcd_dataset.shards.manifest import ShardRecord
from gcd_dataset.shards.reader import ShardReader

__all__ = ["copy_shard"]

BATCH = 32  # samples that are read together


def copy_shard(
    path: Path, reader: ShardReader, positions: Sequence[int], layout: Layout, tell: Callable[[int], None]
) -> tuple[ShardRecord, ShardTable]:
    """The samples at these positions as a shard of ``layout``'s members; gone on with where an earlier call was left.

    What it left is read through, and taken if it is what ``reader`` has, byte for byte. ``tell``: called with the bytes
    that each step has added. Raises ``ShardError`` for a sample that is not what was written, ``OutputError`` where the
    shard cannot be.
    """
    samples = reader.index.table.sample[reader.rows(positions)].tolist()
    if path.exists():
        table = whole_samples(path, layout)
        if table.sample.tolist() == sorted(samples) and _are_copies(table, reader, positions, layout):
            tell(int(table.size.sum()))
            return shard_record(path, table), table
        with writing(path):
            path.unlink()
    part = part_path(path)
    if part.exists() and not _are_copies(whole_samples(part, layout), reader, positions, layout):
        with writing(part):
            part.unlink()
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


def _are_copies(table: ShardTable, reader: ShardReader, positions: Sequence[int], layout: Layout) -> bool:
    """Whether all samples of a shard are among those at these positions, by size and CRC-32 of their members."""
    rows = reader.rows(positions)
    row_of = dict(zip(reader.index.table.sample[rows].tolist(), rows.tolist(), strict=True))
    if not row_of.keys() >= set(table.sample.tolist()):
        return False
    theirs = reader.index.table[[row_of[sample] for sample in table.sample.tolist()]]
    columns = [reader.layout.members.index(member) for member in layout.members]
    same = (theirs.crc[:, columns] == table.crc) & (theirs.size[:, columns] == table.size)
    return bool(same.all())
