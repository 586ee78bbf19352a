"""Synthetic garments of the size of a drape at 1 cm, written to shards for all loaders."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import Edge, EdgeRef, Panel, Pattern, Placement, Sample, Seam
from gcd_dataset.shards import ShardWriter, read_manifest

__all__ = ["CONFIGS", "large_sample", "write_shards"]

CONFIGS: Mapping[str, tuple[str, ...]] = {
    "geometry": ("panels", "faces", "uv", "panel_id", "verts"),
    "points": ("panels", "edges", "stitches", "points"),
    "patterns": ("design", "measures", "panels", "edges", "stitches"),
}
"""Configuration to the fields that are read; the shards hold all fields."""

FINENESS = 16  # 14 500 vertices on average: a dress at 1 cm has 14 475
POINTS = 8192
PANELS, CORNERS, SEAMS = 11, 7, 28  # the mean of GarmentCodeData's patterns: 10.9 panels of 6.8 edges, 28 stitches
SHARD = 32  # samples per shard: small, so that every worker of a stream has shards of its own
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
    """Write the first ``count`` garments as shards, unless the folder holds as many. Returns the folder."""
    manifest = read_manifest(folder) if folder.is_dir() else None
    if manifest is None or manifest.counts != {"train": count}:
        with ShardWriter(folder, seed=0, recipe=RECIPE, shard_size=SHARD) as writer:
            for index in range(count):
                writer.write(large_sample(index))
    return folder
