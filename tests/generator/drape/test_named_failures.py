"""The failures that Korosteleva et al. (ECCV 2024) name, each with a garment prone to it.

Cuffs beside the wrist, arms under the shirt, skirts and trousers caught on the feet, garments that slide off.
"""

import numpy as np

from gcd_dataset.generator.drape import DrapeConfig
from gcd_dataset.generator.garments import GarmentDesign
from gcd_dataset.generator.garments.circle_skirt import FlareSkirtDesign
from gcd_dataset.generator.garments.design import MetaDesign
from gcd_dataset.generator.garments.pants import PantsDesign
from gcd_dataset.generator.garments.pencil_skirt import PencilSkirtDesign
from gcd_dataset.generator.garments.shirt import ShirtDesign
from gcd_dataset.generator.garments.sleeve import SleeveDesign
from gcd_dataset.generator.garments.wardrobe import Bottom, Upper
from gcd_dataset.records import Outcome
from tests.generator.drape.garments import Axis, Worn, neutral, stouter, wear

ARMS = ("left arm", "right arm")

SHIRT = MetaDesign(upper=Upper.SHIRT)
WIDE = ShirtDesign(width=1.3, length=1.5, flare=1.3)
BOTTOMS = {
    "skirt": GarmentDesign(
        meta=MetaDesign(upper=None, bottom=Bottom.PENCIL), pencil_skirt=PencilSkirtDesign(length=0.4)
    ),
    "circle": GarmentDesign(
        meta=MetaDesign(upper=None, bottom=Bottom.CIRCLE), flare_skirt=FlareSkirtDesign(length=0.2, suns=0.5)
    ),
    "trousers": GarmentDesign(meta=MetaDesign(upper=None, bottom=Bottom.PANTS), pants=PantsDesign(length=0.5)),
}


def test_arms_are_not_under_a_loose_shirt() -> None:
    require_arms_outside_the_shirt(SleeveDesign(connecting_width=1.5))


def require_arms_outside_the_shirt(sleeve: SleeveDesign) -> None:
    """Each arm goes through its own sleeve or armhole, not through the hem or the cloth."""
    worn = wear(GarmentDesign(meta=SHIRT, shirt=WIDE, sleeve=sleeve))
    assert worn.drape.outcome is Outcome.SETTLED
    for arm in ARMS:
        side = arm.split()[0]
        hole = worn.mesh.labels[f"{side}_armhole"] if sleeve.sleeveless else worn.vertices_of(f"{side}_sleeve")
        assert_comes_out(worn, arm, np.asarray(hole))


def assert_comes_out(worn: Worn, arm: str, hole: np.ndarray) -> None:
    """The arm comes out of one rim, on the vertices ``hole``, and pierces no cloth."""
    [rim] = worn.openings(arm)
    assert np.isin(rim, hole).mean() > 0.9  # seam ends have no label
    assert Axis.of(worn.body, arm).pierces(worn.drape.vertices[worn.mesh.faces]) == 0


def test_an_arm_under_the_shirt_is_detected() -> None:
    """The shirt is moved down until its armholes lie below the arms, which then pierce its sides."""
    worn = wear(GarmentDesign(meta=SHIRT, shirt=WIDE, sleeve=SleeveDesign(connecting_width=1.5)))
    lower = worn.drape.vertices - np.array([0.0, 30.0, 0.0])
    for arm in ARMS:
        axis = Axis.of(worn.body, arm)
        assert axis.winding(lower[worn.openings(arm)[0]]) == 0 or axis.pierces(lower[worn.mesh.faces]) > 0


def test_a_garment_cut_too_wide_slides_off_early() -> None:
    require_sliding_off("skirt")


def require_sliding_off(kind: str) -> None:
    """A garment of the right size stays up; cut for 1.5 times the girths, it slides off in a quarter of the frames."""
    _, size = neutral()
    fits, slides = wear(BOTTOMS[kind]), wear(BOTTOMS[kind], cut_for=stouter(size, 1.5))
    assert fits.drape.outcome is Outcome.SETTLED
    assert slides.drape.outcome is Outcome.SLID_OFF
    assert slides.drape.frames < DrapeConfig().max_frames / 4
    assert "narrow the waist" in slides.drape.outcome.value
