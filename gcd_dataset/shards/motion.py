"""Encodes a garment in motion as ``.motion.z``, and decodes it: see "Garments in motion" in ``docs/format.md``.

A vertex moves nearly as its neighbours do, so its way from frame to frame is stored less their mean. A prediction by
skinning would save no bytes beyond this one.
"""

import numpy as np
from jaxtyping import Int

from gcd_dataset.errors import ShardError
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import FPS, MOTION_STEP, POSITION_STEP, GarmentMotion, Pose
from gcd_dataset.shards.layout import Bytes
from gcd_dataset.shards.sections import Coding, pack, unpack

NAMES = ("faces", "fps", "bones", "turns", "counts", "first")
FARTHEST = 1e4  # cm
NO_FRAMES = GarmentMotion(np.zeros((0, 0, 3), np.float32), np.zeros((0, 3), int), (), FPS, np.zeros((0, 3), int))
"""Of a garment that is not at rest in the first frame."""
CODINGS = {
    "faces": Coding(3),
    "counts": Coding(1),
    "first": Coding(2, round(np.log2(POSITION_STEP))),
    "steps": Coding(1),
}


def encode_motion(motion: GarmentMotion) -> bytes:
    """The bytes of a ``.motion.z``: no sections without frames. Raises ``ShardError`` for positions that are none."""
    if not motion.poses:
        return pack({})
    vertices = motion_as_stored(motion.vertices)
    if not np.abs(vertices).max(initial=0.0) < FARTHEST:  # nor NaN
        raise ShardError(f"a garment in motion has a position that is no number below {FARTHEST:g} cm")
    at = np.rint(vertices / MOTION_STEP).astype(np.int64)
    ways = np.diff(at, axis=0).transpose(1, 0, 2).reshape(len(at[0]), -1)
    bones = sorted({bone for pose in motion.poses for bone in pose.turns})
    turns = [[pose.turns.get(bone, (0.0, 0.0, 0.0)) for bone in bones] for pose in motion.poses]
    sections = {
        "faces": motion.faces,
        "fps": np.array([motion.fps]),
        "bones": np.frombuffer(" ".join(bones).encode(), np.uint8),
        "turns": np.array(turns, np.float32).reshape(len(motion.poses), -1),
        "counts": motion.crossings,
        "first": vertices[0],
    }
    steps = {"steps": np.cumsum(_less_neighbours(ways, motion.faces), axis=0)} if len(at) > 1 else {}
    return pack(sections | steps, CODINGS)


def decode_motion(data: Bytes) -> GarmentMotion:
    """The garment in motion of a ``.motion.z``. Raises ``ShardError`` for damaged data."""
    try:
        if not (sections := unpack(data)):
            return NO_FRAMES
        faces, fps, bones, turns, counts, first = (sections[name] for name in NAMES)
        frames, vertices = len(turns), len(first)
        steps = sections["steps"] if frames > 1 else np.zeros((vertices, 0), np.int32)
        names = bytes(bones).decode().split()
        fits = turns.shape == (frames, 3 * len(names)) and counts.shape == (frames, 3) and len(fps) == 1
        if not fits or frames < 1 or steps.shape != (vertices, 3 * (frames - 1)) or first.shape != (vertices, 3):
            raise ValueError("sections do not fit each other")
        if faces.ndim != 2 or faces.shape[1] != 3 or not 0 <= faces.min(initial=0) <= faces.max(initial=0) < vertices:
            raise ValueError("faces of vertices that do not exist")
        ways = _plus_neighbours(np.diff(steps, axis=0, prepend=np.int32(0)).astype(np.int64), faces)
        start = np.rint(first / MOTION_STEP).astype(np.int64)
        later = start + np.cumsum(ways.reshape(vertices, frames - 1, 3).transpose(1, 0, 2), axis=0)
    except (ShardError, KeyError, ValueError) as error:
        raise ShardError(f"not a whole garment in motion ({error}): make or fetch it again") from error
    positions = np.concatenate([first[None], (later * MOTION_STEP).astype(np.float32)])
    poses = [
        Pose({name: tuple(turn) for name, turn in zip(names, row, strict=True)}, f"frame {number}")
        for number, row in enumerate(turns.reshape(frames, -1, 3).tolist(), 1)
    ]
    return GarmentMotion(positions, faces, tuple(poses), float(fps[0]), counts)


def motion_as_stored(vertices: np.ndarray) -> np.ndarray:
    """(t, v, 3) positions as ``decode_motion`` returns them.

    A step is a power of 2, so that single precision rounds as double precision does.
    """
    steps = np.full((len(vertices), 1, 1), MOTION_STEP, np.result_type(vertices, np.float32))
    steps[:1] = POSITION_STEP
    stored = vertices / steps
    return np.multiply(np.rint(stored, out=stored), steps, dtype=np.float32, casting="same_kind")


def _pairs(faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "e 2"]:
    """Neighbours, the lower number first, in the order of the higher ones."""
    ends = np.sort(mesh_edges(faces).ends, axis=1)
    return ends[np.argsort(ends[:, 1], kind="stable")]


def _means(
    ways: Int[np.ndarray, "v n"], pairs: Int[np.ndarray, "e 2"]
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, "k n"]]:
    """The vertices that come second in pairs, and for each the rounded mean of the ways of those that come first."""
    begins = np.flatnonzero(np.diff(pairs[:, 1], prepend=-1))
    counts = np.diff(begins, append=len(pairs))[:, None]
    sums = np.add.reduceat(ways[pairs[:, 0]], begins, axis=0)
    return pairs[begins, 1], (2 * sums + counts) // (2 * counts)


def _less_neighbours(ways: Int[np.ndarray, "v n"], faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "v n"]:
    rests = ways.copy()
    rows, means = _means(ways, _pairs(faces))
    rests[rows] -= means
    return rests


def _plus_neighbours(rests: Int[np.ndarray, "v n"], faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "v n"]:
    ways, pairs, ranks = rests.copy(), _pairs(faces), [0] * len(rests)
    for lower, higher in pairs.tolist():  # a vertex ranks above its neighbours of lower numbers
        ranks[higher] = max(ranks[higher], ranks[lower] + 1)
    of_pairs = np.array(ranks)[pairs[:, 1]]
    order = np.argsort(of_pairs, kind="stable")
    for same in np.split(pairs[order], np.flatnonzero(np.diff(of_pairs[order])) + 1):
        rows, means = _means(ways, same)
        ways[rows] += means
    return ways
