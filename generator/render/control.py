"""Control pictures, which picture generators are conditioned on: maps and key points as 8-bit colours."""

import colorsys
from collections.abc import Mapping
from itertools import pairwise
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float, Shaped, UInt8
from PIL import Image, ImageDraw

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.body.keypoints import COCO_KEYPOINTS, FACE
from gcd_dataset.generator.lay_plan import PALETTE, seam_colour
from gcd_dataset.generator.render.geometry import HEM
from gcd_dataset.generator.render.pictures import BACKGROUND, MapName

ControlKind = Literal["normal", "depth", "seams", "parts"]
CONTROL_MAPS: Mapping[ControlKind, tuple[MapName, ...]] = {
    "normal": ("normals",),
    "depth": ("depth",),
    "seams": ("seam",),
    "parts": ("part", "panel_id"),
}
"""The maps that each kind of control picture is made from."""
FARTHEST = 0.2  # brightness of the farthest point, so that it differs from the background
LIMB, JOINT = 0.012, 0.009  # half width of a limb and radius of a joint, as shares of the picture
LIMBS = ("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle")
SUPERSAMPLING = 2


def control_picture(maps: Mapping[str, Shaped[np.ndarray, "h w *c"]], kind: ControlKind) -> UInt8[np.ndarray, "h w 3"]:
    """The control picture of one view, from ``Picture.maps``, or from the maps of an item of ``Views`` by those names.

    - ``normal``: red to the right, green up, blue towards the camera, 128 for 0; the background faces the camera.
    - ``depth``: the inverse of the depth, from the nearest point, white, to the farthest; the background is black.
    - ``seams``: seam lines white, hems grey, on black.
    - ``parts``: panels in the colours of plain pictures, parts of the body and hair in others, on black.

    Raises ``ConfigError`` for another kind, and for a map of ``CONTROL_MAPS`` that is missing.
    """
    if kind not in CONTROL_MAPS:
        raise ConfigError(f"no control picture {kind!r}: there are {', '.join(get_args(ControlKind))}")
    if missing := [name for name in CONTROL_MAPS[kind] if name not in maps]:
        raise ConfigError(f"the control picture {kind} is made from {', '.join(missing)}: render it with these maps")
    first, *others = (np.asarray(maps[name]) for name in CONTROL_MAPS[kind])
    if kind == "normal":
        towards = np.where(first.any(axis=-1, keepdims=True), first * [1.0, -1.0, -1.0], [0.0, 0.0, 1.0])
        return np.rint(127.5 + 127.5 * towards).astype(np.uint8)
    if kind == "depth":
        near = 1.0 / first[first > 0.0]
        share = (near - near.min(initial=np.inf)) / max(float(np.ptp(near)) if len(near) else 0.0, 1e-9)
        grey = np.zeros(first.shape)
        grey[first > 0.0] = 255.0 * (FARTHEST + (1.0 - FARTHEST) * share)
        return np.repeat(np.rint(grey).astype(np.uint8)[..., None], 3, axis=-1)
    if kind == "seams":
        return np.repeat(np.select([first == HEM, first >= 0], [128, 255], 0).astype(np.uint8)[..., None], 3, axis=-1)
    colours = np.array([*map(seam_colour, range(BACKGROUND)), (0, 0, 0)], np.uint8)[first]
    panels = np.rint(255 * np.array(PALETTE)).astype(np.uint8)
    return np.where(others[0][..., None] >= 0, panels[others[0] % len(panels)], colours)


def pose_picture(keypoints: Float[np.ndarray, "17 3"], size: int) -> UInt8[np.ndarray, "h w 3"]:
    """Key points as coloured limbs on black, ``size`` × ``size`` pixels, in the layout and the colours of OpenPose.

    ``keypoints``: ``Picture.keypoints``, or those of a view of an item. Hidden points of the face are left out, as by a
    detector: a figure seen from behind has none.
    """
    points = np.asarray(keypoints)
    at = {
        name: (x, y)
        for name, (x, y, seen) in zip(COCO_KEYPOINTS, (points + [0.5, 0.5, 0.0]).tolist(), strict=True)
        if seen == 2.0 or (seen == 1.0 and name not in FACE)
    }
    if "left_shoulder" in at and "right_shoulder" in at:
        at["neck"] = tuple(np.mean([at["left_shoulder"], at["right_shoulder"]], axis=0).tolist())
    image = Image.new("RGB", (SUPERSAMPLING * size, SUPERSAMPLING * size))
    canvas = ImageDraw.Draw(image)

    def disc(centre: tuple[float, float], radius: float, colour: tuple[int, ...]) -> None:
        x, y = SUPERSAMPLING * centre[0], SUPERSAMPLING * centre[1]
        reach = SUPERSAMPLING * size * radius
        canvas.ellipse((x - reach, y - reach, x + reach, y + reach), fill=colour)

    for number, (start, end) in enumerate(_BONES):
        if start in at and end in at:
            colour = _hue(number, 0.6)
            line = [SUPERSAMPLING * xy for name in (start, end) for xy in at[name]]
            canvas.line(line, fill=colour, width=max(1, round(2 * SUPERSAMPLING * size * LIMB)))
            disc(at[start], LIMB, colour)
            disc(at[end], LIMB, colour)
    for number, name in enumerate(_POINTS):
        if name in at:
            disc(at[name], JOINT, _hue(number, 1.0))
    return np.asarray(image.resize((size, size), Image.Resampling.BOX))


# OpenPose counts the neck, and the right side first; its limbs run round the wheel of hues in this order.
_POINTS = (
    *("nose", "neck"),
    *(f"{side}_{name}" for limb in LIMBS for side in ("right", "left") for name in limb),
    *(f"{side}_{name}" for name in ("eye", "ear") for side in ("right", "left")),
)
_BONES = (
    *(("neck", f"{side}_shoulder") for side in ("right", "left")),
    *((f"{side}_{a}", f"{side}_{b}") for side in ("right", "left") for a, b in pairwise(LIMBS[0])),
    *(
        pair
        for side in ("right", "left")
        for pair in pairwise(("neck", f"{side}_hip", f"{side}_knee", f"{side}_ankle"))
    ),
    ("neck", "nose"),
    *(pair for side in ("right", "left") for pair in pairwise(("nose", f"{side}_eye", f"{side}_ear"))),
)


def _hue(number: int, brightness: float) -> tuple[int, ...]:
    """The hue of a limb or joint, in steps of 20°."""
    return tuple(round(255 * channel) for channel in colorsys.hsv_to_rgb(number / len(_POINTS), 1.0, brightness))
