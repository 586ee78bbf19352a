"""Damaged or foreign files of published garments are reported by name."""

import re
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest

from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.loaders import PublishedGarmentCodeData
from gcd_dataset.release.published_names import properties_name
from tests.release.published import BATCH, BODIES, TRAIN, file_of, publish


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return publish(tmp_path_factory.mktemp("folders"))


@pytest.fixture
def own(folders: Path, tmp_path: Path) -> Path:
    """A copy to be damaged."""
    return Path(shutil.copytree(folders, tmp_path / "own"))


def read_first(root: Path) -> None:
    garments = PublishedGarmentCodeData(root, bodies="default")
    assert garments.names[0].endswith(TRAIN[0])
    garments[0]


def without_elements(content: bytes) -> bytes:
    return content.replace(b"element vertex ", b"element ", 1)


def with_number(number: float) -> Callable[[bytes], bytes]:
    def change(content: bytes) -> bytes:
        start = content.index(b"end_header\n") + len(b"end_header\n")
        return content[:start] + struct.pack("<f", number) + content[start + 4 :]

    return change


def with_broken_chunk(content: bytes) -> bytes:
    return content[:33] + b"\0\0\0\0\xc3D\rD" + content[33:]


def of_many_pixels(content: bytes) -> bytes:
    header = b"IHDR" + struct.pack(">IIBBBBB", 60_000, 60_000, 8, 6, 0, 0, 0)
    return content[:8] + struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header)) + content[33:]


def doubling(name: str, times: int) -> bytes:
    """A small YAML file with aliases that expand to 2**times values."""
    lines = [f"l{i + 1}: &l{i + 1} [*l{i}, *l{i}]" for i in range(times)]
    return "\n".join(["l0: &l0 [1]", *lines, f"{name}: {{a: *l{times}}}"]).encode()


@pytest.mark.parametrize(
    ("kind", "change", "told"),
    [
        ("box", without_elements, "not a binary PLY"),
        ("sim", lambda content: b"", "not a binary PLY"),
        ("sim", with_number(float("nan")), "a position coordinate that is over 1e\\+06, or NaN"),
        ("front", with_broken_chunk, "not a picture"),
        ("front", of_many_pixels, "not a picture"),
        ("spec", lambda content: b"[" * 100_000, "Expecting value|levels deep|recursion"),
        ("spec", lambda content: content.replace(b"100", b"1" * 5000, 1), "digits|is not a number"),
        ("spec", lambda content: re.sub(rb'"edge": \d+', b'"edge": 77', content, count=1), "seam 0 joins .*, edge 77"),
        ("design", lambda content: doubling("design", 60), "more than 64 levels deep, or 300000 values"),
        ("design", lambda content: b"design: {a: " + b"[" * 100 + b"]" * 100 + b"}", "more than 64 levels"),
        ("measures", lambda content: b"body: {height: " + b"9" * 5000 + b"}", "not YAML|height is"),
        ("vertex_labels", lambda content: b"a: [99999999]", "is not a list of vertices of the mesh"),
        ("segmentation", lambda content: b"stitch_" + b"9" * 5000 + b"\n" + content, "labels"),
        ("segmentation", lambda content: content.replace(b"stitch_0", b"stitch_" + b"9" * 5000), "names a stitch"),
    ],
)
def test_a_file_of_another_form_is_named(own: Path, kind: str, change: Callable[[bytes], bytes], told: str) -> None:
    path = file_of(own, TRAIN[0], kind)
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(ShardError, match=told) as caught:
        read_first(own)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_an_invalid_body_entry_is_reported(own: Path) -> None:
    path = file_of(own, TRAIN[0], "measures", BODIES[1])
    path.write_bytes(b"body: text")
    with pytest.raises(ShardError, match="body_sample is missing") as caught:
        PublishedGarmentCodeData(own, bodies="random", fields=["meta"])[0]
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize("kept", [b"[" * 100_000, b'{"stamp": STAMP, "fails": ["rand_AAAAAAAAA0"], "facts": {}}'])
def test_invalid_cached_properties_are_made_again(own: Path, kept: bytes) -> None:
    read_first(own)
    (path,) = (own / BATCH / BODIES[0]).glob(".*.gcd.json")
    stamp = re.search(rb"\[[\d, ]+\]", path.read_bytes())
    assert stamp is not None
    path.write_bytes(kept.replace(b"STAMP", stamp[0]))
    read_first(own)


def test_invalid_properties_are_reported(own: Path) -> None:
    path = own / BATCH / BODIES[0] / properties_name(BODIES[0])
    for content in (
        b"[" * 3000,
        b"sim: {stats: {fails: 3}}",
        b"sim: {stats: {fails: {}, fin_frame: {a: x}}}",
        b"\xff",
        b"",
    ):
        path.write_bytes(content)
        with pytest.raises(ShardError, match="not the properties of a batch") as caught:
            read_first(own)
        assert str(caught.value).startswith(f"{path}: ")


def test_the_nearest_split_and_bodies_are_suggested(folders: Path) -> None:
    with pytest.raises(ConfigError, match=r"split='trian': choose from .*: did you mean train\?"):
        PublishedGarmentCodeData(folders, "trian")
    with pytest.raises(ConfigError, match=r"bodies='defualt': choose from .*: did you mean default\?"):
        PublishedGarmentCodeData(folders, bodies="defualt")
