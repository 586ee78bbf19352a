"""Layers of cloth on a body: crossings and order."""

import numpy as np
import pytest
import trimesh

from gcd_dataset.generator.drape import layers_of
from gcd_dataset.generator.dressing.worn import WornCloth
from gcd_dataset.records import Body, BodyPart, Layer
from tests.helpers import body_from, tube


def trunk(radius: float = 10.0, x: float = 0.0) -> trimesh.Trimesh:
    """An upright cylinder from the floor to 100 cm."""
    return trimesh.creation.cylinder(
        radius=radius, segment=np.array([[x, 0.0, 0.0], [x, 100.0, 0.0]]), sections=48
    ).subdivide()


def ring(radius: float, *, x: float = 0.0, part: BodyPart = BodyPart.TRUNK, tilt: float = 0.0) -> WornCloth:
    """A tube of cloth round an upright axis, between 30 and 70 cm; ``tilt``: cm that its radius grows downwards."""
    mesh = tube(40, 20, radius=1.0, spacing=2.0, height=30.0)
    at = np.array(mesh.vertices)
    at[:, [0, 2]] *= radius + tilt * (50.0 - at[:, 1:2]) / 20.0
    return WornCloth(at + [x, 0.0, 0.0], mesh.faces, np.full(len(at), part.value, np.uint8))


def test_of_two_rings_the_inner_one_lies_within() -> None:
    body, narrow, wide = body_from(trunk()), ring(12.0), ring(14.0)
    for pair, wrong in (([narrow, wide], 0.0), ([wide, narrow], 1.0)):
        [layer] = layers_of(pair, body, device="cpu")
        assert (layer.inner, layer.outer, layer.crossings, layer.wrong_order) == (0, 1, 0, wrong)
        assert layer.covered > 0.95 * len(narrow.vertices)  # rays from the hem may pass the other hem


def test_rings_through_each_other_cross_and_half_of_the_order_is_wrong() -> None:
    [layer] = layers_of([ring(13.0, tilt=2.0), ring(13.0)], body_from(trunk()), device="cpu")
    assert layer.crossings > 40  # all round, edges of both
    assert layer.wrong_order == pytest.approx(0.5, abs=0.1)


def test_each_pair_of_three_garments_is_a_layer() -> None:
    layers = layers_of([ring(12.0), ring(13.0), ring(14.0)], body_from(trunk()), device="cpu")
    assert [(layer.inner, layer.outer) for layer in layers] == [(0, 1), (0, 2), (1, 2)]


def test_a_sleeve_beside_a_trunk_neither_covers_it_nor_is_covered() -> None:
    """An arm hangs beside the trunk, with a sleeve; the trunk has a ring of another garment."""
    shape = trimesh.util.concatenate([trunk(), trunk(3.0, x=20.0)])
    parts = np.where(shape.vertices[:, 0] > 14.0, BodyPart.LEFT_ARM.value, BodyPart.TRUNK.value).astype(np.uint8)
    body = Body(np.asarray(shape.vertices), np.asarray(shape.faces), parts)
    sleeve, band = ring(4.0, x=20.0, part=BodyPart.LEFT_ARM), ring(12.0)
    for pair in ([sleeve, band], [band, sleeve]):
        assert layers_of(pair, body, device="cpu") == (Layer(0, 1, 0, 0, 0.0),)
    wide = ring(5.0, x=20.0, part=BodyPart.LEFT_ARM)
    assert layers_of([wide, sleeve], body, device="cpu")[0].wrong_order == 1.0
