"""Checks that a writer continues a split with the seed, recipe, shard size, schema and version it was started with."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import gcd_dataset
from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.index import ShardTable, first_sample_format, whole_samples
from gcd_dataset.shards.layout import GARMENTS, SCHEMA, Layout, recipe_hash, shard_number, shards_in
from gcd_dataset.shards.manifest import MANIFEST, Manifest, SplitRecord, read_manifest
from gcd_dataset.shards.meta import read_meta

__all__ = ["manifest_record_to_resume", "record_to_resume", "require_schema"]

META = 0  # every layout begins with meta.json


def require_schema(folder: Path, split: str, layout: Layout) -> None:
    """Raise ``ConfigError`` for a folder with samples of an earlier schema, which are read-only."""
    manifest = read_manifest(folder)
    schemas = {} if manifest is None else {folder / MANIFEST: manifest.schema}
    with reading(folder):
        parts = [path for path in folder.glob("*.tar.part") if _number(path, split) is not None]
        shards = [*shards_in(folder, split), *sorted(parts)]
    for path in shards[:1]:
        if (first := first_sample_format(path)) is not None and first[0] == SCHEMA:
            schemas[path] = first[0]
    for path, schema in schemas.items():
        if schema != layout.schema:
            raise ConfigError(
                f"{path}: of schema {schema}, but gcd_dataset {gcd_dataset.__version__} writes schema {layout.schema}: "
                "its samples can be read; write new ones to another folder"
            )


def record_to_resume(
    folder: Path, split: str, tables: Mapping[str, ShardTable], requested: SplitRecord, layout: Layout = GARMENTS
) -> SplitRecord:
    """The record of a split to continue: from the manifest, else from the first sample, else ``requested``.

    ``tables``: tables of the finished shards. Raises ``ConfigError`` with both values where the record differs from
    ``requested``, or the version of this package has changed; ``ShardError`` for a broken manifest or sample.
    """
    manifest = read_manifest(folder)
    if manifest is not None:
        existing = manifest_record_to_resume(manifest, folder / MANIFEST, split, requested)
        if existing is not None:
            return existing
    shards = {folder / name: table for name, table in tables.items()} | _unfinished_shards(folder, split, layout)
    for path, table in shards.items():
        if (table.sample // requested.shard_size != _number(path, split)).any():
            raise ConfigError(f"{path}: not written with shard_size={requested.shard_size}: give its own shard_size")
    for path, table in shards.items():
        if len(table):
            return _require_same(path, _record_of_sample(path, table, requested), requested)
    return requested


def manifest_record_to_resume(
    manifest: Manifest, location: Path | str, split: str, requested: SplitRecord
) -> SplitRecord | None:
    """The record of a split in a manifest; ``None`` where there is none. ``location``: the manifest, for messages.

    Raises ``ConfigError`` as ``record_to_resume`` does.
    """
    _require_version(location, manifest.generator)
    existing = manifest.splits.get(split)
    return None if existing is None else _require_same(location, existing, requested)


def _require_same(location: Path | str, existing: SplitRecord, requested: SplitRecord) -> SplitRecord:
    """``existing``. Raises ``ConfigError`` where kind, seed, shard size or recipe differ from ``requested``."""
    for name in ("kind", "seed", "shard_size"):
        if getattr(existing, name) != getattr(requested, name):
            raise _difference(location, name, getattr(existing, name), getattr(requested, name))
    for option in sorted(set(existing.recipe) | set(requested.recipe)):
        before, now = existing.recipe.get(option), requested.recipe.get(option)
        if recipe_hash({option: before}) != recipe_hash({option: now}):
            raise _difference(location, option, before, now)
    return existing


def _difference(location: Path | str, name: str, before: Any, now: Any) -> ConfigError:
    return ConfigError(
        f"{location}: made with {name}={before!r}, asked for {name}={now!r}: use the same or another folder"
    )


def _require_version(location: Path | str, version: str) -> None:
    if version != (now := gcd_dataset.__version__):
        raise ConfigError(
            f"{location}: made by gcd_dataset {version}, but this is {now}: choose another folder, or install "
            f"{version} to continue this one"
        )


def _number(path: Path, split: str) -> int | None:
    """The number of a finished or unfinished shard; ``None`` for any other file."""
    return shard_number(path.name.removesuffix(".part"), split)


def _unfinished_shards(folder: Path, split: str, layout: Layout) -> dict[Path, ShardTable]:
    """``.part`` file to the table of its whole samples."""
    parts = sorted(path for path in folder.glob("*.tar.part") if _number(path, split) is not None)
    return {path: whole_samples(path, layout) for path in parts}


def _record_of_sample(path: Path, table: ShardTable, requested: SplitRecord) -> SplitRecord:
    """Seed and recipe of the first sample of a shard. Raises ``ConfigError`` for another version of this package."""
    with reading(path), path.open("rb") as file:
        file.seek(int(table.offset[0, META]))
        content = file.read(int(table.size[0, META]))
    try:
        meta = read_meta(content)
        existing = replace(requested, seed=meta["seed"], recipe=dict(meta["recipe"]))
        version = meta["versions"]["gcd_dataset"]
    except (ShardError, KeyError) as error:
        raise ShardError(
            f"{path}: its first sample does not hold seed, recipe and versions ({error}): choose another folder"
        ) from error
    _require_version(path, version)
    return existing
