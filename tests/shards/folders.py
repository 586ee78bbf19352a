"""Folders and tars of fake garments, their contents, and real sewing patterns."""

import contextlib
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.loaders import fake
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import Outfit, Sample
from gcd_dataset.shards import ShardWriter, encode_sample
from gcd_dataset.shards.layout import garments_layout, is_picture
from gcd_dataset.shards.tar import END, tar_entry

RECIPE = {"fake": True}
SHARD_SIZE = 4


def fill(folder: Path, indices: Iterable[int], *, seed: int = 0, **options: Any) -> Path:
    """Write fake samples to a new folder."""
    return write_samples(folder, (fake_sample(seed, index) for index in sorted(indices)), seed=seed, **options)


def write_samples(folder: Path, samples: Iterable[Sample], **options: Any) -> Path:
    """Write samples to a new folder; ``options``: of the writer."""
    with ShardWriter(folder, **{"seed": 0, "recipe": RECIPE, "shard_size": SHARD_SIZE, **options}) as writer:
        for sample in samples:
            writer.write(sample)
    return folder


def open_writer(folder: Path, *, split: str = "train") -> ShardWriter:
    return ShardWriter(folder, split=split, seed=0, recipe=RECIPE, shard_size=SHARD_SIZE)


def fake_outfit(index: int, count: int, **changes: Any) -> Sample:
    """An outfit of so many skirts; ``changes``: to the sample, and to each garment of what garments have."""
    sample = fake.fake_outfit(0, index, count)
    if sample.outfit is not None:
        own = {name: value for name, value in changes.items() if name in vars(sample.outfit.garments[0])}
        worn = tuple(replace(garment, **own) for garment in sample.outfit.garments)
        changes["outfit"] = Outfit(worn, () if worn[0].drape is None else sample.outfit.layers)
    return replace(sample, **changes)


def fill_outfits(folder: Path, counts: Sequence[int], **changes: Any) -> Path:
    """Write outfits of so many garments to a new folder."""
    outfits = (fake_outfit(index, count, **changes) for index, count in enumerate(counts))
    return write_samples(folder, outfits, layout=garments_layout(garments=max(counts)))


@contextlib.contextmanager
def public_folder() -> Iterator[Path]:
    """A folder that all users can enter, unlike pytest's."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        yield Path(name)


@contextlib.contextmanager
def forbidden(path: Path, mode: int) -> Iterator[None]:
    """Set the permissions of ``path``; as root, also switch to an unprivileged user, since root may read anything."""
    before = path.stat().st_mode
    path.chmod(mode)
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)  # nobody
    try:
        yield
    finally:
        if root:
            os.seteuid(0)
        path.chmod(before)


def contents(folder: Path) -> dict[str, bytes]:
    """Path to content of every file, hidden ones included."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@cache
def patterns(count: int) -> tuple[Sample, ...]:
    """Sewing patterns of all kinds on random bodies."""
    return tuple(produce(3, range(count), MakeConfig(stage="pattern")))


# Tars without manifest and index, as other programs see them.


def write_tar(path: Path, samples: Mapping[str, Mapping[str, bytes]]) -> Path:
    """Write samples, key to members, to a tar."""
    entries = [tar_entry(f"{key}.{name}", data) for key, members in samples.items() for name, data in members.items()]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"".join(entries) + bytes(END))
    return path


def write_shard(folder: Path, samples: Iterable[Sample], number: int = 0) -> tuple[Path, Path]:
    """Write a shard of the split ``train``, and the tar of its pictures."""
    return write_members(folder, {sample.key: encode_sample(sample) for sample in samples}, number)


def write_members(folder: Path, samples: Mapping[str, Mapping[str, bytes]], number: int = 0) -> tuple[Path, Path]:
    """The same, from the members of each key."""
    parts: tuple[dict[str, dict[str, bytes]], ...] = ({}, {})
    for key, members in samples.items():
        for part, of_pictures in zip(parts, (False, True), strict=True):
            part[key] = {name: data for name, data in members.items() if is_picture(name) is of_pictures}
    name = f"train-{number:05d}.tar"
    return write_tar(folder / name, parts[0]), write_tar(folder / "views" / name, parts[1])
