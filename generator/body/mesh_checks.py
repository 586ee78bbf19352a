"""Checks of a body found in a mesh, before its measures are trusted: missing parts, other objects, merged limbs."""

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.spatial import cKDTree

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.asset import body_model
from gcd_dataset.generator.body.landmarks import Landmarks
from gcd_dataset.generator.body.register import Registration
from gcd_dataset.generator.body.scan import Scan
from gcd_dataset.generator.body.section import loops, rough_girths, section, section_points
from gcd_dataset.generator.body.surface import SkinSurface
from gcd_dataset.generator.body.tailor import GIRTHS, MeasureResult, Sites, relative_height
from gcd_dataset.records import BodyPart

MISSING = 3.0  # cm: largest median distance of a present part from the scan
STRAY = 8.0  # cm: surface further from the registered model is not part of the body
STRAY_SHARE = 0.02  # largest share of the mesh's area that is stray: a bun, a heel, a fragment
STICKS_OUT = 6.0  # cm above the model's head or below its soles, largest extent of the mesh
MAX_BRIDGED = 3.0  # cm that a tape may run over one patch: straight over it, the tape is at most 0.1 cm too short
MAX_JOINED = 8.0  # cm: largest length of arm contour in the loop of a girth; sampled bodies have none
LEVEL_ERROR = 2.0  # possible error of a level over the misfit
MIN_TRUNK = 20.0  # cm: a loop with more contour of trunk and legs than this belongs to the trunk

NEEDED = {
    BodyPart.TRUNK: "the trunk",
    BodyPart.LEFT_ARM: "the left arm",
    BodyPart.RIGHT_ARM: "the right arm",
    BodyPart.LEFT_LEG: "the left leg",
    BodyPart.RIGHT_LEG: "the right leg",
    BodyPart.HEAD: "the head",
    BodyPart.HANDS: "the hands",
    BodyPart.FEET: "the feet",
}
CHECKED_POINTS = ("nape_of_neck", "neck_right", "shoulder_left", "shoulder_right", "underarm_right", "crotch_point")
X, Y, Z = 0, 1, 2


def require_body_alone(scan: Scan, surface: SkinSurface, registration: Registration, name: str) -> None:
    """Raise ``BodyError`` if a body part is missing, or the mesh holds other objects.

    ``surface`` is the scan's surface, scaled to the model's height.
    """
    parts = body_model().parts
    for part, words in NEEDED.items():
        of_part = parts == part.value
        # The left and the right half separately: one hand alone may be missing.
        halves = [of_part & (side * registration.vertices[:, X] > 0) for side in (-1, 1)]
        distance = max(float(np.median(registration.distances[half])) for half in halves if half.any())
        if distance > MISSING:
            raise BodyError(f"{name}: no skin within {distance:.0f} cm of where {words} should be: give a whole body")
    corners = surface.corners
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    far = cKDTree(registration.vertices).query(corners.mean(axis=1))[0] > STRAY
    share = float(area[far & ~scan.patched[surface.owners]].sum() / area.sum())
    if share > STRAY_SHARE:
        raise BodyError(
            f"{name}: {share:.0%} of its surface lies more than {STRAY:.0f} cm off the body in it: "
            "leave only the body in it (no floor, chair, loose clothes or second person)"
        )
    for end, model, words in (
        (corners[..., Y].max(), registration.vertices[:, Y].max(), "above the head"),
        (-corners[..., Y].min(), -registration.vertices[:, Y].min(), "below the soles"),
    ):
        if end - model > STICKS_OUT:
            raise BodyError(f"{name}: something lies {end - model:.0f} cm {words}: leave only the body in the mesh")


