"""A tailor's measures: each is one field of ``Measurements``, with its meaning, unit and formula.

Names and meanings follow GarmentCode's measurement files. To add a measure, add a field: bodies are then measured
for it (``generator.body.measure``), files and shards store it, and garments can use it.

>>> MEASURE["hips_line"].unit, MEASURE["hip_inclination"].unit
('cm', 'degrees')
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal, Protocol, Self, TypeAlias

import numpy as np

from gcd_dataset.errors import BodyError

__all__ = ["ADULT", "ANGLES", "MEASURE", "MEASURES", "Measure", "Measurements", "Tape", "is_adult_height"]

ARMSCYE_EASE = 2.5  # cm, GarmentCode body_params.py
SLEEVE_BALANCE = 2.0  # cm, GarmentCode body_params.py
LARGEST = 1e4  # cm, or degrees: larger than any body
ADULT = (120.0, 230.0)  # cm; heights of adults
PARTS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("bust", ("back_width",)),
    ("bust", ("bust_points",)),
    ("waist", ("waist_back_width",)),
    ("hips", ("hip_back_width",)),
    ("hips", ("bum_points",)),
    ("hips", ("leg_circ",)),
    ("height", ("head_l", "waist_line", "hips_line", "crotch_hip_diff")),
)
"""Measures, each with others whose sum is less than it on any body."""
SIDEWAYS = -0.4  # least cosine between skin normal and tape direction, GarmentCodeData

Unit: TypeAlias = Literal["cm", "degrees"]


class Tape(Protocol):
    """A measuring tape on one body. Landmarks, rings and level sections have names; results in cm and radians."""

    def height(self) -> float:
        """Soles to the top of the head, vertically."""

    def to_crown(self, point: str) -> float:
        """From a point to the top of the head, vertically."""

    def apart(self, point: str, other: str) -> float:
        """From point to point, straight."""

    def above(self, point: str, other: str) -> float:
        """From point to point, vertically."""

    def sinking(self, start: str, end: str) -> float:
        """Angle of the line from ``start`` to ``end`` below the horizontal."""

    def leaning(self, upper: str, lower: str) -> float:
        """Angle between the line from ``upper`` to ``lower`` and the vertical; positive outwards, on the right side."""

    def along(self, ring: str) -> float:
        """Along the points of an open ring."""

    def around(self, ring: str) -> float:
        """Along the points of a closed ring."""

    def down_arm(self) -> float:
        """From shoulder to wrist, the shortest path over the skin."""

    def girth(self, section: str) -> float:
        """Tape round a level section of the trunk."""

    def thigh(self) -> float:
        """Tape round the larger thigh where the legs part."""

    def over_back(self, section: str, left: str, right: str) -> float:
        """Tape over the back of a level section, from side to side."""

    def down_spine(self, upper: str, lower: str) -> float:
        """Tape down the sagittal section of the spine."""

    def over_breast(self, level: str, facing: tuple[float, float], over: float) -> float:
        """Tape over the right breast's sagittal section, from the shoulder to the height of the landmark ``level``.

        It runs over skin whose normal (forward, up) has a cosine of at least ``over`` with ``facing``.
        """


@dataclass(frozen=True)
class Measure:
    """Name, unit and formula of one measure."""

    name: str
    unit: Unit
    """In files; ``Measurements`` holds angles in radians."""
    formula: Callable[[Tape], float]
    """How it is measured [cm, rad]."""
    optional: bool
    """Whether a measurement file may leave it out."""
    on_arms: bool
    """Whether it uses landmarks that are uncertain unless the arms are in the A-pose."""

    def holds(self, value: float) -> bool:
        """Whether a number in a file is in this measure's range."""
        return abs(value) <= LARGEST and (self.unit == "degrees" or value > 0)


def measure(
    formula: Callable[[Tape], float], *, unit: Unit = "cm", optional: bool = False, on_arms: bool = False
) -> Any:
    """A field of ``Measurements``; see ``Measure``."""
    return field(default=np.nan, metadata={"formula": formula, "unit": unit, "optional": optional, "on_arms": on_arms})


