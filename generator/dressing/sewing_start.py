"""Start positions of sewing: wide skirts on a cone, wide bodices between the arms, sleeves round the arms.

A pattern places panels flat before and behind the wearer. Closing seams from there tangles four kinds of cloth:

- A skirt of large discs, or of several rings one below the other, reaches above its own top and lies before the arms.
- A bodice wider than the room between the arms is sewn round the arms.
- A sleeve placed beside its arm, or a trouser leg beside its leg, is not sewn round it.
- A narrow skirt that reaches the floor is sewn through the feet.

Wide skirts start on a cone, such bodices between the arms and narrow skirts above the feet, all compressed; such tubes
start round their limbs.
While the seams close, the rest lengths of the springs change from the start lengths to the flat lengths, which spreads
the cloth.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import ConvexHull

from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body.limbs import Limb, leg_of, limbs_of
from gcd_dataset.generator.dressing.skirt_on_cone import Skirt
from gcd_dataset.generator.dressing.tube_on_limb import put_on_limb, roll_round_limb
from gcd_dataset.generator.dressing.worn import WornCloth, on_side
from gcd_dataset.generator.mesh.rows import distinct
from gcd_dataset.records import Body, BodyPart, BoxMesh, EdgeRole, PanelRole
from gcd_dataset.spec import is_trouser_leg

ARM_GAP = 1.5  # cm between a bodice and the inside of an arm
ARMPIT = 22.0  # cm below the top of the arm's skin: the armhole surrounds the arm above this height
UNDER_CROTCH = 2.0  # cm below the crotch seam, where a trouser leg is a tube
LOOSE_HEM = 60.0  # cm, girth of a tube that does not catch on the foot
LEG_GAP = -1.5  # cm by which a trouser leg must reach beyond the leg: thighs touch each other
UPRIGHT = 0.5  # least vertical part of a leg's direction at which the legs stand on either side of the middle
SLEEVE_GAP = 1.0  # cm between a sleeve below its armhole and the trunk, or the cloth round it
MIDDLE_GAP = 0.5  # cm between a trouser leg and the plane between the legs
FEET_ROOM = 1.25  # least girth of a skirt that is sewn round the feet, as a multiple of the girth of both feet
ANKLES_BELOW = 0.12  # share of the body's height below which the ankles lie
SKIRT_GAP = 1.0  # cm that a skirt above the feet must reach beyond the legs on either side
LEGS = (BodyPart.LEFT_LEG, BodyPart.RIGHT_LEG, BodyPart.FEET)
SLICE = 2.0  # cm, height of the slices in which the widths of bodice and room are compared


def sewing_start(mesh: BoxMesh, body: Body, under: Sequence[WornCloth] = ()) -> Float[np.ndarray, "v 3"]:
    """The start positions of a garment's vertices on a body [cm]: ``mesh.vertices`` except in the cases above.

    ``under``: the garments on the body, over which this one is put on.
    """
    roles = np.array([str(role) for role in mesh.panel_labels])
    trousers = np.array([is_trouser_leg(name) for name in mesh.panel_names])
    skirts = (roles == PanelRole.LEG) & ~trousers
    skirt = Skirt.of(mesh, skirts) if skirts.any() else None
    bodice, sleeves = (roles == PanelRole.BODY).any(), (roles == PanelRole.ARM).any()
    if not (skirts.any() or bodice or sleeves or trousers.any()):
        return mesh.vertices
    try:
        limbs = {part: _over(limb, part, under) for part, limb in limbs_of(body).items()}
    except BodyError:  # a body without a trunk, such as a ball
        return mesh.vertices
    placed = np.array(mesh.vertices, float)
    if skirt is not None and np.isin(mesh.folds[:, :2], mesh.corners[skirts[mesh.panel_id]]).any():
        skirt.place_folded(limbs[BodyPart.TRUNK], placed)
    elif skirt is not None and skirt.is_wide:
        skirt.place_on_cone(limbs[BodyPart.TRUNK], placed)
    elif skirts.any():
        _end_above_feet(distinct(mesh.faces[skirts[mesh.panel_id]], len(placed)), body, placed)
    arms = [(limbs[p], side) for p, side in ((BodyPart.LEFT_ARM, 1.0), (BodyPart.RIGHT_ARM, -1.0)) if p in limbs]
    for arm, side in arms if bodice else ():
        _fit_between_arms(mesh, roles, arm, side, placed)
    for arm, side in arms if sleeves else ():
        sleeve = on_side(mesh, roles == PanelRole.ARM, side)
        if not roll_round_limb(mesh, sleeve, arm, placed):
            put_on_limb(mesh, sleeve, arm, placed)
        _keep_beside_trunk(mesh, sleeve, arm, side, limbs[BodyPart.TRUNK], placed)
    if trousers.any():
        _put_on_legs(mesh, trousers, body, under, placed)
    return placed


def _over(limb: Limb, part: BodyPart, under: Sequence[WornCloth]) -> Limb:
    """A limb with the cloth on it as its skin; that on the legs belongs to the trunk too."""
    parts = [each.value for each in (LEGS[:2] if part is BodyPart.TRUNK else ())] + [part.value]
    return limb.clad(np.concatenate([np.zeros((0, 3)), *(c.vertices[np.isin(c.parts, parts)] for c in under)]))


def _keep_beside_trunk(
    mesh: BoxMesh, sleeve: Bool[np.ndarray, " f"], arm: Limb, side: float, trunk: Limb, placed: Float[np.ndarray, "v 3"]
) -> None:
    """Compress a sleeve, in ``placed``, where it reaches below its armhole into the trunk or into cloth beside it.

    It is compressed towards the inside of the arm, or where there is no arm towards its own outside.
    """
    own, other = np.zeros((2, len(placed)), bool)
    own[mesh.faces[sleeve]] = other[mesh.faces[~sleeve]] = True
    below = placed[:, 1] < placed[own & other, 1].min(initial=np.inf)
    rows = np.flatnonzero(own & ~other & below)
    beside = np.concatenate([placed[other], trunk.skin])
    beside = beside[side * beside[:, 0] > 0.0]
    if not (other & own).any() or not (len(rows) and len(beside)):
        return
    x, height = side * placed[rows, 0], placed[rows, 1]
    slices, others, arm_slices = (np.floor(y / SLICE).astype(int) for y in (height, beside[:, 1], arm.skin[:, 1]))
    _, _, near_arm, arm_slices = _from_lowest(slices, arm_slices)
    slices, count, near, others = _from_lowest(slices, others)
    inmost, outmost = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(inmost, slices, x)
    np.maximum.at(outmost, slices, x)
    room = _most_beside(others, side * beside[near, 0], count, least=-np.inf) + SLEEVE_GAP
    inside_arm = -_most_beside(arm_slices, -side * arm.skin[near_arm, 0], count, least=-np.inf) - SLEEVE_GAP
    fixed = np.minimum(np.maximum(outmost, room + SLEEVE_GAP), inside_arm)
    moved = ((inmost < room) & (inmost < fixed))[slices] & (x < fixed[slices])
    fixed, room, inmost = (each[slices[moved]] for each in (fixed, room, inmost))
    scale = np.maximum(fixed - room, 0.0) / np.maximum(fixed - inmost, SLEEVE_GAP)
    placed[rows[moved], 0] = side * (fixed - scale * (fixed - x[moved]))


def _put_on_legs(
    mesh: BoxMesh,
    trousers: Bool[np.ndarray, " p"],
    body: Body,
    under: Sequence[WornCloth],
    placed: Float[np.ndarray, "v 3"],
) -> None:
    """Put trouser legs, below the crotch, on the legs, in ``placed``.

    The crotch is the lowest point at which both trouser legs meet.
    """
    y = mesh.vertices[:, 1][mesh.faces].mean(axis=1)
    sides = [on_side(mesh, trousers, side) for side in (1.0, -1.0)]
    left, right = np.zeros((2, len(mesh.vertices)), bool)
    left[mesh.faces[sides[0]]] = right[mesh.faces[sides[1]]] = True
    joined = left & right
    if not joined.any():
        return
    crotch = float(mesh.vertices[joined, 1].min()) - UNDER_CROTCH
    for part, side, faces_of_side in zip(LEGS[:2], (1.0, -1.0), sides, strict=True):
        below = faces_of_side & (y < crotch)
        if (leg := leg_of(body, part)) is not None:
            put_on_limb(mesh, below, _over(leg, part, under), placed, gap=LEG_GAP, loose=LOOSE_HEM)
            if below.any() and abs(leg.axis[1]) > UPRIGHT:
                _keep_off_the_other_leg(distinct(mesh.faces[below], len(placed)), leg, side, placed)


def _keep_off_the_other_leg(
    rows: Int[np.ndarray, " n"], leg: Limb, side: float, placed: Float[np.ndarray, "v 3"]
) -> None:
    """Compress a trouser leg, between the leg's axis and the body's middle, where it reaches past the middle."""
    height, x = placed[rows, 1], side * placed[rows, 0]
    axis = side * (leg.origin[0] + leg.axis[0] / leg.axis[1] * (height - leg.origin[1]))
    slices = np.floor(height / SLICE).astype(int)
    numbers = np.unique(slices)
    inmost = np.interp(height / SLICE, numbers + 0.5, [x[slices == number].min() for number in numbers])
    scale = np.minimum((axis - MIDDLE_GAP) / np.maximum(axis - inmost, MIDDLE_GAP), 1.0)
    placed[rows, 0] = side * np.where(x < axis, np.maximum(axis - scale * (axis - x), MIDDLE_GAP), x)


def _end_above_feet(rows: Int[np.ndarray, " n"], body: Body, placed: Float[np.ndarray, "v 3"]) -> None:
    """Compress a skirt that is too narrow to be sewn round the feet, in ``placed``, to end above them.

    The skirt is centred on the legs, and widened where it does not reach beyond both. ``rows``: vertices of the skirt.
    """
    legs = [leg_of(body, part) for part in (BodyPart.LEFT_LEG, BodyPart.RIGHT_LEG)]
    if any(leg is None or abs(leg.axis[1]) < UPRIGHT for leg in legs):
        return
    both = body.vertices[np.isin(body.parts, [part.value for part in LEGS])]
    ankle = _ankle_height(both, body)
    x, height = placed[rows, 0], placed[rows, 1]
    top, hem = float(height.max()), float(height.min())
    below = x[height < ankle]
    if top <= ankle or not len(below):
        return
    feet = both[both[:, 1] < ankle]
    around = below.min() < feet[:, 0].min() - SKIRT_GAP and below.max() > feet[:, 0].max() + SKIRT_GAP
    if around and 2.0 * np.ptp(below) >= FEET_ROOM * ConvexHull(feet[:, [0, 2]]).area:
        return  # it surrounds the feet, with room to spare
    middle = 0.5 * float(both[:, 0].min() + both[:, 0].max())
    at_top = x[height > top - SLICE]
    aside = x - 0.5 * float(at_top.min() + at_top.max())
    height = top - (top - height) * (top - ankle) / (top - hem)
    slices, leg_slices = (np.floor(y / SLICE).astype(int) for y in (height, both[:, 1]))
    slices, count, beside, leg_slices = _from_lowest(slices, leg_slices)
    need = _most_beside(leg_slices, np.abs(both[beside, 0] - middle), count, least=-SKIRT_GAP) + SKIRT_GAP
    for side in (1.0, -1.0):
        own = side * aside > 0.0
        reach = np.full(count, SLICE)
        np.maximum.at(reach, slices[own], np.abs(aside[own]))
        aside[own] *= np.maximum(1.0, need / reach)[slices[own]]
    placed[rows, 0], placed[rows, 1] = middle + aside, height


def _ankle_height(legs: Float[np.ndarray, "n 3"], body: Body) -> float:
    """Height of the ankles, where legs with feet are least deep [cm]; some segmentations count feet as legs."""
    floor, top = float(body.vertices[:, 1].min()), float(body.vertices[:, 1].max())
    slices = np.floor((legs[:, 1] - floor) / SLICE).astype(int)
    lowest = (slices + 1) * SLICE < ANKLES_BELOW * (top - floor)
    depth, slices = legs[lowest, 2], slices[lowest]
    low = np.unique(slices)
    depths = [np.ptp(depth[slices == number]) for number in low]
    return floor + (low[int(np.argmin(depths))] + 1) * SLICE if len(low) else floor


def _from_lowest(
    slices: Int[np.ndarray, " n"], others: Int[np.ndarray, " m"]
) -> tuple[Int[np.ndarray, " n"], int, Bool[np.ndarray, " m"], Int[np.ndarray, " k"]]:
    """Slices counted from the lowest, their number, and the others at or beside one of them, counted likewise."""
    lowest = int(slices.min())
    count = int(slices.max()) - lowest + 1
    beside = (others >= lowest - 1) & (others <= lowest + count)
    return slices - lowest, count, beside, others[beside] - lowest


def _most_beside(
    slices: Int[np.ndarray, " k"], values: Float[np.ndarray, " k"], count: int, *, least: float
) -> Float[np.ndarray, " c"]:
    """The largest value in each slice and the slices next to it; ``slices``: from -1 to ``count``."""
    most = np.full(count + 2, least)
    np.maximum.at(most, slices + 1, values)
    return np.maximum(np.maximum(most[:-2], most[1:-1]), most[2:])


def _fit_between_arms(
    mesh: BoxMesh, roles: np.ndarray, arm: Limb, side: float, placed: Float[np.ndarray, "v 3"]
) -> None:
    """Compress one side of a bodice, in ``placed``, to the room inside the arm.

    The room is the distance from the body's middle to the arm's skin, less ``ARM_GAP``, at the height of each slice.
    Above an armhole without sleeve the compression decreases: the arm must pass above the armhole's lowest point.
    ``side``: 1 for the left side, -1 for the right.
    """
    x, faces = side * mesh.vertices[:, 0], mesh.faces
    sleeve = faces[(roles == PanelRole.ARM)[mesh.panel_id]]
    sleeve = sleeve[x[sleeve].sum(axis=1) > 0.0]
    own = np.zeros(len(x), bool)
    own[faces[(roles == PanelRole.BODY)[mesh.panel_id]]] = True
    own[sleeve] = False
    bodice = np.flatnonzero(own & (x > 0.0))
    bodice = bodice[(placed[bodice] == mesh.vertices[bodice]).all(axis=1)]  # without vertices of a skirt on a cone
    height, reach = mesh.vertices[bodice, 1], side * mesh.vertices[bodice, 0]
    slices, arm_slices = (np.floor(y / SLICE).astype(int) for y in (height, arm.skin[:, 1]))
    armhole = mesh.vertices[mesh.labels.get(EdgeRole.LEFT_ARMHOLE if side > 0.0 else EdgeRole.RIGHT_ARMHOLE, []), 1]
    armpit = min(float(arm.skin[:, 1].max()) - ARMPIT, float(armhole.min(initial=np.inf)))
    scale, under = 1.0, height < armpit
    if under.any():
        slices, count, beside, arm_slices = _from_lowest(slices[under], arm_slices)
        room = -_most_beside(arm_slices, -side * arm.skin[beside, 0], count, least=-np.inf) - ARM_GAP
        widest = np.zeros(count)
        np.maximum.at(widest, slices, reach[under])
        scales = np.ones(count)
        tight = np.flatnonzero((room > 0.0) & (room < widest))
        scales[tight] = room[tight] / widest[tight]
        placed[bodice[under], 0] *= scales[slices]
        scale = scales[(widest > 0.0) & (room < np.inf)][-1:].min(initial=1.0)
    if scale < 1.0 and len(armhole) and not len(sleeve):
        above = height >= armpit
        share = np.clip((height[above] - armpit) / max(float(armhole.max()) - armpit, SLICE), 0.0, 1.0)
        placed[bodice[above], 0] *= scale + (1.0 - scale) * share
