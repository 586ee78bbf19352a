"""The benchmark of garments generated during training."""

import argparse

import pytest

from benchmarks.cases import generated
from gcd_dataset.errors import ConfigError
from gcd_dataset.loaders import GeneratedGarments


def options(*given: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    generated.add_arguments(parser)
    return parser.parse_args(given)


def test_the_rate_of_patterns_is_measured() -> None:
    asked = options("--stage", "pattern", "--workers", "1", "--seconds", "0.2", "--warm", "2", "--batch", "2")
    figures = {figure.metric: figure.value for figure in generated.run(asked).figures}
    assert figures["per_second"] > 0


def test_a_duration_of_zero_is_refused() -> None:
    with pytest.raises(ConfigError, match="--seconds"):
        generated.run(options("--seconds", "0"))


def test_the_networks_waiting_times_are_measured() -> None:
    """The large network is just slow enough for the garments' rate: one layer at a million garments per second."""
    asked = options("--workers", "0", "--seconds", "0.1", "--warm", "2", "--batch", "2")
    garments = GeneratedGarments(99, stage="mesh", resolution=8.0, fields=generated.FIELDS["mesh"])
    figures = {figure.metric: figure.value for figure in generated._trained(garments, asked, 1e6, "cpu")}
    assert figures["large_layers"] == 1
    for network in ("small", "large"):
        assert figures[f"{network}_steps_per_second"] > 0
        assert 0 <= figures[f"{network}_waits"] < 1
