"""The index of foreign tars in a repository: found by name, then scanned once."""

import io
import json
import logging
from functools import partial
from typing import BinaryIO, cast

from gcd_dataset.errors import ShardError, shown
from gcd_dataset.hub.site import Site
from gcd_dataset.names import safe_name
from gcd_dataset.shards.foreign import ForeignSample, foreign_index, foreign_shards, samples_of
from gcd_dataset.shards.index import ShardIndex

__all__ = ["read_foreign_index"]

log = logging.getLogger(__name__)


def read_foreign_index(site: Site, split: str) -> ShardIndex:
    """The index of the foreign tars of a split; cached with the small files of the site.

    Raises ``ShardError`` for a site without tars of the split, or with a damaged one.
    """
    names = foreign_shards(site.names, split)
    if not names:
        raise ShardError(f"{site.source}: no tars of split {split}: give a repository of shards")
    log.info("%s: no index: scanning its %d tars, once", site.source, len(names))
    archives, lengths = {}, []
    for name in names:
        scanned = json.loads(site.cached(safe_name(f"{name}.json"), partial(_scan, site, name)))
        archives[name] = [
            ForeignSample(key, {member: tuple(location) for member, location in members.items()})
            for key, members in scanned[1:]
        ]
        lengths.append(scanned[0])
    return foreign_index(archives, lengths)


def _scan(site: Site, name: str) -> bytes:
    """Length [bytes] and samples of a tar, as JSON. Raises ``ShardError``."""
    counted = _CountingReader(site, name)
    try:
        samples = [[sample.key, dict(sample.members)] for sample in samples_of(cast(BinaryIO, counted))]
        counted.read_all()
    except ShardError as error:
        raise ShardError(
            f"{site.source}/{shown(name)}: {error}: tell its publisher, or choose another repository"
        ) from error
    return json.dumps([counted.length, *samples]).encode()


class _CountingReader:
    """A file of a site, read from its first byte on; ``length`` counts the bytes read."""

    def __init__(self, site: Site, name: str) -> None:
        self._pieces, self._rest = site.web.pieces(name), io.BytesIO()
        self.length = 0

    def read(self, size: int) -> bytes:
        content = self._rest.read(size)
        if not content:
            self._rest = io.BytesIO(next(self._pieces, b""))
            content = self._rest.read(size)
        self.length += len(content)
        return content

    def read_all(self) -> None:
        while self.read(1 << 20):
            pass
