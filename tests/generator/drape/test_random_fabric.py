"""Random fabrics lie between measured ones, depend on seed and index alone, are recorded, and drape in any batch."""

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest

from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.drape import FABRICS, DrapeConfig, Fabric, draw_fabric
from gcd_dataset.generator.drape.batches import drape_unordered
from gcd_dataset.generator.drape.fabrics import MEASURED, shear_stiffness
from gcd_dataset.generator.maker import make, produce
from gcd_dataset.generator.pipeline import sample_fabric
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.shards.codec import decode_sample, encode_sample
from tests.generator.drape.test_drape import on_a_ball

SMALL = MakeConfig(resolution=5.0, points=16, picture=0, device="cpu", fabric="random", on_fail="keep")


def figures(fabric: Fabric) -> np.ndarray:
    return np.array([fabric.density, fabric.thickness, *fabric.pull[:2], shear_stiffness(fabric.pull), *fabric.bend])


def test_random_fabrics_stay_within_the_measurements_and_fill_them() -> None:
    drawn = np.log([figures(draw_fabric(rng(3, index, Stage.FABRIC))) for index in range(400)])
    measured = np.log([figures(FABRICS[name]) for name in MEASURED])
    low, high = measured.min(axis=0), measured.max(axis=0)
    assert (drawn >= low - 1e-9).all()
    assert (drawn <= high + 1e-9).all()
    assert (np.ptp(drawn, axis=0) > 0.9 * (high - low)).all()


def test_a_random_fabric_lies_between_two_measured_ones() -> None:
    fabric = draw_fabric(rng(3, 5, Stage.FABRIC))
    ends = [FABRICS[name] for name in MEASURED if name in fabric.source]
    assert len(ends) >= 2
    place = float(fabric.source.split()[1])
    pairs = [(a, b) for a in ends for b in ends if a is not b]
    between = [(1 - place) * np.log(figures(a)) + place * np.log(figures(b)) for a, b in pairs]
    assert min(np.abs(np.log(figures(fabric)) - figure).max() for figure in between) < 1e-3


def test_a_random_fabric_depends_on_seed_and_index_alone() -> None:
    fabrics = [sample_fabric(7, index, "random") for index in range(20)]
    assert len({fabric.density for fabric in fabrics}) == 20
    assert sample_fabric(7, 12, "random") == fabrics[12]
    assert sample_fabric(8, 12, "random") != fabrics[12]
    assert sample_fabric(7, 12, "denim") is FABRICS["denim"]


def test_a_random_fabric_is_draped_recorded_and_stored() -> None:
    first, second = produce(5, range(2), SMALL)
    for index, sample in enumerate((first, second)):
        assert sample.fabric is not None
        assert sample.fabric.name == "random"
        expected = sample_fabric(5, index, "random")
        assert sample.fabric.parameters["density"] == expected.density
        assert as_fabric(sample.fabric.parameters) == asdict(expected)
        assert decode_sample(encode_sample(sample)).fabric == sample.fabric
    assert first.fabric != second.fabric
    assert make(5, 1, SMALL) == second
    denim = make(5, 1, replace(SMALL, fabric="denim"))
    assert denim.fabric is not None
    assert denim.pattern == second.pattern
    assert as_fabric(denim.fabric.parameters) == asdict(FABRICS["denim"])


def as_fabric(parameters: Mapping[str, Any]) -> dict[str, Any]:
    return {name: tuple(value) if isinstance(value, list) else value for name, value in parameters.items()}


def test_a_batch_of_random_fabrics_drapes_like_each_alone() -> None:
    """The batch mixes orthotropic and isotropic fabrics."""
    fabrics = [FABRICS["default"], sample_fabric(1, 0, "random"), FABRICS["cotton"]]
    jobs = [replace(on_a_ball(6), fabric=fabric) for fabric in fabrics]
    config = DrapeConfig(max_frames=30)
    together = dict(drape_unordered(jobs, config, device="cpu", at_once=len(jobs)))
    for number, job in enumerate(jobs):
        [(_, alone)] = drape_unordered([job], config, device="cpu", at_once=1)
        assert together[number] == alone
    assert len({drape.vertices.tobytes() for drape in together.values()}) == len(jobs)


def test_random_is_an_option_and_part_of_the_recipe() -> None:
    assert recipe_of(SMALL)["fabric"] == "random"
    with pytest.raises(ConfigError, match=r"wool_light, random$"):
        MakeConfig(fabric="rnd")
