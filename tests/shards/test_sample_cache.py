"""A cache of single samples, shared by processes; damaged samples are reported once, then made again."""

import os
from collections.abc import Mapping
from pathlib import Path

import pytest

from gcd_dataset.errors import ShardError
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.loaders.generated import SampleCache
from gcd_dataset.shards import encode_sample
from gcd_dataset.shards.layout import Bytes

MEMBERS = encode_sample(fake_sample(0, 7))


def contents(members: Mapping[str, Bytes] | None) -> dict[str, bytes]:
    return {name: bytes(data) for name, data in (members or {}).items()}


def test_samples_are_read_back_in_any_process(tmp_path: Path) -> None:
    cache = SampleCache(tmp_path)
    assert cache.read(7) is None
    children = []
    for _ in range(2):
        if (child := os.fork()) == 0:
            cache.keep(7, MEMBERS)
            os._exit(0)
        children.append(child)
    assert all(os.waitpid(child, 0)[1] == 0 for child in children)
    assert contents(cache.read(7)) == MEMBERS
    assert contents(cache.read(7, ["verts.z"])) == {"verts.z": MEMBERS["verts.z"]}
    assert [path.name for path in tmp_path.rglob("*.*")] == ["gcd_000000007.tar"]


@pytest.mark.parametrize("place", [600, 40_000, -3000])
def test_a_damaged_sample_is_reported_and_made_again(place: int, tmp_path: Path) -> None:
    cache = SampleCache(tmp_path)
    cache.keep(7, MEMBERS)
    [path] = tmp_path.rglob("*.tar")
    content = bytearray(path.read_bytes())
    content[place % len(content)] ^= 1
    path.write_bytes(content)
    with pytest.raises(ShardError, match=r"gcd_000000007\.tar: damaged"):
        cache.read(7)
    assert cache.read(7) is None
    cache.keep(7, MEMBERS)
    assert contents(cache.read(7)) == MEMBERS