@dataclass(frozen=True, eq=False)
class Measurements:
    """A tailor's measures [cm]; inclinations [rad]. NaN marks a missing measure.

    Measurements are equal if the same measures are present, with equal values.
    """

    height: float = measure(lambda tape: tape.height())
    """Soles to the top of the head, vertically."""
    head_l: float = measure(lambda tape: tape.to_crown("nape_of_neck"))
    """Nape of the neck to the top of the head, vertically."""
    neck_w: float = measure(lambda tape: tape.along("neck_back"))
    """Neck base round the back, from one side-neck point to the other, over the nape."""
    shoulder_w: float = measure(lambda tape: tape.apart("shoulder_left", "shoulder_right"), on_arms=True)
    """Shoulder point to shoulder point, straight."""
    shoulder_incl: float = measure(
        lambda tape: tape.sinking("neck_right", "shoulder_right"), unit="degrees", on_arms=True
    )
    """Slope of the shoulder below the horizontal [rad]."""
    armscye_depth: float = measure(lambda tape: tape.apart("shoulder_right", "underarm_right"), on_arms=True)
    """Shoulder point to underarm point, straight."""
    arm_length: float = measure(lambda tape: tape.down_arm(), on_arms=True)
    """Shoulder to wrist over the skin."""
    arm_pose_angle: float = measure(lambda tape: tape.sinking("shoulder_right", "wrist_right"), unit="degrees")
    """Angle of the arm below the horizontal [rad]."""
    wrist: float = measure(lambda tape: tape.around("wrist_right"))
    """Round the wrist."""
    bust: float = measure(lambda tape: tape.girth("bust"))
    """Round the fullest level section of the chest."""
    underbust: float = measure(lambda tape: tape.girth("underbust"), optional=True)
    """Round the level section below the breasts; no pattern needs it."""
    waist: float = measure(lambda tape: tape.girth("waist"))
    """Round the narrowest level section of the waist."""
    hips: float = measure(lambda tape: tape.girth("hips"))
    """Round the fullest level section of the hips."""
    leg_circ: float = measure(lambda tape: tape.thigh())
    """Round the larger thigh, where the legs part."""
    waist_back_width: float = measure(lambda tape: tape.over_back("waist", "waist_side_left", "waist_side_right"))
    """Over the back at waist level, from side to side."""
    back_width: float = measure(lambda tape: tape.over_back("bust", "bust_side_left", "bust_side_right"))
    """Over the back at bust level, from side to side."""
    hip_back_width: float = measure(lambda tape: tape.over_back("hips", "hips_side_left", "hips_side_right"))
    """Over the buttocks at hip level, from side to side."""
    bust_points: float = measure(lambda tape: tape.apart("bust_left", "bust_right"), on_arms=True)
    """Breast point to breast point, straight."""
    bum_points: float = measure(lambda tape: tape.apart("bum_left", "bum_right"))
    """Apex to apex of the buttocks, straight."""
    waist_line: float = measure(lambda tape: tape.down_spine("nape_of_neck", "mid_waist_back"))
    """Nape to waist along the back."""
    waist_over_bust_line: float = measure(
        lambda tape: tape.over_breast("mid_waist_back", (1.0, 0.5), SIDEWAYS), on_arms=True
    )
    """Shoulder to waist level over the right breast."""
    bust_line: float = measure(lambda tape: tape.over_breast("bust_right", (1.0, 1.0), 0.0))
    """Shoulder to the breast point's level over the right breast."""
    vert_bust_line: float = measure(lambda tape: tape.above("nape_of_neck", "bust_side_right"), optional=True)
    """Nape to bust level, vertically; GarmentCode's SMPL bodies lack it."""
    hips_line: float = measure(lambda tape: tape.above("waist_side_right", "hips_side_right"))
    """Waist to hips at the side, vertically."""
    hip_inclination: float = measure(lambda tape: tape.leaning("waist_side_right", "hips_side_right"), unit="degrees")
    """Lean of the side between hips and waist from the vertical [rad]."""
    crotch_hip_diff: float = measure(lambda tape: tape.above("hips_side_right", "crotch_point"))
    """Hip level to crotch, vertically."""

    @classmethod
    def from_file_values(cls, values: Mapping[str, float]) -> Self:
        """From the numbers of a measurement file: angles in degrees; unknown and derived (``_…``) keys are ignored."""
        known = {key: float(value) for key, value in values.items() if key in MEASURES}
        return cls(**{key: float(np.radians(value)) if key in ANGLES else value for key, value in known.items()})

    def to_file_values(self) -> dict[str, float]:
        """The numbers as a measurement file holds them: angles in degrees, without missing measures."""
        values = {key: float(getattr(self, key)) for key in MEASURES}
        return {
            key: float(np.degrees(value)) if key in ANGLES else value
            for key, value in values.items()
            if not np.isnan(value)
        }

    def __eq__(self, other: object) -> bool:
        # The method that dataclasses generate compares fields with ==, and NaN differs from itself.
        return self._present() == other._present() if isinstance(other, Measurements) else NotImplemented

    def __hash__(self) -> int:
        return hash(tuple(self._present().items()))

    def _present(self) -> dict[str, float]:
        return {name: value for name, value in vars(self).items() if not math.isnan(value)}

    def require(self, *names: str) -> Self:
        """These measurements. Raises ``BodyError`` with the names that are missing."""
        missing = [name for name in names if np.isnan(getattr(self, name))]
        if missing:
            raise BodyError(f"measures {', '.join(missing)} are missing: add them to the measurement file")
        return self

    def require_parts(self) -> Self:
        """These measurements. Raises ``BodyError`` where ``PARTS`` are negative, or not less than their whole."""
        for whole, names in PARTS:
            length, parts = getattr(self, whole), [getattr(self, name) for name in names]
            if min(parts) < 0 or sum(parts) <= 0 or sum(parts) >= length:
                figures = f"{' + '.join(names)} is {' + '.join(f'{part:.1f}' for part in parts)} cm"
                figures += f", and {whole} is {length:.1f} cm"
                raise BodyError(f"{figures}: parts are less than the whole, so correct these measures")
        return self

    @property
    def waist_level(self) -> float:
        """Height of the waist over the floor [cm]."""
        return self.height - self.head_l - self.waist_line

    @property
    def leg_length(self) -> float:
        """Hip line to floor [cm]."""
        return self.waist_level - self.hips_line

    @property
    def sleeve_balance(self) -> float:
        """Distance between the armholes' shoulder ends [cm]."""
        return self.shoulder_w - SLEEVE_BALANCE

    @property
    def drawn_bust_line(self) -> float:
        """Bust line for drawing patterns: two thirds vertical, one third over the bust [cm]."""
        if np.isnan(self.vert_bust_line):
            return self.bust_line
        return 2 / 3 * self.vert_bust_line + 1 / 3 * self.bust_line

    @property
    def drawn_hip_inclination(self) -> float:
        """Hip inclination for drawing patterns: half the measured one [rad]."""
        return self.hip_inclination / 2

    @property
    def eased_armscye_depth(self) -> float:
        """Armscye depth with ease [cm]."""
        return self.armscye_depth + ARMSCYE_EASE


MEASURE: Mapping[str, Measure] = {entry.name: Measure(entry.name, **entry.metadata) for entry in fields(Measurements)}
"""Name, unit and formula of each measure, by name."""
MEASURES: tuple[str, ...] = tuple(MEASURE)
"""The keys of a measurement file: the 26 of GarmentCode, then added fields. Values in cm; inclinations in degrees."""
ANGLES = frozenset(name for name, known in MEASURE.items() if known.unit == "degrees")


def is_adult_height(height: float) -> bool:
    """Whether an adult may be so tall [cm]."""
    return ADULT[0] <= height <= ADULT[1]
