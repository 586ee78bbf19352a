"""The body model in ``generator/data``: mean body, shape components, joints, skinning, landmarks.

``body.npz``, made by ``bake.py``, holds one half of the model; the other half is its mirror image.
``landmarks.json`` names vertices and rings of vertices; refining the mesh keeps their numbers.
"""

import functools
import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.sparse import csr_matrix

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.surface import refine
from gcd_dataset.records import BodyPart, Record

MIRROR = np.array([-1.0, 1.0, 1.0])
COARSE_PARTS = (BodyPart.HEAD, BodyPart.HANDS, BodyPart.FEET, BodyPart.INTERNAL)  # dense enough unrefined


@dataclass(frozen=True, eq=False)
class BodyModel(Record):
    """A linear shape space: ``mean + weights · components``, in the A-pose with legs straight."""

    mean: Float[np.ndarray, "v 3"]
    """[cm]"""
    components: Float[np.ndarray, "k v 3"]
    """Principal components, scaled to one standard deviation of the population each [cm]."""
    joints: Float[np.ndarray, "n 3"]
    """Joints of the mean body [cm]: left upper arm, thigh, foot, then right."""
    joint_components: Float[np.ndarray, "k n 3"]
    skin: Float[np.ndarray, "v n"]
    """Skinning weights: the share of each joint's rotation that a vertex follows, 0 to 1."""
    faces: Int[np.ndarray, "f 3"]
    parts: UInt8[np.ndarray, " v"]
    named: Mapping[str, Float[np.ndarray, " k"]]
    """Shape weights of the named bodies: neutral, female, male."""


@dataclass(frozen=True, eq=False)
class LandmarkTable(Record):
    """The body model's landmarks as vertex numbers, by name."""

    points: Mapping[str, int]
    rings: Mapping[str, Int[np.ndarray, " n"]]
    """Vertices along closed rings and open lines, in order along them."""
    levels: Mapping[str, float]
    """Height of the centre of the search for a girth above its ring, as a share of the body's height."""
    beside: Mapping[str, Float[np.ndarray, "3"]]
    """Offset of a landmark on other meshes from the model's vertex, as shares of the body's height."""


@functools.cache
def body_model() -> BodyModel:
    """The body model, mirrored from its half and refined. Raises ``BodyError`` if the file is damaged."""
    with np.load(io.BytesIO(checked_data("body.npz"))) as file:
        half = {name: file[name] for name in file.files}
    mirror = half["mirror"].astype(int)
    finer, faces, parts = refinement(half["faces"].astype(int), half["parts"])
    steps = half["component_steps"][:, None, None].astype(float)
    components = mirrored_mesh(half["components"] * steps, mirror)
    joints = np.concatenate([half["joints"], half["joints"] * MIRROR], axis=1).astype(float)
    skin = np.concatenate([half["skin"], half["skin"][mirror]], axis=1).astype(float)
    return BodyModel(
        mean=finer @ mirrored_mesh(half["mean"].astype(float), mirror),
        components=np.stack([finer @ component for component in components]),
        joints=joints[0],
        joint_components=joints[1:],
        skin=finer @ skin,
        faces=faces,
        parts=parts,
        named={name: half[name] for name in ("neutral", "female", "male")},
    )


@functools.cache
def landmark_table() -> LandmarkTable:
    """The landmarks in ``generator/data/landmarks.json``."""
    table = json.loads(_data("landmarks.json"))
    rings = {name: np.array(ids) for name, ids in table["rings"].items()}
    return LandmarkTable(
        {name: entry["vertex"] for name, entry in table["points"].items()},
        rings,
        table["levels"],
        # The file's offsets for the left side, mirrored for the right side.
        {f"{name}_right": np.array(share) * MIRROR for name, share in table["beside"].items()}
        | {f"{name}_left": np.array(share) for name, share in table["beside"].items()},
    )


def refinement(
    faces: Int[np.ndarray, "f 3"], parts: UInt8[np.ndarray, " v"]
) -> tuple[csr_matrix, Int[np.ndarray, "g 3"], UInt8[np.ndarray, " w"]]:
    """One level of Loop subdivision except on ``COARSE_PARTS``.

    Returns the matrix (w, v) from coarse to fine vertices, the fine faces, and ``BodyPart`` of each fine vertex.
    """
    coarse = np.isin(parts, [part.value for part in COARSE_PARTS])
    finer, fine_faces = refine(faces, ~coarse[faces].any(axis=1), len(parts))
    shares = finer @ (parts[:, None] == np.arange(len(BodyPart)))
    return finer, fine_faces, shares.argmax(axis=1).astype(np.uint8)


def stored_half(mirror: Int[np.ndarray, " v"]) -> Int[np.ndarray, " h"]:
    """Numbers of the stored vertices: the first of each pair; ``mirror`` holds the mirror image of each vertex."""
    return np.flatnonzero(np.arange(len(mirror)) <= mirror)


def mirrored_mesh(half: Float[np.ndarray, "*k h 3"], mirror: Int[np.ndarray, " v"]) -> Float[np.ndarray, "*k v 3"]:
    """All vertices from the stored half; vertices that are their own mirror image go to the plane x = 0."""
    stored = stored_half(mirror)
    whole = np.empty((*half.shape[:-2], len(mirror), 3))
    whole[..., mirror[stored], :] = half * MIRROR
    whole[..., stored, :] = half
    whole[..., mirror == np.arange(len(mirror)), 0] = 0.0
    return whole


def checked_data(name: str) -> bytes:
    """A file of ``generator/data``, verified. Raises ``BodyError`` if its SHA-256 differs from the shipped one."""
    content = _data(name)
    expected = _data(f"{name}.sha256").split()[0].decode()
    digest = hashlib.sha256(content).hexdigest()
    if digest != expected:
        raise BodyError(f"{name}: damaged (SHA-256 {digest[:12]}…, not {expected[:12]}…): install gcd-dataset again")
    return content


def _data(name: str) -> bytes:
    return (files("gcd_dataset.generator") / "data" / name).read_bytes()
