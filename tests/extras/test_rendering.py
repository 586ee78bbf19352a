"""Pictures of more figures than ``make test`` renders."""

import pytest

from gcd_dataset.generator.render import HairStyle
from tests.generator.render.test_geometry import hair_pixels


@pytest.mark.parametrize("style", [HairStyle.CROPPED, HairStyle.SHORT])
def test_hair_of_every_style_stays_under_a_hood(style: HairStyle) -> None:
    under, bare = hair_pixels(style)
    assert max(under) == 0
    assert min(bare) > 28
