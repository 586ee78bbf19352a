"""The statistics of many adults drawn from the calibrated population."""

import pytest

from gcd_dataset.loaders import GeneratedGarments
from tests.generator.body.test_population import require_the_surveys_statistics


@pytest.mark.parametrize("group", ["random", "female", "male"])
def test_two_hundred_adults_have_the_surveys_statistics(group: str) -> None:
    require_the_surveys_statistics(group, 200)


def test_a_wearer_of_few_garments_does_not_stop_a_data_set() -> None:
    """No fitted shirt suits her, and by chance her first twenty designs are all fitted shirts."""
    item = GeneratedGarments(33_546, seed=0, stage="pattern", drape=None, fields=("meta", "panels"))[33_545]
    assert item["meta"]["attempts"] > 20
    assert len(item["panels"])
