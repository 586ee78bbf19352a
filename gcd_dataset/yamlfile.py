"""YAML from outside: ambiguous values are rejected, and size and depth are limited."""

import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gcd_dataset.errors import GcdError, shown
from gcd_dataset.files import read_whole
from gcd_dataset.jsonfile import DEEPEST, is_flat

LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
LARGEST_YAML = 1 << 20  # bytes, a second to parse; a measurement file has 1 kB, a design file 14
MOST_VALUES = 300_000  # in one level; the labels of a published garment list some ten thousand vertices
DEEPEST_BYTES = 1000  # open brackets, or columns of indentation; libyaml's stack overflows at tens of thousands
BLOCK_START = re.compile(rb"^[ ?:-]{64,}", re.MULTILINE)
OTHER_BASE = re.compile(r"[+-]?0[0-7_]+|.*:.*")  # octal, sexagesimal: in YAML 1.1 070 is 56, and 1:50 is 110
BROKEN_SCALARS = (ValueError, KeyError, IndexError, AttributeError)
"""Exceptions that PyYAML leaks for malformed scalars: an impossible date, a huge integer, ``!!bool maybe``, …"""


def read_yaml(path: Path | str, kind: str, *, error: type[GcdError]) -> Any:
    """The parsed YAML of a file. Raises ``error``, which asks for a ``kind``, if it is missing, broken or too large."""
    content = read_whole(path, kind, limit=LARGEST_YAML, error=error)
    try:
        return strict_yaml(content)
    except (yaml.YAMLError, *BROKEN_SCALARS) as cause:
        mark = getattr(cause, "problem_mark", None) or getattr(cause, "context_mark", None)
        position = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        problem = " ".join(str(getattr(cause, "problem", None) or getattr(cause, "context", None) or cause).split())
        raise error(f"{path}: not YAML ({position}{shown(problem[:160])}): correct it, or give a {kind}") from cause
    except RecursionError as cause:
        raise error(f"{path}: nested too deeply: give a {kind}") from cause


def strict_yaml(content: str | bytes) -> Any:
    """The parsed value of YAML without ambiguous constructs.

    Raises ``yaml.MarkedYAMLError`` with the line of a repeated key, a number in base 8 or 60, or a merge key (``<<``),
    which can expand to millions of entries; ``RecursionError`` for more than 64 levels, aliases expanded.
    """
    depth = 0
    for event in yaml.parse(content, Loader=LOADER):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST:  # libyaml crashes the process when its stack overflows
            raise RecursionError(f"more than {DEEPEST} levels deep")
    value = yaml.load(content, Loader=_StrictLoader)
    require_small(value)
    return value


def require_small(value: Any) -> None:
    """Raise ``RecursionError`` for a value of more than 64 levels or 300,000 values in one, its aliases expanded."""
    if not is_flat(value, most=MOST_VALUES):
        raise RecursionError(f"more than {DEEPEST} levels deep, or {MOST_VALUES} values")


def require_shallow(content: bytes) -> None:
    """Raise ``RecursionError`` for YAML with so many brackets or columns that libyaml's stack may overflow.

    It scans the bytes only, faster than the depth check of ``strict_yaml``: for megabytes of machine-written YAML.
    """
    step = np.zeros(256, np.int8)
    step[list(b"[{")], step[list(b"]}")] = 1, -1
    flow = np.cumsum(step[np.frombuffer(content, np.uint8)], dtype=np.int32).max(initial=0)
    block = max(map(len, BLOCK_START.findall(content)), default=0)
    if max(flow, block) > DEEPEST_BYTES:
        raise RecursionError(f"possibly more than {DEEPEST_BYTES} levels deep")


class PlainLoader(LOADER):  # type: ignore[misc,valid-type]
    """Refuses merge keys (``<<``), which can expand to millions of entries."""

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        for key, _ in node.value:
            if key.tag == "tag:yaml.org,2002:merge":
                raise _refused("a merge key (<<): write the entries out", key)


class _StrictLoader(PlainLoader):
    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        table: dict[Any, Any] = super().construct_mapping(node, deep=deep)
        if len(table) < len(node.value):
            counts = Counter(key.value for key, _ in node.value)
            repeated = next((key for key, _ in node.value if counts[key.value] > 1), node)
            raise _refused("a repeated key: remove one of the entries", repeated)
        return table

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        return int(super().construct_yaml_int(self._plain(node)))

    def construct_yaml_float(self, node: yaml.ScalarNode) -> float:
        return float(super().construct_yaml_float(self._plain(node)))

    def _plain(self, node: yaml.ScalarNode) -> yaml.ScalarNode:
        if OTHER_BASE.fullmatch(node.value):
            raise _refused(f"the number {node.value[:20]}, which is not in base 10: write it plainly", node)
        return node


_StrictLoader.add_constructor("tag:yaml.org,2002:int", _StrictLoader.construct_yaml_int)
_StrictLoader.add_constructor("tag:yaml.org,2002:float", _StrictLoader.construct_yaml_float)


def _refused(problem: str, node: yaml.Node) -> yaml.MarkedYAMLError:
    return yaml.constructor.ConstructorError(None, None, problem, node.start_mark)