def require_skin(scan: Scan, marks: Landmarks, sites: Sites, result: MeasureResult, name: str) -> None:
    """Raise ``BodyError`` if a landmark or a tape lies on a patch over a hole."""
    patches = scan.faces[scan.patched]
    if not len(patches):
        return
    for point in CHECKED_POINTS:
        if marks.confidence[point] == 0:
            raise BodyError(f"{name}: the {point.replace('_', ' ')} lies in a hole: close the skin there")
    for girth, level in result.levels.items():
        band = sites.thighs if girth == "leg_circ" else sites.bands[girth]
        _require_bridgeable(scan, _common(patches, band), Y, level, girth, name)
    _require_bridgeable(scan, _common(patches, sites.spine), X, marks.points["nape_of_neck"][X], "waist_line", name)
    over_bust = float(marks.rings["bust_line"][:, X].mean())
    _require_bridgeable(scan, _common(patches, sites.breast), X, over_bust, "waist_over_bust_line", name)


def _require_bridgeable(scan: Scan, patches: np.ndarray, axis: int, level: float, measure: str, name: str) -> None:
    bridged = _longest_run(section(scan.vertices, patches, axis, level)) if len(patches) else 0.0
    if bridged > MAX_BRIDGED * relative_height(scan.vertices):
        raise BodyError(f"{name}: {measure} crosses {bridged:.0f} cm of a hole in the skin: close it")


def _longest_run(segments: Float[np.ndarray, "s 2 3"]) -> float:
    """Length of the longest connected line of a section's segments [cm]."""
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    return float(np.bincount(loops(segments), length).max(initial=0.0))


def _common(patches: Int[np.ndarray, "a 3"], band: Int[np.ndarray, "b 3"]) -> Int[np.ndarray, "c 3"]:
    """The patches that are also faces of a band."""
    of_band = {tuple(face) for face in band.tolist()}
    common = [face for face in patches.tolist() if tuple(face) in of_band]
    return np.array(common, int).reshape(-1, 3)


def require_free_limbs(scan: Scan, parts: UInt8[np.ndarray, " v"], result: MeasureResult, name: str) -> None:
    """Raise ``BodyError`` if an arm is merged with the trunk at a girth's level, as in scans with lowered arms."""
    arms = np.isin(parts, [BodyPart.LEFT_ARM.value, BodyPart.RIGHT_ARM.value, BodyPart.HANDS.value])
    for girth in GIRTHS:
        if joined_arm_contour(scan, arms, result.levels[girth]) > MAX_JOINED * relative_height(scan.vertices):
            raise BodyError(
                f"{name}: an arm is merged with the trunk at the level of the {girth}, "
                f"{result.levels[girth]:.0f} cm: raise the arms, or separate them in the mesh"
            )


def underbust_uncertainty(scan: Scan, sites: Sites, result: MeasureResult, misfit: float) -> float:
    """Change of the underbust over the possible error of its level [cm]; infinite off the skin.

    Other girths are extrema over their levels; the underbust level is the lower end of the breast on the registered
    model.
    """
    level, error = result.levels["underbust"], LEVEL_ERROR * misfit * relative_height(scan.vertices)
    heights = np.array([level - error, level, level + error])
    points, at = section_points(scan.vertices, sites.rings["underbust"], Y, heights)
    girths = rough_girths(points[:, [X, Z]], at)
    return float(np.abs(girths - girths[1]).max()) if len(girths) == 3 else np.inf


def joined_arm_contour(scan: Scan, arms: np.ndarray, level: float) -> float:
    """Length of the arms' contour in the loops of a level section that also contain trunk [cm]."""
    heights = scan.vertices[scan.faces, Y]
    cut = scan.faces[(heights.min(axis=1) <= level) & (heights.max(axis=1) > level)]
    segments = section(scan.vertices, cut, Y, level)
    of_arm = arms[cut].any(axis=1)
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    loop = loops(segments)
    trunk_share = np.bincount(loop, weights=length * ~of_arm)
    arm_share = np.bincount(loop, weights=length * of_arm)
    return float(arm_share[trunk_share > MIN_TRUNK * relative_height(scan.vertices)].sum())
