"""Checks of a binary glTF file before parsing: sizes, compression, and that its nodes form a tree."""

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gcd_dataset.errors import BodyError
from gcd_dataset.jsonfile import parse_json

MAGIC, JSON_CHUNK = b"glTF", b"JSON"
COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")
MAX_NODES = 2_000  # a rigged figure has some hundred
MAX_STEPS = 10_000_000  # of placing the meshes: trimesh takes the cube of a mesh's depth in the tree of nodes
MAX_CORNERS = 6_000_000  # triangle corners, counted for each node that uses a mesh
REMEDY = "export the mesh again"


def require_readable(content: bytes, path: Path) -> None:
    """Raise ``BodyError`` for content that is not GLB, or that would exhaust memory or recursion when parsed."""
    if len(content) < 20 or content[:4] != MAGIC or content[16:20] != JSON_CHUNK:
        raise BodyError(f"{path}: is not binary glTF 2.0: {REMEDY}")
    length = struct.unpack("<I", content[12:16])[0]
    tree = parse_json(content[20 : 20 + length], source=str(path), remedy=REMEDY, error=BodyError)
    if not isinstance(tree, dict):
        raise BodyError(f"{path}: its JSON is not an object: {REMEDY}")
    parts = {name: _objects(tree, name, path) for name in ("accessors", "bufferViews", "meshes", "nodes")}
    extensions = tree.get("extensionsUsed") or ()
    if compression := next((name for name in COMPRESSED if name in str(extensions)), None):
        raise BodyError(f"{path}: is compressed by {compression}: export it without compression")
    declared = [accessor.get("count") for accessor in parts["accessors"]]
    counts = [count for count in declared if type(count) is int and count >= 0]
    if len(counts) < len(declared) or sum(counts) > len(content):
        raise BodyError(f"{path}: declares more numbers than it holds: {REMEDY}")
    _require_tree(parts["nodes"], path)
    corners = [_corners(mesh, counts) for mesh in parts["meshes"]]
    used_meshes = [node["mesh"] for node in parts["nodes"] if "mesh" in node]
    if not all(type(mesh) is int and 0 <= mesh < len(corners) for mesh in used_meshes):
        raise BodyError(f"{path}: a node refers to a missing mesh: {REMEDY}")
    if (pieces := sum(len(_primitives(parts["meshes"][mesh])) for mesh in used_meshes)) > MAX_NODES:
        raise BodyError(f"{path}: {pieces} pieces of meshes, more than {MAX_NODES}: export one mesh")
    if sum(corners[mesh] for mesh in used_meshes) > MAX_CORNERS:
        raise BodyError(f"{path}: more than {MAX_CORNERS // 3} triangles: decimate the mesh")


def _objects(tree: Mapping[str, Any], name: str, path: Path) -> Sequence[Mapping[str, Any]]:
    entries = tree.get(name, [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise BodyError(f"{path}: its {name} are not a list of objects: {REMEDY}")
    if len(entries) > MAX_NODES:
        raise BodyError(f"{path}: {len(entries)} {name}, more than {MAX_NODES}: export one mesh")
    return entries


def _require_tree(nodes: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Raise ``BodyError`` for cycles of nodes, nodes with two parents, and invalid children."""
    children = [node.get("children", []) for node in nodes]
    flat = [child for row in children if isinstance(row, list) for child in row]
    valid = all(isinstance(row, list) for row in children) and all(type(child) is int for child in flat)
    if not valid or len(set(flat)) < len(flat) or not set(flat) <= set(range(len(nodes))):
        raise BodyError(f"{path}: its nodes are not a tree: {REMEDY}")
    with_parent = set(flat)
    reached = [number for number in range(len(nodes)) if number not in with_parent]
    depth = dict.fromkeys(reached, 1)
    for number in reached:
        reached += children[number]
        depth |= dict.fromkeys(children[number], depth[number] + 1)
    if len(reached) < len(nodes):
        raise BodyError(f"{path}: its nodes contain each other: {REMEDY}")
    if sum(depth[number] ** 3 for number, node in enumerate(nodes) if "mesh" in node) > MAX_STEPS:
        raise BodyError(f"{path}: its meshes lie below too many nodes: export one mesh")


def _primitives(mesh: Mapping[str, Any]) -> Sequence[Any]:
    primitives = mesh.get("primitives", [])
    return primitives if isinstance(primitives, list) else []


def _corners(mesh: Mapping[str, Any], counts: Sequence[int]) -> int:
    """Number of triangle corners of a mesh."""
    total = 0
    for primitive in _primitives(mesh):
        if isinstance(primitive, dict):
            attributes = primitive.get("attributes")
            number = primitive.get("indices", attributes.get("POSITION") if isinstance(attributes, dict) else None)
            total += counts[number] if type(number) is int and 0 <= number < len(counts) else 0
    return total
