"""Copies samples of a data set into shards of another."""

from collections.abc import Callable, Sequence
from pathlib import Path

from gcd_dataset.shards.access import writing
from gcd_dataset.shards.growing import GrowingShard, shard_record
from gcd_dataset.shards.index import ShardTable, empty_table, whole_samples
from gcd_dataset.shards.layout import Layout, part_path
from gcd_dataset.shards.manifest import ShardRecord
from gcd_dataset.shards.reader import ShardReader

__all__ = ["copy_shard"]

BATCH = 32  # samples in one read


def copy_shard(
    path: Path, reader: ShardReader, positions: Sequence[int], layout: Layout, on_progress: Callable[[int], None]
) -> tuple[ShardRecord, ShardTable]:
    """Write the samples at ``positions``, with the members of ``layout``, as the shard ``path``; record and table.

    Samples from an interrupted call are kept if their bytes equal the reader's. ``on_progress`` is called with the
    number of bytes added by each step. Raises ``ShardError`` for a damaged sample, ``OutputError`` where the shard
    cannot be written.
    """
    samples = reader.index.table.sample[reader.rows(positions)].tolist()
    if path.exists():
        table = whole_samples(path, layout)
        if table.sample.tolist() == sorted(samples) and _are_copies(table, reader, positions, layout):
            on_progress(int(table.size.sum()))
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
        on_progress(int(shard.table().size.sum()))
        todo = [(position, sample) for position, sample in zip(positions, samples, strict=True) if sample not in done]
        for start in range(0, len(todo), BATCH):
            batch = todo[start : start + BATCH]
            content = reader.read_many([position for position, _ in batch], layout.members)
            for (_, sample), members in zip(batch, content, strict=True):
                shard.append(sample, members)
                on_progress(sum(len(data) for data in members.values()))
        return shard.finish(), shard.table()
    finally:
        shard.close()


def _are_copies(table: ShardTable, reader: ShardReader, positions: Sequence[int], layout: Layout) -> bool:
    """Whether every sample of a shard equals the reader's at one of ``positions``: size and CRC-32 of each member."""
    rows = reader.rows(positions)
    row_of = dict(zip(reader.index.table.sample[rows].tolist(), rows.tolist(), strict=True))
    if not row_of.keys() >= set(table.sample.tolist()):
        return False
    source = reader.index.table[[row_of[sample] for sample in table.sample.tolist()]]
    columns = [reader.layout.members.index(member) for member in layout.members]
    same = (source.crc[:, columns] == table.crc) & (source.size[:, columns] == table.size)
    return bool(same.all())
