"""Augmentation of designs: targets of mirror images, and of garments that are scaled with their bodies."""

from dataclasses import replace
from typing import TypeVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from benchmarks.reconstruction.design_codes import PARAMETERS, encode_design
from benchmarks.reconstruction.design_net import DesignTargets
from gcd_dataset.measurements import ANGLES, MEASURES

Targets = TypeVar("Targets", bound=DesignTargets)

PATHS = [leaf.path for leaf in PARAMETERS]
SLITS = ("pencil-skirt.left_slit", "pencil-skirt.right_slit")
TILT, PLACE = PATHS.index("pencil-skirt.low_angle"), PATHS.index("flare-skirt.cut.place")
HALVES, PANELS = PATHS.index("left.enable_asym"), PATHS.index("flare-skirt.skirt-many-panels.n_panels")
"""The programs draw no mirror image of different halves, nor of a skirt of many panels, which begins at one side."""
EQUAL = float(encode_design({"left": {"enable_asym": False}})[HALVES])
CENTIMETRES = (
    "godet-skirt.insert_w", "godet-skirt.insert_depth", "sleeve.standing_shoulder_len",
    "left.sleeve.standing_shoulder_len",
)  # fmt: skip
"""Numbers that are lengths; all others are proportions or angles. Lengths among the choices, such as the depth of a
collar, are whole centimetres up to 10: they are left as they are, off by one at most."""


class DesignAugmentation:
    """Changes the targets of a batch as their garments are changed; its constants lie on one device."""

    def __init__(self, device: torch.device) -> None:
        rows = list(range(len(PATHS)))
        left, right = (PATHS.index(path) for path in SLITS)
        rows[left], rows[right] = right, left
        self._rows = torch.tensor(rows, device=device)
        self._is_length = torch.tensor([name not in ANGLES for name in MEASURES], device=device)
        self._is_centimetres = torch.tensor([path in CENTIMETRES for path in PATHS], device=device)

    def can_mirror(self, targets: DesignTargets) -> Bool[Tensor, " b"]:
        """Whether the mirror image of a garment is one of the same programs."""
        has_equal_halves = ~targets.effective[:, HALVES] | (targets.codes[:, HALVES] == EQUAL)
        return has_equal_halves & ~targets.effective[:, PANELS]

    def mirrored(self, targets: Targets, chosen: Bool[Tensor, " b"]) -> Targets:
        """The targets, of mirror images where ``chosen``."""
        codes = targets.codes[:, self._rows]
        codes[:, TILT] = -codes[:, TILT]
        place = codes[:, PLACE]  # above 0 in front, from the wearer's right: 0 to 1; else behind: -1 to 0
        codes[:, PLACE] = torch.where(place > 0, 1 - place, -1 - place)
        rows = chosen[:, None]
        return replace(
            targets,
            codes=torch.where(rows, codes, targets.codes),
            effective=torch.where(rows, targets.effective[:, self._rows], targets.effective),
        )

    def scaled(self, targets: Targets, scales: Float[Tensor, " b"]) -> Targets:
        """The targets of garments that are scaled with their bodies."""
        by = scales[:, None]
        return replace(
            targets,
            codes=torch.where(self._is_centimetres, targets.codes * by, targets.codes),
            measures=torch.where(self._is_length, targets.measures * by, targets.measures),
        )
