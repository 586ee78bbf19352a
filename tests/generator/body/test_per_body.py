"""Data kept for each body."""

import gc
import weakref
from unittest.mock import Mock

import trimesh

from gcd_dataset.generator.body.surface import kept_per_body
from gcd_dataset.records import Body
from tests.helpers import body_from


def ball(radius: float) -> Body:
    return body_from(trimesh.creation.icosphere(subdivisions=1, radius=radius))


def test_it_is_computed_once_for_each_body() -> None:
    height = Mock(side_effect=lambda body: float(body.vertices[:, 1].max()))
    kept = kept_per_body(lambda body: height(body))
    small, large = ball(1.0), ball(2.0)
    assert [kept(body) for body in (small, large, small, large)] == [1.0, 2.0, 1.0, 2.0]
    assert height.call_count == 2


def test_it_is_dropped_with_the_body() -> None:
    kept = kept_per_body(lambda body: Mock())
    body = ball(1.0)
    derived = weakref.ref(kept(body))
    assert derived() is not None
    del body
    gc.collect()
    assert derived() is None
