"""What takes the benchmarks' own tests too long."""

import pytest

from benchmarks.reconstruction.plan import read_plan
from tests.benchmarks.reconstruction.test_plan import PLANS


@pytest.mark.parametrize("path", PLANS, ids=lambda path: str(path.stem))
def test_the_networks_of_the_plans_are_built(path: object) -> None:
    assert read_plan(path)  # type: ignore[arg-type]
