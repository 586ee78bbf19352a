"""Foreign tars in a repository: found by name, and read through once to see what lies in them."""

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
    """The index of foreign tars of a split; kept with the small files of the site.

    Raises ``ShardError`` for a site without any, or with a damaged one.
    """
    names = foreign_shards(site.names, split)
    if not names:
        raise ShardError(f"{site.source}: no tars of split {split}: give a repository of shards")
    log.info("%s: no index: all of its %d tars are read through, once", site.source, len(names))
    archives, lengths = {}, []
    for name in names:
        scanned = json.loads(site.cached(safe_name(f"{name}.json"), partial(_scan, site, name)))
        archives[name] = [ForeignSample(key, {m: tuple(p) for m, p in content.items()}) for key, content in scanned[1:]]
        lengths.append(scanned[0])
    return foreign_index(archives, lengths)


def _scan(site: Site, name: str) -> bytes:
    """Length and samples of a tar, as JSON."""
    counted = _Counted(site, name)
    try:
        samples = [[sample.key, dict(sample.members)] for sample in samples_of(cast(BinaryIO, counted))]
        counted.read_all()
    except ShardError as error:
        raise ShardError(f"{site.source}/{shown(name)}: {error}: tell its maker, or choose another") from error
    return json.dumps([counted.length, *samples]).encode()


class _Counted:
    """A file of a site that is read from its beginning, and how much of it has been read."""

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
