"""Synthetic garments of the size of a drape at 1 cm, written to shards for all loaders."""

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import Edge, EdgeRef, Panel, Pattern, Placement, Sample, Seam
from gcd_dataset.shards import ShardWriter, encode_sample
from gcd_dataset.shards.index import GRADES, OUTCOMES, SplitIndex, index_name
from gcd_dataset.shards.layout import MEMBERS, is_picture, member_name
from gcd_dataset.shards.manifest import MANIFEST, Manifest, Plan, ShardRecord, SplitRecord
from gcd_dataset.shards.tar import BLOCK, END, tar_entry

CONFIGS: Mapping[str, tuple[str, ...]] = {
    "geometry": ("panels", "faces", "uv", "panel_id", "verts"),
    "points": ("panels", "edges", "stitches", "points"),
    "patterns": ("panels", "edges", "stitches"),
}
"""Configuration to the fields that are read; the shards hold all fields."""

FINENESS = 16  # 14 500 vertices on average: a dress at 1 cm has 14 475
POINTS = 8192
PANELS, CORNERS, SEAMS = 11, 7, 28  # the mean of GarmentCodeData's patterns: 10.9 panels of 6.8 edges, 28 stitches
SHARD = 32  # samples per shard: small, so that every worker of a stream has shards of its own
LARGE_SHARD, SAMPLE = 128, 130_048  # samples of a shard of a large data set; bytes of a sample
RECIPE = {"fake": True, "fineness": FINENESS}


def large_sample(index: int) -> Sample:
    """A finely meshed tube with a patchwork as its pattern."""
    sample = fake_sample(0, index, fineness=FINENESS, points=POINTS)
    assert sample.box_mesh is not None
    names = tuple(f"panel_{i}" for i in range(PANELS))
    patch = np.arange(len(sample.box_mesh.faces)) * PANELS // len(sample.box_mesh.faces)
    mesh = replace(sample.box_mesh, panel_id=patch, panel_names=names, panel_labels=PANELS * ("body",))
    return replace(
        sample, pattern=_patchwork(sample.key, names), box_mesh=replace(mesh, labels={}, seams=mesh.seams[:0])
    )


def _patchwork(name: str, names: tuple[str, ...]) -> Pattern:
    """Regular polygons, sewn together edge by edge."""
    angle = 2 * np.pi * np.arange(CORNERS) / CORNERS
    corners = 20 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    edges = tuple(Edge(i, (i + 1) % CORNERS) for i in range(CORNERS))
    still = np.zeros(3)
    panels = tuple(
        Panel(panel, corners, edges, Placement(np.array([40.0 * i, 0, 0]), still)) for i, panel in enumerate(names)
    )
    sides = [EdgeRef(panel, edge) for edge in range(CORNERS) for panel in names]
    seams = tuple(Seam(left, right) for left, right in zip(sides[::2], sides[1::2], strict=False))
    return Pattern(name, panels, seams[:SEAMS])


def write_shards(folder: Path, count: int) -> Path:
    """Write the first ``count`` garments as shards. Returns the folder."""
    with ShardWriter(folder, seed=0, recipe=RECIPE, shard_size=SHARD) as writer:
        for index in range(count):
            writer.write(large_sample(index))
    return folder


def write_large_index(folder: Path, count: int) -> int:
    """Write manifest and index of ``count`` samples, of which the first alone exists; bytes of the index."""
    folder.mkdir(parents=True, exist_ok=True)
    shards = tuple(
        ShardRecord(number, min(LARGE_SHARD, count - first), SAMPLE * LARGE_SHARD + END, f"{number:064x}")
        for number, first in enumerate(range(0, count, LARGE_SHARD))
    )
    for shard in shards:
        with (folder / shard.name("train")).open("wb") as file:
            file.truncate(shard.size)  # takes no room
    members = encode_sample(fake_sample(0, 0))
    first = b"".join(tar_entry(member_name(0, name), data) for name, data in members.items() if not is_picture(name))
    with (folder / shards[0].name("train")).open("r+b") as file:
        file.write(first)
    plan = Plan("garments", 0, {"stage": "drape", "points": POINTS}, count, LARGE_SHARD)
    record = SplitRecord(plan, shards, tuple(member for member in MEMBERS if not is_picture(member)))
    random, numbers = np.random.default_rng(0), np.arange(count, dtype=np.int32)
    blocks = numbers % LARGE_SHARD * (SAMPLE // BLOCK) + random.integers(0, SAMPLE // BLOCK - 1, count, np.int32)
    blocks[:2] = 0, len(first) // BLOCK
    grades = random.choice([GRADES.index("clean"), GRADES.index("paper")], count, p=[0.98, 0.02]).astype(np.uint8)
    outcomes = np.full(count, OUTCOMES.index("SETTLED"), np.uint8)
    index = SplitIndex(record, numbers, blocks.astype(np.int32), np.zeros(0, np.int32), grades, outcomes).to_bytes()
    record = replace(record, index_sha256=hashlib.sha256(index).hexdigest())
    (folder / index_name("train")).write_bytes(index)
    (folder / MANIFEST).write_bytes(Manifest({"train": record}).to_bytes())
    return len(index)
