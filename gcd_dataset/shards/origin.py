"""How a split was begun, so that only samples of its own kind are added to it."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import gcd_dataset
from gcd_dataset.errors import ConfigError, ShardError
from gcd_dataset.shards.access import reading
from gcd_dataset.shards.index import ShardTable, first_sample, whole_samples
from gcd_dataset.shards.layout import GARMENTS, SCHEMAS, Layout, recipe_hash, shard_number, shards_in
from gcd_dataset.shards.manifest import MANIFEST, Manifest, SplitRecord, read_manifest
from gcd_dataset.shards.meta import read_meta

__all__ = ["agreed", "agreed_with", "require_schema"]

META = 0  # every layout begins with meta.json


def require_schema(folder: Path, split: str, layout: Layout) -> None:
    """Raise ``ConfigError`` for a folder whose samples were written in an earlier schema: they are only read."""
    manifest = read_manifest(folder)
    told = {} if manifest is None else {folder / MANIFEST: manifest.schema}
    with reading(folder):
        parts = [path for path in folder.glob("*.tar.part") if _number(path, split) is not None]
        shards = [*shards_in(folder, split), *sorted(parts)]
    for path in shards[:1]:
        if (first := first_sample(path)) is not None and first[0] in SCHEMAS:
            told[path] = first[0]
    for path, schema in told.items():
        if schema != layout.schema:
            raise ConfigError(
                f"{path}: of schema {schema}, and gcd_dataset {gcd_dataset.__version__} writes schema {layout.schema}: "
                "what is there can be read; make more in another folder"
            )


def agreed(
    folder: Path, split: str, tables: Mapping[str, ShardTable], asked: SplitRecord, layout: Layout = GARMENTS
) -> SplitRecord:
    """The record of a split to go on with: the manifest's, else what its samples tell, else what is asked for.

    ``tables``: the contents of its whole shards. Raises ``ConfigError`` with both sides where they differ from what is
    asked for, in the version of this package too; ``ShardError`` for a broken manifest, or samples of another kind.
    """
    manifest = read_manifest(folder)
    if manifest is not None and (there := agreed_with(manifest, folder / MANIFEST, split, asked)) is not None:
        return there
    shards = {folder / name: table for name, table in tables.items()} | _half_written(folder, split, layout)
    for path, table in shards.items():
        if (table.sample // asked.shard_size != _number(path, split)).any():
            raise ConfigError(f"{path}: its samples are not those of shard_size={asked.shard_size}: give its own")
    for path, table in shards.items():
        if len(table):
            return _same(path, _told_by(path, table, asked), asked)
    return asked


def agreed_with(manifest: Manifest, place: Path | str, split: str, asked: SplitRecord) -> SplitRecord | None:
    """The record of a split in a manifest, to go on with; ``None`` where there is none. ``place`` stands in errors.

    Raises ``ConfigError`` as ``agreed`` does.
    """
    _require_version(place, manifest.generator)
    there = manifest.splits.get(split)
    return None if there is None else _same(place, there, asked)


def _same(place: Path | str, there: SplitRecord, asked: SplitRecord) -> SplitRecord:
    """The record that is there, unless it differs from what is asked for."""
    for name in ("kind", "seed", "shard_size"):
        if getattr(there, name) != getattr(asked, name):
            raise _other(place, name, getattr(there, name), getattr(asked, name))
    for option in sorted(set(there.recipe) | set(asked.recipe)):
        before, now = there.recipe.get(option), asked.recipe.get(option)
        if recipe_hash({option: before}) != recipe_hash({option: now}):
            raise _other(place, option, before, now)
    return there


def _other(place: Path | str, name: str, before: Any, now: Any) -> ConfigError:
    return ConfigError(
        f"{place}: made with {name}={before!r}, asked for {name}={now!r}: use the same or another folder"
    )


def _require_version(place: Path | str, began: str) -> None:
    if began != (now := gcd_dataset.__version__):
        raise ConfigError(
            f"{place}: made by gcd_dataset {began}, and this is {now}: choose another folder, or install {began} to go "
            "on with this one"
        )


def _number(path: Path, split: str) -> int | None:
    """Which shard a file is, whole or half-written."""
    return shard_number(path.name.removesuffix(".part"), split)


def _half_written(folder: Path, split: str, layout: Layout) -> dict[Path, ShardTable]:
    """What is whole in the shards that an earlier writer could not finish."""
    parts = sorted(path for path in folder.glob("*.tar.part") if _number(path, split) is not None)
    return {path: whole_samples(path, layout) for path in parts}


def _told_by(path: Path, table: ShardTable, asked: SplitRecord) -> SplitRecord:
    """How the first sample of a shard was made. Raises ``ConfigError`` for another version of this package."""
    with reading(path), path.open("rb") as file:
        file.seek(int(table.offset[0, META]))
        content = file.read(int(table.size[0, META]))
    try:
        meta = read_meta(content)
        there = replace(asked, seed=meta["seed"], recipe=dict(meta["recipe"]))
        version = meta["versions"]["gcd_dataset"]
    except (ShardError, KeyError) as error:
        raise ShardError(
            f"{path}: its first sample does not say how it was made ({error}): choose another folder"
        ) from error
    _require_version(path, version)
    return there
