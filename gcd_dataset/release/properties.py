"""Reads ``dataset_properties_default_body.yaml``: failures and simulation counts of the garments of a batch.

``PublishedGarments`` leaves failed garments out, even if their folders exist. Parsing a file of 5,000 garments takes
seconds, so an extract is cached.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import yaml

from gcd_dataset.errors import ShardError
from gcd_dataset.release.file_cache import cache_path, file_stamp, write_cache
from gcd_dataset.release.published_names import REMEDY
from gcd_dataset.shards.access import read_file
from gcd_dataset.yamlfile import PlainLoader, require_shallow

SCHEMA = 1
COUNTS = {"frames": "fin_frame", "self_crossings": "self_collisions", "body_crossings": "body_collisions"}


@dataclass(frozen=True)
class Facts:
    """Simulation counts of one garment; -1 for a missing count."""

    frames: int = -1
    self_crossings: int = -1
    body_crossings: int = -1


@dataclass(frozen=True)
class Properties:
    """The extract of a properties file."""

    fails: Mapping[str, str] = field(default_factory=dict)
    """Failed garment to the class of its failure."""
    facts: Mapping[str, Facts] = field(default_factory=dict)
    """Simulated garment to its counts."""


def read_properties(path: Path, cache_dir: Path | None) -> Properties:
    """The properties of a batch. Raises ``ShardError`` for a broken file, ``OutputError`` for an unwritable cache."""
    stamp, cache = [SCHEMA, *file_stamp(path)], cache_path(path, cache_dir, ".json")
    cached = _read_cache(cache, stamp)
    if cached is not None:
        return cached
    properties = _parsed(path)
    write_cache(cache, json.dumps({"stamp": stamp} | asdict(properties), separators=(",", ":")).encode())
    return properties


def _read_cache(path: Path, stamp: list[int]) -> Properties | None:
    """The cached extract; ``None`` if it is missing or broken, or describes another file."""
    try:
        entry = json.loads(path.read_bytes())
        if entry["stamp"] != stamp:
            return None
        fails = {name: str(kind) for name, kind in entry["fails"].items()}
        facts = {name: Facts(**{key: int(count) for key, count in f.items()}) for name, f in entry["facts"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
        return None
    return Properties(fails, facts)


def _parsed(path: Path) -> Properties:
    text = read_file(path)
    try:
        require_shallow(text)
        table = yaml.load(text, Loader=_Loader)
        stats = table["sim"]["stats"]
        fails = {str(name): kind for kind, names in stats["fails"].items() for name in names or ()}
        counts = {key: stats.get(name) or {} for key, name in COUNTS.items()}
        names = dict.fromkeys(name for values in counts.values() for name in values)
        facts = {n: Facts(**{key: int(values.get(n, -1)) for key, values in counts.items()}) for n in names}
        return Properties(fails, facts)
    except (yaml.YAMLError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        found = " ".join(str(error).split()) or type(error).__name__
        raise ShardError(f"{path}: not the properties of a batch ({found}): {REMEDY}") from error


class _Loader(PlainLoader):
    """Reads plain values, and skips Python objects in the file."""


def _skip_object(loader: Any, suffix: str, node: yaml.Node) -> None:
    return None


_Loader.add_multi_constructor("tag:yaml.org,2002:python/", _skip_object)
