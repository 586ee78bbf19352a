"""Bodies outside the sampled population: other poses, and scans with damaged skin."""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from benchmarks.draping.coarser import coarser
from benchmarks.draping.workload import Worn, kind_of
from gcd_dataset.generator.body import build_body, draw_shape, measure, named_body, neutral_shape, read_body
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.repair import VisibleSkin
from gcd_dataset.generator.body.shape import LEFT_ARM, RIGHT_ARM, T_POSE, set_pose, stand
from gcd_dataset.generator.drape import DrapeJob
from gcd_dataset.generator.dressing import dress
from gcd_dataset.generator.dressing.sewing_start import sewing_start
from gcd_dataset.generator.garments import Reject, sample_design, sample_kind, try_on
from gcd_dataset.generator.garments.overlay import NO_OVERLAY
from gcd_dataset.generator.mesh import build_box_mesh, coarse_start
from gcd_dataset.records import Body, BodyShape, Measurements
from gcd_dataset.seeding import Stage, rng

ATTEMPTS = 30  # designs tried for one garment
ARM_TURN = np.radians(40.0)  # raising or lowering of the arms from the A-pose
CLEAR_ARM_TURN = np.radians(25.0)  # arms lowered further make the neutral body pass through itself in the armpits
WIDE_LEGS = np.radians(12.0)  # rotation of each thigh; 3° in generated samples with trousers
FORWARD = np.array([0.25, -0.35, 0.9])
"""Direction of the left arm held forward: a little outward, 20° below the horizontal (x left, y up, z forward)."""
SCAN_VERTICES = 3000
SCANNED = 7  # seed of the woman in the scans
HOLE = 2.5  # cm, radius of a hole in a scan
HOLES = (
    (0.16, 0.69, 0.0), (-0.16, 0.69, 0.0), (0.02, 0.42, 0.0), (0.05, 0.74, -0.1), (0.08, 0.58, 0.0), (0.0, 1.0, 0.0),
)  # fmt: skip
"""Arms, a thigh, a shoulder blade, a hip and the crown, where scanners miss skin: (x, y, z) in body heights."""


@dataclass(frozen=True, eq=False)
class OtherBody:
    """A wearer with measures."""

    body: Body
    apart: Body
    """The body with its legs apart, for trousers."""
    size: Measurements


def _posed(arm: float) -> OtherBody:
    """The neutral body with both arms raised by ``arm`` [rad]."""
    usual, apart = (
        build_body(BodyShape(neutral_shape().weights, arm, legs_apart=legs_apart)) for legs_apart in (False, True)
    )
    return OtherBody(usual, apart, measure(usual))


def _legs_wide() -> OtherBody:
    """The neutral body with its legs spread by ``WIDE_LEGS``, for all garments."""
    usual = _named("neutral")
    joints = _joints(neutral_shape())
    spread = set_pose(usual.body.vertices, joints, body_model().skin, leg=WIDE_LEGS)
    wide = replace(usual.body, vertices=stand(spread))
    return OtherBody(wide, wide, usual.size)


def _arms_forward() -> OtherBody:
    usual = _named("neutral")
    forward = arms_forward(usual.body, neutral_shape())
    return OtherBody(forward, arms_forward(usual.apart, neutral_shape()), measure(forward))


def arms_forward(body: Body, shape: BodyShape) -> Body:
    """A body of the model in the A-pose with both arms turned to ``FORWARD`` about the shoulders (linear blending)."""
    model, joints = body_model(), _joints(shape)
    vertices = body.vertices.copy()
    for joint, side in ((LEFT_ARM, 1.0), (RIGHT_ARM, -1.0)):
        weight = model.skin[:, joint, None]
        arm = body.vertices[model.skin[:, joint] > 0.999].mean(axis=0) - joints[joint]
        wanted = FORWARD * [side, 1.0, 1.0]
        turn = Rotation.align_vectors([wanted / np.linalg.norm(wanted)], [arm / np.linalg.norm(arm)])[0]
        vertices += weight * (turn.apply(body.vertices - joints[joint]) + joints[joint] - body.vertices)
    return replace(body, vertices=stand(vertices))


