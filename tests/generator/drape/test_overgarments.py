"""Capes and ponchos settle on shoulders and arms."""

import pytest

from gcd_dataset.generator.garments import design_from_dict
from gcd_dataset.records import BodyPart, Outcome
from tests.generator.drape.garments import wear


@pytest.mark.parametrize("upper", ["Cape", "Poncho"])
def test_an_overgarment_settles_without_crossings_and_covers_both_shoulders(upper: str) -> None:
    worn = wear(design_from_dict({"meta": {"upper": upper}}), spacing=5.0)
    assert worn.drape.outcome is Outcome.SETTLED
    assert (worn.drape.self_crossings, worn.drape.body_crossings) == (0, 0)
    top = worn.drape.vertices[:, 1].max()
    for part in (BodyPart.LEFT_ARM, BodyPart.RIGHT_ARM):
        arm = worn.body.vertices[worn.body.parts == part.value]
        assert arm[:, 1].max() < top < worn.body.vertices[:, 1].max()
        assert worn.drape.vertices[:, 0].min() < arm[:, 0].mean() < worn.drape.vertices[:, 0].max()
