"""What of a binary glTF file is checked before it is read: sizes, compression, and that its nodes make a tree."""

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gcd_dataset.errors import BodyError
from gcd_dataset.jsonfile import parse_json

__all__ = ["require_readable"]

MAGIC, JSON_CHUNK = b"glTF", b"JSON"
COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")
MOST_NODES = 10_000  # a rigged figure has some hundred
MOST_CORNERS = 6_000_000  # of triangles, each time that a node shows its mesh
REMEDY = "export the mesh again"


def require_readable(content: bytes, path: Path) -> None:
    """Raise ``BodyError`` for what is no GLB, or what reading it would not come to an end with."""
    if len(content) < 20 or content[:4] != MAGIC or content[16:20] != JSON_CHUNK:
        raise BodyError(f"{path}: is no binary glTF 2.0: {REMEDY}")
    length = struct.unpack("<I", content[12:16])[0]
    tree = parse_json(content[20 : 20 + length], source=str(path), remedy=REMEDY, error=BodyError)
    if not isinstance(tree, dict):
        raise BodyError(f"{path}: its JSON is no object: {REMEDY}")
    parts = {name: _objects(tree, name, path) for name in ("accessors", "bufferViews", "meshes", "nodes")}
    used = tree.get("extensionsUsed") or ()
    if packed := next((name for name in COMPRESSED if name in str(used)), None):
        raise BodyError(f"{path}: is compressed by {packed}: export it without compression")
    told = [accessor.get("count") for accessor in parts["accessors"]]
    counts = [count for count in told if type(count) is int and count >= 0]
    if len(counts) < len(told) or sum(counts) > len(content):
        raise BodyError(f"{path}: tells of more numbers than it holds: {REMEDY}")
    _require_tree(parts["nodes"], path)
    corners = [_corners(mesh, counts) for mesh in parts["meshes"]]
    shown = [node["mesh"] for node in parts["nodes"] if "mesh" in node]
    if not all(type(mesh) is int and 0 <= mesh < len(corners) for mesh in shown):
        raise BodyError(f"{path}: a node shows a mesh that is not there: {REMEDY}")
    if sum(corners[mesh] for mesh in shown) > MOST_CORNERS:
        raise BodyError(f"{path}: more than {MOST_CORNERS // 3} triangles: decimate the mesh")


def _objects(tree: Mapping[str, Any], name: str, path: Path) -> Sequence[Mapping[str, Any]]:
    entries = tree.get(name, [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise BodyError(f"{path}: its {name} are no list of objects: {REMEDY}")
    if len(entries) > MOST_NODES:
        raise BodyError(f"{path}: {len(entries)} {name}, more than {MOST_NODES}: export one mesh")
    return entries


def _require_tree(nodes: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Raise ``BodyError`` for nodes that hold each other, or one that two hold."""
    children = [node.get("children", []) for node in nodes]
    held = [child for row in children if isinstance(row, list) for child in row]
    proper = all(isinstance(row, list) for row in children) and all(type(child) is int for child in held)
    if not proper or len(set(held)) < len(held) or not set(held) <= set(range(len(nodes))):
        raise BodyError(f"{path}: its nodes make no tree: {REMEDY}")
    inner = set(held)
    reached = [number for number in range(len(nodes)) if number not in inner]
    for number in reached:
        reached += children[number]
    if len(reached) < len(nodes):
        raise BodyError(f"{path}: its nodes hold each other: {REMEDY}")


def _corners(mesh: Mapping[str, Any], counts: Sequence[int]) -> int:
    """Corners of the triangles of a mesh."""
    total = 0
    primitives = mesh.get("primitives", [])
    for primitive in primitives if isinstance(primitives, list) else []:
        if isinstance(primitive, dict):
            attributes = primitive.get("attributes")
            number = primitive.get("indices", attributes.get("POSITION") if isinstance(attributes, dict) else None)
            total += counts[number] if type(number) is int and 0 <= number < len(counts) else 0
    return total
