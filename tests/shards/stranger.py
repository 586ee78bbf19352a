"""A reader of our tars after docs/format.md, in 100 lines, without any code of the package."""

import json
import struct
import tarfile
import zlib

import numpy as np
import zstandard

HEAD = struct.Struct("<16sIH2sBBbxI")


def samples(path: str) -> list[tuple[str, dict[str, bytes]]]:
    """Key and members of each sample of a tar, their checksums compared."""
    found: dict[str, dict[str, bytes]] = {}
    with tarfile.open(path, "r:") as tar:
        for entry in tar:
            key, member = entry.name.split(".", 1)
            file = tar.extractfile(entry)
            found.setdefault(key, {})[member] = file.read() if file else b""
    for members in found.values():
        meta = json.loads(members["meta.json"])
        before = members["meta.json"].rindex(b',"crc32_before":')
        assert zlib.crc32(members["meta.json"][:before]) == meta["crc32_before"]
        assert all(zlib.crc32(members[member]) == crc for member, crc in meta["crc32"].items() if member in members)
    return list(found.items())


def sections(data: bytes) -> dict[str, np.ndarray]:
    """Name to array, of a .z member."""
    content, place, found = zstandard.ZstdDecompressor().decompress(data), 0, {}
    while place < len(content):
        name, rows, columns, kind, coding, planes, step, size = HEAD.unpack_from(content, place)
        body, place = content[place + 32 : place + 32 + size], place + 32 + size
        if coding == 0:
            array = np.frombuffer(body, "<" + kind.decode()).reshape(rows, columns or 1)
        else:
            array = numbers(np.frombuffer(body, np.uint8).reshape(planes, columns or 1, rows), coding)
            array = array.astype(np.int32) if step == 127 else (array * 2.0**step).astype(np.float32)
        found[name.rstrip(b"\0").decode()] = array if columns else array[:, 0]
    return found


def numbers(planes: np.ndarray, coding: int) -> np.ndarray:
    """The integers of a coded body, rows by columns."""
    code = (planes.astype(np.int64) << 8 * np.arange(len(planes))[:, None, None]).sum(axis=0)
    columns = np.where(code & 1, -(code >> 1) - 1, code >> 1)
    if coding == 3:
        first = np.cumsum(columns[0])
        return np.stack([first, first + columns[1], first + columns[2]], axis=1)
    return np.cumsum(columns if coding == 1 else np.cumsum(columns, axis=1), axis=1).T


def arrays(members: dict[str, bytes]) -> dict[str, np.ndarray]:
    """The fields of a sample that are arrays."""
    pattern, mesh = sections(members["pattern.z"]), sections(members["mesh.z"])
    found = {name: pattern[name] for name in ("panels", "edges", "stitches", "body")}
    found["closures"] = pattern.get("closures", np.tile([0.0, 0.0, 1.0], (len(pattern["stitches"]), 1)))
    lines = pattern.get("lines", np.zeros((0, 16)))
    found["lines"] = np.column_stack([lines, pattern.get("angles", np.zeros(len(lines)))])
    found |= {name: mesh[name] for name in ("corners", "uv", "uv_vertex", "labels", "seams")}
    found["faces"] = mesh["faces"] if "faces" in mesh else mesh["uv_vertex"][mesh["corners"]]
    panel_id = np.repeat(np.arange(len(mesh["faces_of"])), mesh["faces_of"])
    found["panel_id"] = mesh["panel_id"] if "panel_id" in mesh else panel_id.astype(np.int32)
    found["box"] = mesh["box"] if "box" in mesh else box(mesh, pattern["panels"])
    found["verts"] = sections(members["verts.z"])["verts"]
    found["points"] = points(**sections(members["points.z"]))
    return found


def box(mesh: dict[str, np.ndarray], panels: np.ndarray) -> np.ndarray:
    """Positions before sewing: means of the placed rows of uv."""
    owner = np.repeat(np.arange(len(mesh["rows_of"])), mesh["rows_of"])
    flat = mesh["uv"] - panels[owner, 10:12]
    total = np.zeros((mesh["uv_vertex"].max(initial=-1) + 1, 3))
    for row, panel in enumerate(panels):
        w, x, y, z = panel[3:7]
        right = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])
        up = np.array([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)])
        mine = owner == row
        placed = flat[mine, :1] * right + flat[mine, 1:] * up + panel[:3]
        np.add.at(total, mesh["uv_vertex"][mine], placed)
    count = np.bincount(mesh["uv_vertex"], minlength=len(total))
    return (total / np.maximum(count, 1)[:, None]).astype(np.float32)


def points(xyz: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Points and unit normals, in the order of items."""
    x, y = (normals / 511).T
    z = 1 - abs(x) - abs(y)
    fold = np.minimum(z, 0)
    normal = np.stack([x + np.where(x < 0, -fold, fold), y + np.where(y < 0, -fold, fold), z], axis=1)
    rows = np.concatenate([xyz, normal / np.linalg.norm(normal, axis=1, keepdims=True)], axis=1)
    step = len(rows) * 0x9E3779B1 >> 32
    while np.gcd(step, len(rows)) > 1:
        step += 1
    return rows[np.arange(len(rows)) * step % max(len(rows), 1)].astype(np.float32)
