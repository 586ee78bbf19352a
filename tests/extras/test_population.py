"""The statistics of many adults drawn from the calibrated population."""

import pytest

from tests.generator.body.test_population import require_the_surveys_statistics


@pytest.mark.parametrize("group", ["random", "female", "male"])
def test_two_hundred_adults_have_the_surveys_statistics(group: str) -> None:
    require_the_surveys_statistics(group, 200)
