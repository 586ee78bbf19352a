"""Tars of samples, without manifest and index, as other programs see them."""

from collections.abc import Iterable, Mapping
from pathlib import Path

from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import Sample
from gcd_dataset.shards import encode_sample
from gcd_dataset.shards.layout import key_of
from gcd_dataset.shards.tar import END, tar_entry

PICTURES = (".jpg", "view_0.json", "view_1.json")


def write_tar(path: Path, samples: Mapping[str, Mapping[str, bytes]]) -> Path:
    """Write samples, key to members, to a tar."""
    entries = [tar_entry(f"{key}.{name}", data) for key, members in samples.items() for name, data in members.items()]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"".join(entries) + bytes(END))
    return path


def write_shard(folder: Path, samples: Iterable[Sample], number: int = 0) -> tuple[Path, Path]:
    """Write a shard of the split ``train``, and the tar of its pictures."""
    encoded = {sample.key: encode_sample(sample) for sample in samples}
    parts: tuple[dict[str, dict[str, bytes]], ...] = ({}, {})
    for key, members in encoded.items():
        for part, of_pictures in zip(parts, (False, True), strict=True):
            part[key] = {name: data for name, data in members.items() if name.endswith(PICTURES) is of_pictures}
    name = f"train-{number:05d}.tar"
    return write_tar(folder / name, parts[0]), write_tar(folder / "views" / name, parts[1])


def fake_shard(folder: Path, count: int = 3) -> tuple[Path, Path]:
    """A shard of fake garments ``gcd_000000000`` …, and the tar of its pictures."""
    assert key_of(0) == fake_sample(0, 0).key
    return write_shard(folder, (fake_sample(0, index) for index in range(count)))
