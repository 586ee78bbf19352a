"""What the pixels of a picture show: parts of the body, hair, background, or a panel with its label."""

import re
from collections.abc import Mapping

import numpy as np
from jaxtyping import UInt8
from numpy.typing import ArrayLike

from gcd_dataset.generator.render.pictures import BACKGROUND, GARMENT, HAIR, MapName
from gcd_dataset.records import BodyPart
from gcd_dataset.tensors import PANEL_LABELS

MAPS: tuple[MapName, ...] = ("part", "panel_id")
"""The maps of a picture that tell it."""
_HAIR, _BACKGROUND = len(BodyPart), len(BodyPart) + 1
FIRST_PANEL = len(BodyPart) + 2
"""Label of a pixel of the first panel with ``PANEL_LABELS[0]``; below: body parts, hair, background."""
SHOWN_CLASSES = FIRST_PANEL + len(PANEL_LABELS)
"""What a pixel may show: parts of the body, hair, background, and panels by their label."""
MOST_PANELS = (256 - FIRST_PANEL) // len(PANEL_LABELS)
_SIDES = {"LEFT": "RIGHT", "RIGHT": "LEFT"}
MIRRORED_PIXELS = (
    *(BodyPart[re.sub("LEFT|RIGHT", lambda found: _SIDES[found[0]], part.name)].value for part in BodyPart),
    *range(len(BodyPart), 256),
)
"""The label of a pixel in the mirror image of a picture."""


def pixel_labels(maps: Mapping[str, np.ndarray], labels: ArrayLike) -> UInt8[np.ndarray, "*n h w"]:
    """``FIRST_PANEL`` + number of labels × panel + row of ``PANEL_LABELS``, or less for what is no garment.

    ``maps``: those of ``MAPS``, (…, h, w); ``labels`` (p): row of ``PANEL_LABELS`` of each panel. Panels beyond
    ``MOST_PANELS`` share their labels.
    """
    rows = np.asarray(labels)
    part, panel = maps["part"], np.maximum(maps["panel_id"], 0)
    of_panels = FIRST_PANEL + len(PANEL_LABELS) * (panel % MOST_PANELS) + rows[panel]
    others = np.where(part == HAIR, _HAIR, np.where(part == BACKGROUND, _BACKGROUND, part))
    return np.where(part == GARMENT, of_panels, others).astype(np.uint8)
