"""Garments draped over garments."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.body.limbs import limbs_of
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob, drape_batch, drape_outfit, layers_of
from gcd_dataset.generator.drape.body_field import body_fields
from gcd_dataset.generator.drape.dressed import dressed_fields
from gcd_dataset.generator.drape.model import build_model
from gcd_dataset.generator.drape.outcome import FINISHES
from gcd_dataset.generator.drape.solver import Solver
from gcd_dataset.generator.drape.tucked import ROOM, widths
from gcd_dataset.generator.dressing.sewing_start import sewing_start
from gcd_dataset.generator.dressing.worn import WornCloth
from gcd_dataset.records import BodyPart, Layer, Outcome
from tests.generator.drape.garments import job_of, neutral
from tests.generator.drape.test_layers import ring, trunk
from tests.helpers import SIZE, body_from, tube


def on_trunk(radius: float) -> DrapeJob:
    """A ring of cloth round a trunk, 16 cm high, a little wider than the trunk's skin and cloth under it."""
    columns = round(2.0 * np.pi * radius / 2.0)
    mesh = tube(columns, 8, radius=radius, spacing=2.0 * np.pi * radius / columns, height=40.0)
    return DrapeJob(mesh, body_from(trunk()), SIZE)


def test_the_field_of_a_dressed_body_is_lowered_to_the_cloth_and_covers_it() -> None:
    field, cloth = body_fields([body_from(trunk())], "cpu")[0], ring(30.0)
    [over] = dressed_fields([field], [(cloth,)], [0.0])
    low, at = np.array(over.origin), over.distance.numpy()

    def distance(x: float) -> float:
        return float(at[tuple(np.rint((np.array([x, 50.0, 0.0]) - low) / over.cell).astype(int))])

    assert distance(32.0) == pytest.approx(2.0, abs=0.5)
    assert distance(27.0) == pytest.approx(-3.0, abs=0.5)  # a tube of cloth is solid
    assert (low < np.array(field.origin)).any()


def test_worn_cloth_is_built_on_a_device_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a GPU the name is the key of a stream."""
    asked = list[str]()

    def builds(device: str) -> nullcontext[None]:
        asked.append(device)
        return nullcontext()

    monkeypatch.setattr("gcd_dataset.generator.drape.dressed.native_builds", builds)
    dressed_fields([body_fields([body_from(trunk())], "cpu")[0]], [(ring(31.0),)], [0.0])
    assert {*asked} == {"cpu"}


def test_a_ring_over_a_ring_rests_outside_it_and_the_same_in_a_batch() -> None:
    inner, outer = on_trunk(11.0), on_trunk(11.1)
    config = DrapeConfig(max_frames=20)
    over = replace(outer, under=(WornCloth.of(inner.box_mesh, inner.box_mesh.vertices),))
    [alone] = drape_batch([over], config, device="cpu")
    assert drape_batch([outer, over, inner], config, device="cpu")[1] == alone
    [layer] = layers_of([*over.under, WornCloth.of(outer.box_mesh, alone.vertices)], inner.body, device="cpu")
    assert (layer.crossings, layer.wrong_order) == (0, 0.0)
    assert drape_batch([outer], config, device="cpu") != [alone]


def test_cloth_leaves_the_flared_hem_of_a_garment_under_it() -> None:
    """Its rows above the hem lie outside the hem's cloth, and the row below, nearer to the skin, moves out as well."""
    inner, outer = on_trunk(11.0), on_trunk(11.2)
    hem, low = np.array(inner.box_mesh.vertices), np.array(outer.box_mesh.vertices)
    hem[hem[:, 1] < 40.1] *= [11.8 / 11.0, 1.0, 11.8 / 11.0]
    low[:, 1] -= 4.6
    job = replace(outer, under=(WornCloth.of(inner.box_mesh, hem),))
    solver = Solver(build_model([job], DrapeConfig(), "cpu"), DrapeConfig())
    solver.state.x.assign(low)
    assert solver.body_crossings()[0] > 0
    for _ in range(FINISHES):
        solver.leave_skin(solver.chosen(None))
    assert (solver.body_crossings()[0], solver.body_through()[0]) == (0, 0)
    moved = solver.state.x.numpy() - low
    assert np.hypot(*moved[:, [0, 2]].T).max() < 0.8 + 0.12  # no further than beyond the hem
    assert abs(moved[:, 1]).max() < 0.01


def test_a_garment_over_one_that_failed_is_refused() -> None:
    inner = replace(on_trunk(11.0), body=neutral()[0])
    first, second = drape_outfit([inner, inner], DrapeConfig(max_frames=1), device="cpu")
    assert first.outcome is not Outcome.SETTLED
    assert (second.outcome, second.reason) == (Outcome.REFUSED, f"garment 0 under it is {first.outcome.name}")


