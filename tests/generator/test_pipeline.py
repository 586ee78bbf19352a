"""A sample is decided by seed, index and recipe, and by nothing else."""

import io
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gcd_dataset.errors import ConfigError, PatternError
from gcd_dataset.generator import pipeline
from gcd_dataset.generator.pipeline import MakeConfig, make, make_many, recipe_of
from gcd_dataset.records import Drape, Outcome

FLAT = MakeConfig(stage="pattern")
MESHED = MakeConfig(stage="mesh", resolution=4.0, points=64)
DRAPED = MakeConfig(resolution=4.0, points=64, picture=48, device="cpu")


def test_alone_or_in_any_order_it_is_the_same_sample() -> None:
    in_order = list(make_many(5, range(4), MESHED))
    backwards = list(make_many(5, [3, 2, 1, 0], MESHED))
    assert in_order == backwards[::-1]
    assert make(5, 2, MESHED) == in_order[2]
    assert [sample.provenance.index for sample in in_order] == [0, 1, 2, 3]


def test_seeds_and_indices_make_different_garments() -> None:
    first, second, other = make(5, 0, FLAT), make(5, 1, FLAT), make(6, 0, FLAT)
    assert first.design != second.design
    assert first.design != other.design
    assert first.measurements != other.measurements


def test_a_stage_leaves_out_what_comes_after_it() -> None:
    flat, meshed = make(5, 0, FLAT), make(5, 0, MESHED)
    assert flat.box_mesh is None
    assert flat.points is None
    assert meshed.drape is None
    assert meshed.front is None
    assert meshed.pattern == flat.pattern
    assert meshed.points is not None
    assert meshed.points.shape == (64, 6)


def test_both_bodies_wear_one_design() -> None:
    config = replace(FLAT, bodies="both")
    neutral, random, following = make_many(9, [4, 5, 6], config)
    assert neutral.design == random.design != following.design
    assert neutral.provenance.body_name == following.provenance.body_name == "neutral"
    assert random.measurements != neutral.measurements == following.measurements
    assert random.measurements == make(9, 2, FLAT).measurements  # the random body of number 2


def test_a_draped_sample_is_whole() -> None:
    sample = make(5, 1, DRAPED)
    assert sample.drape is not None
    assert sample.box_mesh is not None
    assert sample.points is not None
    assert sample.drape.outcome is Outcome.SETTLED
    assert sample.drape.vertices.shape == sample.box_mesh.vertices.shape
    drop = np.linalg.norm(sample.drape.vertices - sample.box_mesh.vertices, axis=1)
    assert drop.max() > 3.0
    low, high = sample.drape.vertices.min(axis=0) - 0.01, sample.drape.vertices.max(axis=0) + 0.01
    assert ((sample.points[:, :3] >= low) & (sample.points[:, :3] <= high)).all()
    for jpeg in (sample.front, sample.back):
        assert jpeg is not None
        assert Image.open(io.BytesIO(jpeg)).size == (48, 48)


def failing(times: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first ``times`` drapes of each garment do not settle; cloth stays where it hangs."""
    tried: dict[int, int] = {}

    def drape(load: list[Any], config: MakeConfig) -> list[Drape]:
        drapes = []
        for dressed in load:
            tried[dressed.index] = tried.get(dressed.index, 0) + 1
            outcome = Outcome.NOT_SETTLED if tried[dressed.index] <= times else Outcome.SETTLED
            drapes.append(Drape(dressed.box_mesh.vertices, outcome, 1, 0, 0, 1.0, 1.0))
        return drapes

    monkeypatch.setattr(pipeline, "_drape", drape)


def test_a_drape_that_fails_raises_the_attempt(monkeypatch: pytest.MonkeyPatch) -> None:
    failing(2, monkeypatch)
    config = replace(DRAPED, picture=0)
    samples = list(make_many(5, range(3), config, batch=2))
    assert [sample.provenance.index for sample in samples] == [0, 1, 2]
    for sample in samples:
        assert sample.provenance.rejects.count("drape: not_settled") == 2
        assert sample.provenance.attempts == len(sample.provenance.rejects) + 1
        assert sample.drape is not None
        assert sample.drape.outcome is Outcome.SETTLED


def test_a_drape_that_fails_can_be_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    failing(1, monkeypatch)
    sample = make(5, 0, replace(DRAPED, picture=0, on_fail="keep"))
    assert sample.drape is not None
    assert sample.drape.outcome is Outcome.NOT_SETTLED
    assert sample.provenance.rejects == make(5, 0, FLAT).provenance.rejects


def test_an_index_without_a_sample_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    failing(99, monkeypatch)
    with pytest.raises(PatternError, match="sample 7 of seed 5: 3 designs were turned down, the last for: drape: not"):
        make(5, 7, replace(DRAPED, picture=0, max_attempts=3))


def test_options_are_checked() -> None:
    with pytest.raises(ConfigError, match="bodies is 'fat': known are neutral, random, both"):
        MakeConfig(bodies="fat")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="resolution is 0"):
        MakeConfig(resolution=0.0)
    assert recipe_of(DRAPED)["device"] == "cpu"
