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
from tests.generator.drape.garments import LIMBS, SIDES, Axis, Worn, neutral, rims, stouter, wear
from tests.helpers import tube

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


def test_winding_and_piercing_of_a_tube() -> None:
    """A rim winds once round the tube's axis, not round a line beside it; an oblique line pierces the wall."""
    cloth = tube(12, 6, radius=4.0, spacing=2.0)
    upper, lower = rims(cloth.faces)
    assert len(upper) == len(lower) == 12
    inside, beside = (Axis(np.array([x, 20.0, 0.0]), np.array([x, -5.0, 0.0])) for x in (1.0, 6.0))
    oblique = Axis(np.array([0.0, 6.0, 0.0]), np.array([20.0, 5.0, 0.3]))
    for rim in (upper, lower):
        assert (inside.winding(cloth.vertices[rim]), beside.winding(cloth.vertices[rim])) == (1, 0)
    triangles = cloth.vertices[cloth.faces]
    assert [axis.pierces(triangles) for axis in (inside, beside, oblique)] == [0, 0, 1]


def test_axes_follow_the_arms() -> None:
    body, _ = neutral()
    for arm in ARMS:
        axis = Axis.of(body, arm)
        skin = body.vertices[body.parts == LIMBS[arm].value]
        assert 0.0 < axis.share(skin).min() + 1e-6 < axis.share(skin).max() < 0.9  # the rest is the hand
        assert np.sign(axis.end[0]) == SIDES[arm.split()[0]]


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
    axis = Axis.of(worn.body, arm)
    assert axis.pierces(worn.drape.vertices[worn.mesh.faces]) == 0


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
