"""The fleet model: the simulation agrees with closed forms where these exist."""

import math
from dataclasses import replace

import pytest

from benchmarks import run
from benchmarks.fleet import RATE, Fleet, Machine, ObjectStore, bill, expected_seconds, limits, simulate
from gcd_dataset.errors import ConfigError

pytest.importorskip("simpy")

CALM = Fleet(machines=8, rate=30.0, begin=0.0, again=0.0)
SPOT = Fleet(machines=1, rate=30.0, begin=20.0, failing=1800.0, again=120.0)


def test_without_failures_the_time_is_garments_over_rate() -> None:
    done = simulate(CALM, 240_000, 10_000)
    assert done.seconds == pytest.approx(240_000 / (8 * 30.0))
    assert (done.failures, done.lost, done.away) == (0, 0.0, 0.0)
    assert done.idle == pytest.approx(0.0)
    assert done.efficiency == pytest.approx(1.0)


def test_every_part_pays_the_start_up_time_once() -> None:
    assert simulate(replace(CALM, begin=25.0), 240_000, 10_000).away == 24 * 25.0


def test_machines_are_idle_during_the_last_part() -> None:
    done = simulate(CALM, 90_000, 10_000)  # nine parts on eight machines
    assert done.seconds == pytest.approx(2 * 10_000 / 30.0)
    assert done.idle == pytest.approx(7 * 10_000 / 30.0)


def test_a_smaller_last_part_is_simulated() -> None:
    assert simulate(replace(CALM, machines=1), 25_001, 10_000).seconds == pytest.approx(25_001 / 30.0)


@pytest.mark.parametrize("kept", [256, 10_000, 54_000, 100_000])
def test_failures_cost_what_the_restart_model_expects(kept: int) -> None:
    """54,000 garments take half an hour, the mean time between failures."""
    fleet, parts = replace(SPOT, kept=kept), 3_000
    taken = simulate(fleet, parts * 54_000, 54_000, seed=1).seconds / parts
    assert taken == pytest.approx(expected_seconds(fleet, 54_000), rel=0.03)


def test_the_expected_time_without_delays_is_the_closed_form() -> None:
    fleet = replace(SPOT, kept=54_000, begin=0.0, again=0.0)
    assert expected_seconds(fleet, 54_000) == pytest.approx(1800.0 * (math.e - 1))


def test_a_rare_failure_costs_a_restart_and_half_the_unsaved_work() -> None:
    fleet = replace(SPOT, kept=256, failing=100_000.0)
    work = 1_000_000 / 30.0
    extra = expected_seconds(fleet, 1_000_000) - fleet.begin - work
    assert extra == pytest.approx(work / 100_000.0 * (120.0 + 256 / 30.0 / 2), rel=0.01)


def test_slow_machines_get_fewer_parts() -> None:
    fleet = replace(CALM, slow_share=0.5)  # four at 30/s, four at 15/s: together 180/s
    done = simulate(fleet, 1_800_000, 1_000)
    assert done.efficiency > 0.99
    assert done.seconds >= 10_000.0


def test_the_bottleneck_has_the_least_rate() -> None:
    machine, store = Machine(), ObjectStore()
    assert bill(machine, store, garments=10**6, gpus=1, size=963e3, gpu_usd=1.0).bottleneck == "GPU"
    eight = limits(machine, store, gpus=8, size=963e3)
    assert eight["writer"] < eight["GPU"]  # one writing process for eight GPUs
    assert eight["writers, a part for each GPU"] > eight["GPU"]
    many = limits(machine, store, gpus=10_000, size=963e3)
    assert min(many, key=lambda name: many[name]) == "requests"


def test_costs_of_compute_and_store_add_up() -> None:
    cost = bill(Machine(), ObjectStore(), garments=10_000_000, gpus=8, size=1e6, gpu_usd=2.0)
    assert cost.shards == 39_063
    assert cost.size == 1e13
    assert cost.gpu_hours == pytest.approx(10_000_000 / RATE / 3600)
    assert cost.compute_usd == pytest.approx(2.0 * cost.gpu_hours)
    assert cost.store_usd == pytest.approx(39_063 * 10 * 5e-6 + 230.0)


def test_invalid_values_are_refused() -> None:
    with pytest.raises(ConfigError, match="1 or more"):
        simulate(CALM, 0, 10)
    with pytest.raises(ConfigError, match="above 0"):
        Fleet(machines=0)


def test_the_case_prints_the_fastest_part_size(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["fleet", "--machines", "20", "--garments", "2000000", "--parts", "256", "25600", "2000000"]
    assert run.main(arguments) == 0
    told = capsys.readouterr().out
    assert "fleet.best_part 25600 garments" in told
    assert f"fleet.gpu_hours {2_000_000 / RATE / 3600:.6g} GPU-h" in told
    assert run.main(["fleet", "--machines", "0"]) == 1