def _joints(shape: BodyShape) -> Float[np.ndarray, "6 3"]:
    """The joints of a body that stands on y = 0 [cm]."""
    model = body_model()
    vertices = model.mean + np.einsum("k,kvi->vi", shape.weights, model.components)
    joints = model.joints + np.einsum("k,kni->ni", shape.weights, model.joint_components)
    return joints - [0.0, vertices[:, 1].min(), 0.0]


def _named(name: str) -> OtherBody:
    body, size, _ = named_body(name)
    return OtherBody(body, named_body(name, legs_apart=True)[0], size)


# --------------------------------------------------------------------------------------------------------------- scans


def _scan(damage: Callable[[Body], Body]) -> OtherBody:
    """A woman's body with damaged skin, written to a mesh file and read back as an unknown body."""
    woman = draw_shape(rng(SCANNED, 0, Stage.BODY), group="female")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scan.obj"
        scanned = []
        for legs_apart in (False, True):
            damaged = damage(build_body(replace(woman, legs_apart=legs_apart)))
            trimesh.Trimesh(damaged.vertices, damaged.faces, process=False).export(path)
            scanned.append(read_body(path))
    (usual, size), (apart, _) = scanned
    return OtherBody(usual, apart, size)


def decimated(body: Body) -> Body:
    """The body's skin decimated to ``SCAN_VERTICES`` vertices, without cavities and without labels of body parts."""
    skin = VisibleSkin.of(body.faces, body.parts)
    vertices, faces = coarser(skin.points(body.vertices), skin.faces, SCAN_VERTICES)
    return Body(vertices, faces, np.zeros(len(vertices), np.uint8), body.name)


def with_holes(body: Body) -> Body:
    """The body without the skin within ``HOLE`` of each of ``HOLES``, and with its faces in another order."""
    height = float(np.ptp(body.vertices[:, 1].copy()))
    gone = np.zeros(len(body.vertices), bool)
    for at in HOLES:
        middle = body.vertices[np.linalg.norm(body.vertices - np.array(at) * height, axis=1).argmin()]
        gone |= np.linalg.norm(body.vertices - middle, axis=1) < HOLE
    # In another order the mesh is not recognised as the model's, so that it is read as a scan.
    return replace(body, faces=np.roll(body.faces[~gone[body.faces].any(axis=1)], 1, axis=0))


# ------------------------------------------------------------------------------------------------------------ garments


def dressed(wearer: OtherBody, name: str, seed: int, resolution: float, number: int) -> Worn | None:
    """Design ``number`` of a seed for this wearer, ready to drape; ``None`` if no attempt was accepted."""
    kind = sample_kind(rng(seed, number, Stage.KIND), NO_OVERLAY)
    for attempt in range(ATTEMPTS):
        design = sample_design(rng(seed, number, Stage.DESIGN, attempt), [wearer.size], kind=kind, overlay=NO_OVERLAY)
        pattern = try_on(wearer.size, design, name=f"{name}_{number}")
        if isinstance(pattern, Reject):
            continue
        trousers = design.meta.bottom is not None and design.meta.bottom.garment.legs
        body = wearer.apart if trousers else wearer.body
        mesh = build_box_mesh(dress(pattern, body, wearer.size).pattern, spacing=resolution)
        coarse = coarse_start(mesh)
        start = sewing_start(coarse.mesh if coarse else mesh, body)
        job = DrapeJob(mesh, body, wearer.size, coarse=coarse, start=start)
        return Worn(number, name, **kind_of(design), job=job)
    return None


OTHER_BODIES: Mapping[str, Callable[[], OtherBody]] = {
    "neutral": partial(_named, "neutral"),
    "female": partial(_named, "female"),
    "male": partial(_named, "male"),
    "arms_up": partial(_posed, ARM_TURN),
    "arms_down": partial(_posed, -ARM_TURN),
    "arms_down_25": partial(_posed, -CLEAR_ARM_TURN),
    "t_pose": partial(_posed, T_POSE),
    "arms_forward": _arms_forward,
    "legs_wide": _legs_wide,
    "scan_3000": partial(_scan, decimated),
    "scan_holes": partial(_scan, with_holes),
}
"""Name to the function that builds the body; first the three usual ones."""
