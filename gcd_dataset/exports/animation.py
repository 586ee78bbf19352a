"""Meshes that move, as morph targets of a GLB."""

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

FLOAT, ARRAY_BUFFER = 5126, 34962  # componentType and target of glTF
Shapes = Float[np.ndarray, "t v 3"]


def animated(glb: bytes, shapes: Mapping[str, tuple[Shapes, Shapes]], fps: float) -> bytes:
    """A GLB whose meshes move; ``shapes``: positions [m] and normals of each mesh in all frames, by the mesh's name.

    The first frame is the mesh as it is; each other one is a morph target, of full weight at its time.
    """
    _, _, size = struct.unpack_from("<4sII", glb)
    length, _ = struct.unpack_from("<I4s", glb, 12)
    scene: dict[str, Any] = json.loads(glb[20 : 20 + length])
    binary = bytearray(glb[28 + length : size])

    def accessor(values: Float[np.ndarray, "..."], kind: str, **extra: Any) -> int:
        data = np.ascontiguousarray(values, "<f4").tobytes()
        scene["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data), **extra})
        binary.extend(data)
        rows = np.asarray(values, "<f4").reshape(-1, 3 if kind == "VEC3" else 1)
        ends = {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        view = len(scene["bufferViews"]) - 1
        scene["accessors"].append(
            {"bufferView": view, "componentType": FLOAT, "count": len(rows), "type": kind, **ends}
        )
        return len(scene["accessors"]) - 1

    binary.extend(bytes(-len(binary) % 4))
    frames = len(next(iter(shapes.values()))[0])
    for mesh in scene["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["targets"] = [
                {
                    name: accessor(each[frame] - each[0], "VEC3", target=ARRAY_BUFFER)
                    for name, each in zip(("POSITION", "NORMAL"), shapes[mesh["name"]], strict=True)
                }
                for frame in range(1, frames)
            ]
        mesh["weights"] = [0.0] * (frames - 1)
    times = accessor(np.arange(frames) / fps, "SCALAR")
    weights = accessor(np.eye(frames)[:, 1:], "SCALAR")
    moving = [number for number, node in enumerate(scene["nodes"]) if "mesh" in node]
    channels = [{"sampler": 0, "target": {"node": node, "path": "weights"}} for node in moving]
    sampler = {"input": times, "output": weights, "interpolation": "LINEAR"}
    scene["animations"] = [{"name": "motion", "channels": channels, "samplers": [sampler]}]
    scene["buffers"][0]["byteLength"] = len(binary)
    text = json.dumps(scene, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    whole = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(binary))
    return b"".join(
        [whole, struct.pack("<I4s", len(text), b"JSON"), text, struct.pack("<I4s", len(binary), b"BIN\0"), binary]
    )
