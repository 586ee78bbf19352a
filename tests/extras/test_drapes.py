"""Drapes of more garments than the quick tests wait for."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gcd_dataset.generator.body import named_body
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob, drape_batch
from gcd_dataset.generator.dressing import dress, has_legs
from gcd_dataset.generator.fitting import Fitting, drape_patterns
from gcd_dataset.generator.garments import GarmentDesign, design_from_dict
from gcd_dataset.generator.garments.cuff import Cuff, SleeveCuffDesign
from gcd_dataset.generator.garments.design import MetaDesign
from gcd_dataset.generator.garments.gathered_skirt import GatheredSkirtDesign
from gcd_dataset.generator.garments.pants import PantsDesign
from gcd_dataset.generator.garments.sleeve import SleeveDesign
from gcd_dataset.generator.garments.waistband import Waistband, WaistbandDesign
from gcd_dataset.generator.garments.wardrobe import Bottom
from gcd_dataset.generator.mesh import build_box_mesh
from gcd_dataset.records import Outcome
from gcd_dataset.spec import pattern_from_spec, read_pattern, spec_from_pattern
from tests.generator.drape.garments import SIDES, Axis, Worn, neutral, wear
from tests.generator.drape.test_named_failures import (
    ARMS,
    SHIRT,
    assert_comes_out,
    require_arms_outside_the_shirt,
    require_sliding_off,
)
from tests.generator.dressing.test_dressing import bared, pattern_of
from tests.generator.dressing.test_sewing_start import LEVELS
from tests.helpers import renamed

FOREARM_FROM = 0.45  # share of the way from shoulder to finger tips
INSTEP = 6.5  # cm
UNDER_TOES = 2.0  # cm: without a floor, cloth over the toes may hang back under the sole
TOES = 10  # cloth edges that may cross toes, which are thinner than the 3 cm spacing
FULL_SKIRT = GarmentDesign(
    meta=MetaDesign(upper=None, wb=Waistband.STRAIGHT, bottom=Bottom.GATHERED),
    waistband=WaistbandDesign(width=0.4),
    skirt=GatheredSkirtDesign(length=0.95, ruffle=1.7, flare=20),
)
WIDE_TROUSERS = GarmentDesign(
    meta=MetaDesign(upper=None, bottom=Bottom.PANTS), pants=PantsDesign(length=0.9, width=1.5, flare=1.2)
)


def test_a_shirt_without_placements_and_labels_drapes(examples: Path) -> None:
    wearer = named_body("neutral")[:2]
    shirt = read_pattern(examples / "patterns" / "shirt_mean_specification.json")
    spec = spec_from_pattern(bared(shirt, placed=False))
    for panel in spec["pattern"]["panels"].values():
        del panel["translation"], panel["rotation"]
    dressed = dress(pattern_from_spec(spec, "shirt"), *wearer)
    assert [panel.label for panel in dressed.pattern.panels].count("arm") == 4
    mesh = build_box_mesh(dressed.pattern, spacing=3.5)
    [drape] = drape_batch([DrapeJob(mesh, *wearer)], DrapeConfig(max_frames=150), device="cpu")
    assert drape.outcome is Outcome.SETTLED
    assert drape.vertices[:, 1].mean() > wearer[1].waist_level


def test_trousers_from_a_lay_plan_are_draped_on_legs_apart(examples: Path) -> None:
    """``has_legs`` recognises such trousers only after their panels have been placed."""
    lying = bared(pattern_of(examples, "pants_cuff"), placed=False)
    names = {panel.name: f"piece_{number}" for number, panel in enumerate(lying.panels)}
    wearers = {apart: named_body("neutral", legs_apart=apart)[:2] for apart in (False, True)}
    pattern = replace(renamed(lying, names), name="piece", extra={})
    assert not has_legs(pattern)
    [fitting] = drape_patterns([pattern], wearers.__getitem__, resolution=6.0, device="cpu")
    assert isinstance(fitting, Fitting)
    assert fitting.body is wearers[True][0]


def test_a_skirt_of_many_levels_settles_nearly_without_crossings() -> None:
    """Up to five edges still cross: the mesh is as coarse as its folds."""
    worn = wear(design_from_dict(LEVELS), spacing=3.5)
    assert worn.drape.self_crossings <= 5
    assert worn.drape.body_crossings + worn.drape.body_through == 0
    assert worn.drape.stretch_p99 < 1.3


def test_trousers_longer_than_the_legs_are_not_caught_on_the_feet() -> None:
    """Each foot is inside its own hem; the trousers are cut for a wearer 12 cm taller."""
    _, size = neutral()
    worn = wear(WIDE_TROUSERS, cut_for=replace(size, height=size.height + 12.0))
    assert worn.drape.outcome is Outcome.SETTLED
    for side, sign in SIDES.items():
        [hem] = worn.openings(f"{side} leg")
        assert (sign * worn.drape.vertices[hem, 0]).min() > 0.0
        assert_hem_is_free(worn, hem)


def test_arms_are_not_under_a_loose_shirt_with_sleeves() -> None:
    require_arms_outside_the_shirt(SleeveDesign(sleeveless=False, length=0.2, connecting_width=1.5))


@pytest.mark.parametrize("kind", ["circle", "trousers"])
def test_a_garment_cut_too_wide_slides_off_early(kind: str) -> None:
    require_sliding_off(kind)


@pytest.mark.parametrize(("kind", "clear"), [(Cuff.BAND_SKIRT, 6.0), (Cuff.BAND, 2.5)])
def test_hands_come_out_of_cuffs(kind: Cuff, clear: float) -> None:
    """Every cuff lies round its own forearm, within ``clear`` cm of the skin."""
    cuff = SleeveCuffDesign(type=kind, cuff_len=0.2, top_ruffle=2.0)
    worn = wear(GarmentDesign(meta=SHIRT, sleeve=SleeveDesign(sleeveless=False, length=0.95, cuff=cuff)))
    assert worn.drape.outcome is Outcome.SETTLED
    for arm in ARMS:
        own = worn.vertices_of(f"sl_{arm.split()[0]}_cuff")
        assert worn.from_skin(own, arm) < clear
        share = Axis.of(worn.body, arm).share(worn.drape.vertices[own])
        assert FOREARM_FROM < share.min() < share.max() < 0.9
        assert_comes_out(worn, arm, own)


def test_a_skirt_to_the_floor_is_not_caught_on_the_feet() -> None:
    """Both feet are inside the hem, which hangs round or below them, unstretched and not under the soles."""
    worn = wear(FULL_SKIRT)
    assert worn.drape.outcome is Outcome.SETTLED
    [left], [right] = (worn.openings(leg) for leg in ("left leg", "right leg"))
    assert np.array_equal(left, right)
    assert_hem_is_free(worn, left)


def assert_hem_is_free(worn: Worn, hem: np.ndarray) -> None:
    assert worn.drape.vertices[hem, 1].max() < INSTEP
    assert len(worn.under_soles(inset=UNDER_TOES)) == 0
    assert worn.most_stretched(hem) < 1.1
    assert worn.drape.body_crossings <= TOES
