"""Cases: selection, fresh garments in a training loop, and the recorded FreeSewing patterns."""

import argparse
import json
import tarfile
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import benchmarks.run
from benchmarks.cases import generated
from benchmarks.cases.design_space import UNUSED, shift
from gcd_dataset.errors import ConfigError
from gcd_dataset.faults import require_valid
from gcd_dataset.generator.garments.parameter import Choice, Real
from gcd_dataset.generator.garments.space import Leaf
from gcd_dataset.loaders import GeneratedGarments
from gcd_dataset.spec import pattern_from_spec

LENGTH = Leaf("skirt.length", Real(0.0, 0.4, 0.0, 1.0))
CUT = Leaf("skirt.cut", Choice("plain", None, ("plain", "flared")))


def test_nothing_moves_without_selection() -> None:
    values = list(np.linspace(0, 1, 101))
    assert shift(LENGTH, values, values, paired=True).moved == 0
    assert shift(LENGTH, values, values, paired=True).noise == 0


def test_a_limit_moves_the_share_above_it() -> None:
    values = [0.01 + 0.98 * k / 999 for k in range(1000)]
    within = [value if value < 0.75 else value - 0.75 for value in values]
    found = shift(LENGTH, values, within, paired=True)
    assert found.moved == pytest.approx(0.25, abs=0.02)
    assert found.rare == ("0.75 to 1",)


def test_options_are_compared_by_share() -> None:
    found = shift(CUT, ["plain", "flared"] * 100, ["plain"] * 100, paired=False)
    assert found.moved == pytest.approx(0.5)
    assert found.rare == ("flared",)


def test_designs_without_the_parameter_do_not_count() -> None:
    assert shift(CUT, ["plain", UNUSED, "flared"], ["plain", "plain", "flared"], paired=True).moved == pytest.approx(
        1 / 6
    )


def test_chance_moves_as_much_as_the_noise() -> None:
    rng = np.random.default_rng(0)
    found = []
    for _ in range(60):
        values = list(rng.uniform(0.001, 1, 3000))
        replaced = [
            value if keep else rng.uniform(0.001, 1) for value, keep in zip(values, rng.random(3000) < 0.8, strict=True)
        ]
        accepted = list(rng.choice(values, 1000, replace=False))
        found.append((shift(LENGTH, values, replaced, paired=True), shift(LENGTH, values, accepted, paired=False)))
    for column in zip(*found, strict=True):
        moved, noise = np.mean([s.moved for s in column]), np.mean([s.noise for s in column])
        assert moved == pytest.approx(noise, rel=0.1)


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
    garments = GeneratedGarments(99, stage="mesh", resolution=8.0, points=256, fields=generated.FIELDS["mesh"])
    figures = {figure.metric: figure.value for figure in generated._trained(garments, asked, 1e6, "cpu")}
    assert figures["large_layers"] == 1
    for network in ("small", "large"):
        assert figures[f"{network}_steps_per_second"] > 0
        assert 0 <= figures[f"{network}_waits"] < 1


RECORDED = Path(benchmarks.run.__file__).parent / "data" / "freesewing.tar.xz"


def test_ten_valid_patterns_of_each_design_are_sewn() -> None:
    """The free edges are hems, necklines and waists alone. One pattern of each design is validated."""
    designs: Counter[str] = Counter()
    with tarfile.open(RECORDED) as tar:
        for member in sorted((entry for entry in tar if entry.isfile()), key=lambda entry: entry.name):
            file, name = tar.extractfile(member), Path(member.name).name
            assert file is not None
            pattern = pattern_from_spec(json.loads(file.read()), name)
            if designs[name.split("_")[0]] == 0:
                require_valid(pattern, source=name)
            designs[name.split("_")[0]] += 1
            assert 2 * len(pattern.seams) / sum(len(panel.edges) for panel in pattern.panels) > 0.6
    assert set(designs.values()) == {10}
    assert len(designs) == 9
