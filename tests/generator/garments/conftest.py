"""Designs of every garment, and five wearers: three adults, a doll and a giant."""

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import pytest

from gcd_dataset.generator.garments import GarmentDesign, design_from_dict
from gcd_dataset.generator.garments.wardrobe import Bottom, Upper
from gcd_dataset.records import ANGLES, Measurements

WOMAN = Measurements(
    height=166.0, head_l=25.5, neck_w=17.8, shoulder_w=34.7, shoulder_incl=0.365, armscye_depth=12.6, arm_length=51.6,
    arm_pose_angle=0.794, wrist=15.9, bust=97.4, underbust=80.7, waist=80.3, hips=104.0, leg_circ=60.7,
    waist_back_width=37.8, back_width=46.2, hip_back_width=55.7, bust_points=16.2, bum_points=17.7, waist_line=35.8,
    waist_over_bust_line=40.0, bust_line=25.6, vert_bust_line=20.8, hips_line=22.6, hip_inclination=0.22,
    crotch_hip_diff=7.9,
)  # fmt: skip
MAN = replace(
    WOMAN, height=178.9, head_l=27.3, neck_w=20.3, shoulder_w=38.5, shoulder_incl=0.393, armscye_depth=13.1,
    arm_length=56.8, wrist=17.5, bust=102.8, waist=89.0, hips=102.9, waist_back_width=40.7, back_width=50.7,
    hip_back_width=53.9, waist_line=38.3, bust_line=25.9, vert_bust_line=21.6, hips_line=24.5,
)  # fmt: skip
STOUT = replace(
    WOMAN, bust=128.0, back_width=58.0, waist=124.0, waist_back_width=56.0, hips=130.0, hip_back_width=66.0,
    shoulder_w=39.0, neck_w=21.0, armscye_depth=15.5, wrist=18.5, leg_circ=76.0, bust_line=30.0, vert_bust_line=24.5,
)  # fmt: skip


def scaled(size: Measurements, factor: float) -> Measurements:
    """The same proportions at another scale."""
    lengths = {f.name: factor * getattr(size, f.name) for f in fields(size) if f.name not in ANGLES}
    return replace(size, **lengths)


WEARERS = {"woman": WOMAN, "man": MAN, "stout": STOUT, "doll": scaled(WOMAN, 0.3), "giant": scaled(MAN, 3.0)}

SHIRT = {"upper": "Shirt"}
SKIRT = {"upper": None, "bottom": "SkirtCircle"}
DRESS = {"upper": "Shirt", "bottom": "SkirtCircle"}
LONG_SLEEVES = {"sleeveless": False, "length": 0.9, "cuff": {"type": "CuffBand", "cuff_len": 0.1}}
GODETS = {"insert_depth": 10, "insert_w": 10}  # cm: the largest that fit into a doll's skirt
DESIGNS: dict[str, Mapping[str, Any]] = {
    "sleeveless": {"meta": SHIRT, "sleeve": {"sleeveless": True}, "collar": {"f_collar": "VNeckHalf"}},
    "sleeves": {"meta": SHIRT, "sleeve": {"sleeveless": False}},
    "gathered sleeves": {"meta": SHIRT, "sleeve": {"sleeveless": False, "connect_ruffle": 1.6, "sleeve_angle": 40}},
    "hoodie": {"meta": SHIRT, "sleeve": LONG_SLEEVES, "collar": {"component": {"style": "Hood2Panels"}}},
    "cardigan": {
        "meta": SHIRT,
        "front": {"closure": "open"},
        "sleeve": LONG_SLEEVES,
        "collar": {"f_collar": "VNeckHalf"},
    },
    "zip jacket": {
        "meta": SHIRT,
        "front": {"closure": "zip", "open_top": 0.3, "open_hem": 0.2},
        "collar": {"component": {"style": "Hood2Panels"}},
    },
    "button-stand shirt": {
        "meta": {"upper": "FittedShirt", "bottom": "SkirtCircle"},
        "front": {"closure": "buttons", "over": "right"},
    },
    "open vest with a band": {
        "meta": SHIRT | {"wb": "FittedWB"},
        "front": {"closure": "open"},
        "sleeve": {"sleeveless": True},
        "waistband": {"width": 0.4},
    },
    "tucked shirt with a placket": {
        "meta": SHIRT,
        "front": {"closure": "buttons"},
        "trim": {"tucks": 4, "buttonholes": 6},
        "pocket": {"chest": "left"},
    },
    "trousers with welt pockets": {"meta": {"bottom": "Pants"}, "pocket": {"back": "both", "kind": "welt"}},
    "pleats under a yoke": {
        "meta": {"wb": "FittedWB", "bottom": "PleatedSkirt"},
        "waistband": {"width": 0.8},
        "pleated-skirt": {"length": 0.1, "depth": 0.5},
    },
    "open vest": {"meta": SHIRT, "front": {"closure": "open"}, "sleeve": {"sleeveless": True}},
    "flared shirt": {"meta": SHIRT, "shirt": {"flare": 1.4, "length": 2.0}},
    "skirt, fitted band": {"meta": SKIRT | {"wb": "FittedWB"}, "waistband": {"width": 0.4}},
    "wide skirt": {"meta": SKIRT | {"wb": "StraightWB"}, "flare-skirt": {"suns": 1.8, "length": 0.5}},
    "skirt with a cut": {"meta": SKIRT, "flare-skirt": {"cut": {"add": True, "place": 0.3}}},
    "dress": {"meta": DRESS},
    "dress, straight band": {"meta": DRESS | {"wb": "StraightWB"}},
    "dress, fitted band": {"meta": DRESS | {"wb": "FittedWB"}, "flare-skirt": {"rise": 0.7}},
    "round poncho": {"meta": {"upper": "Poncho"}, "poncho": {"shape": "Circle", "neckline": "VNeckHalf"}},
    "narrow cape": {"meta": {"upper": "Cape"}, "cape": {"circle": 0.5, "closed": 1.0}},
    **{upper.value: {"meta": {"upper": upper.value}} for upper in Upper},
    **{bottom.value: {"meta": {"upper": None, "bottom": bottom.value}, "godet-skirt": GODETS} for bottom in Bottom},
}
"""Designs of the battery: every garment of the wardrobe with its defaults, and some with other parameters."""


@pytest.fixture(params=WEARERS)
def wearer(request: pytest.FixtureRequest) -> Measurements:
    """Each wearer in turn."""
    return WEARERS[request.param]


@pytest.fixture
def woman() -> Measurements:
    """An adult of usual size."""
    return WOMAN


@pytest.fixture
def giant() -> Measurements:
    """A man three times as tall, for an example of CONTRIBUTING."""
    return WEARERS["giant"]


@pytest.fixture(params=DESIGNS)
def design(request: pytest.FixtureRequest) -> GarmentDesign:
    """Each garment of the battery in turn."""
    return design_from_dict(DESIGNS[request.param])