def test_garments_of_an_outfit_share_their_body() -> None:
    with pytest.raises(ConfigError, match="garment 1 is for body"):
        drape_outfit([on_trunk(11.0), on_trunk(12.0)], device="cpu")


@pytest.fixture(scope="module")
def shirt_and_trousers() -> tuple[DrapeJob, DrapeJob]:
    shirt = {"meta": {"upper": "Shirt"}, "sleeve": {"sleeveless": False, "length": 0.5}}
    return job_of(shirt, spacing=3.0, legs_apart=True), job_of(
        {"meta": {"bottom": "Pants"}}, spacing=3.0, legs_apart=True
    )


def test_a_sleeve_is_rolled_round_the_sleeve_below(shirt_and_trousers: tuple[DrapeJob, DrapeJob]) -> None:
    shirt, _ = shirt_and_trousers
    on_arm = WornCloth.of(shirt.box_mesh, shirt.box_mesh.vertices).parts == BodyPart.LEFT_ARM.value
    bare = sewing_start(shirt.box_mesh, shirt.body)
    arm = limbs_of(shirt.body)[BodyPart.LEFT_ARM]
    wide = arm.world(arm.local(bare) * [2.0, 1.0, 1.0])
    over = sewing_start(shirt.box_mesh, shirt.body, [replace(WornCloth.of(shirt.box_mesh, bare), vertices=wide)])
    one, other = (np.ptp(arm.local(at[on_arm])[:, 0]) for at in (bare, over))
    assert other > 1.2 * one


def test_sleeves_under_sleeves_lie_on_the_arms(shirt_and_trousers: tuple[DrapeJob, DrapeJob]) -> None:
    """Alone, a sleeve that is cut for a lower arm stands up in a fold, which a sleeve over it would have to pierce."""
    shirt, _ = shirt_and_trousers
    on_arm = WornCloth.of(shirt.box_mesh, shirt.box_mesh.vertices).parts == BodyPart.LEFT_ARM.value
    drapes = drape_batch([shirt, replace(shirt, under_sleeves=True)], device="cpu")
    skin = cKDTree(shirt.body.vertices)
    alone, pressed = (np.quantile(skin.query(drape.vertices[on_arm])[0], 0.9) for drape in drapes)
    assert alone > 4.5
    assert pressed < 3.5
    assert {drape.outcome for drape in drapes} == {Outcome.SETTLED}


def test_a_tucked_shirt_lies_inside_the_trousers(shirt_and_trousers: tuple[DrapeJob, DrapeJob]) -> None:
    """Draped on their own, the shirt's hem lies outside the trousers; tucked, it lies inside and nothing crosses."""
    shirt, trousers = shirt_and_trousers
    waist = float(trousers.box_mesh.vertices[:, 1].max())
    loose, alone = drape_batch([shirt, trousers], device="cpu")
    inner, outer = drape_outfit([replace(shirt, tucked_below=waist), trousers], device="cpu")
    layers = list[Layer]()
    for one, other in ((loose, alone), (inner, outer)):
        pair = [WornCloth.of(shirt.box_mesh, one.vertices), WornCloth.of(trousers.box_mesh, other.vertices)]
        layers += layers_of(pair, shirt.body, device="cpu")
    assert layers[0].wrong_order > 0.5
    assert (layers[1].crossings, layers[1].wrong_order) == (0, 0.0)


def test_tucked_cloth_has_room_between_skin_and_waistband() -> None:
    """A tucked ring comes to rest ``ROOM`` off the skin and its gap, as wide as it is taken in, not pressed on it."""
    config = DrapeConfig(coarse_start=False)
    [tucked] = drape_batch([replace(on_trunk(11.0), tucked_below=100.0)], config, device="cpu")
    off = np.hypot(*tucked.vertices[:, [0, 2]].T) - 10.0
    assert np.median(off) == pytest.approx(config.body_gap + ROOM, abs=0.05)


def test_tucked_cloth_is_as_wide_as_the_skin() -> None:
    """A ring of radius 15 round a trunk of radius 10 keeps two thirds of its width, and all of it where not tucked."""
    loose, config = on_trunk(15.0), DrapeConfig(body_gap=0.0)
    below = widths(replace(loose, tucked_below=100.0), config)
    assert below == pytest.approx(np.full(len(below), (10.0 + ROOM) / 15.0), rel=0.02)
    assert (widths(loose, config) == 1.0).all()
