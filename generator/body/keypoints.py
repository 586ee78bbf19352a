"""The 17 key points of a person in COCO's order: face points from vertices, the others from the joints of the rig."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.pose import rig
from gcd_dataset.records import BONES, Body

FACE: Mapping[str, tuple[int, ...]] = {  # the tip of the nose; the middle of both lids; the rim of the ear
    "nose": (297,),
    "left_eye": (11433, 11447),
    "right_eye": (4831, 4845),
    "left_ear": (12006,),
    "right_ear": (5423,),
}
"""Vertices of the body model, whose mean is the key point."""
JOINTS = {"shoulder": "upper_arm", "elbow": "forearm", "wrist": "hand", "hip": "thigh", "knee": "shin", "ankle": "foot"}
"""The bone that turns about each joint."""
COCO_KEYPOINTS = (*FACE, *(f"{side}_{joint}" for joint in JOINTS for side in ("left", "right")))
"""Names of the key points, in COCO's order."""
_BONE = [BONES.index(f"{side}_{bone}") for bone in JOINTS.values() for side in ("left", "right")]


def keypoints_of(body: Body) -> Float[np.ndarray, "17 3"] | None:
    """The key points of a body of the body model, in the order of ``COCO_KEYPOINTS`` [cm]; ``None``: another mesh."""
    if len(body.vertices) != len(body_model().parts):
        return None
    face = [body.vertices[list(vertices)].mean(axis=0) for vertices in FACE.values()]
    joints = rig().carriers @ body.vertices if body.joints is None else body.joints
    return np.concatenate([face, joints[_BONE]])
