"""Derivatives of drapes by design parameters."""

import numpy as np
import pytest

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator import Fitting, drape_jacobian, real_parameters
from gcd_dataset.generator.body import named_body
from gcd_dataset.generator.garments import design_from_dict
from gcd_dataset.generator.jacobian import mean_value_coordinates, moved
from gcd_dataset.records import EdgeRole

NEUTRAL = Fitting(*named_body("neutral")[:2], resolution=6.0)
SKIRT = design_from_dict({"meta": {"bottom": "PencilSkirt"}, "pencil-skirt": {"length": 0.5}})


def test_mean_value_coordinates_give_back_points_inside_and_on_the_outline() -> None:
    """The polygon is not convex, and has corners on straight sides."""
    loop = np.array([[0, 0], [4, 0], [8, 0], [8, 8], [6, 8], [4, 2], [2, 8], [0, 8], [0, 4]], float)
    points = np.array([[1, 1], [7, 7], [4, 1.9], [4, 0], [6, 0], [0, 0], [5, 5], [0, 3]], float)
    weights = mean_value_coordinates(points, loop)
    assert np.allclose(weights @ loop, points, atol=1e-9)
    assert np.allclose(weights.sum(axis=1), 1)


def test_a_hem_sinks_by_the_length_that_is_added() -> None:
    """A skirt hangs from its waist, which stays."""
    found = drape_jacobian(SKIRT, NEUTRAL, ["pencil-skirt.length"], step=0.1, pairs=3, device="cpu")
    [derivative] = found.derivatives[..., 1]
    longer = NEUTRAL.worn(moved(SKIRT, {"pencil-skirt.length": 0.1}))
    assert longer is not None
    added = np.ptp(longer.pattern.panels[0].vertices[:, 1]) - np.ptp(found.worn.pattern.panels[0].vertices[:, 1])
    hem = found.positions[:, 1] < found.positions[:, 1].min() + 1.0
    expected = -added / 0.1
    assert derivative[hem].mean() == pytest.approx(expected, rel=0.1)
    waist = found.worn.job.box_mesh.labels[EdgeRole.LOWER_INTERFACE]
    assert np.abs(derivative[waist]).mean() < 0.1 * abs(expected)


def test_parameters_that_change_the_pattern() -> None:
    names = real_parameters(SKIRT, NEUTRAL.size)
    assert {"pencil-skirt.length", "pencil-skirt.flare"} <= set(names)
    assert not [name for name in names if name.startswith(("shirt", "pants", "flare-skirt"))]
    with pytest.raises(ConfigError, match=r"no real parameter pencil-skirt\.lenght: did you mean pencil-skirt\.length"):
        drape_jacobian(SKIRT, NEUTRAL, ["pencil-skirt.lenght"], device="cpu")
    with pytest.raises(ConfigError, match=r"the design has no cape\.length: leave it out"):
        drape_jacobian(SKIRT, NEUTRAL, ["cape.length"], device="cpu")
