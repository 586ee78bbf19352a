"""The training loop on a line: it is found, and a stopped training goes on with the same numbers."""

import csv
import itertools
import signal
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

from benchmarks.reconstruction import train as loop
from benchmarks.reconstruction.learners import FreshPool
from benchmarks.reconstruction.options import Config
from benchmarks.reconstruction.recording import replace_tensors
from benchmarks.reconstruction.runs import BETTER, Trained
from benchmarks.reconstruction.train import StoppedError, learning_rate, train
from benchmarks.reconstruction.weights import load_weights
from gcd_dataset.errors import ConfigError
from tests.benchmarks.reconstruction.toys import Line, LineLearner, line

CPU = torch.device("cpu")
CONFIG = Config(steps=40, batch=8, lr=0.1, log_every=10)


def trained(out: Path | None = None, *, config: Config = CONFIG, dropout: float = 0.0, **options: Any) -> Trained:
    return train(LineLearner(dropout), line(), config, device=CPU, out=out, **options)


def same(one: Trained, other: Trained) -> bool:
    ours, theirs = one.learner.state_dict(), other.learner.state_dict()
    return all(torch.equal(ours[name], theirs[name]) for name in ours)


def weight_of(found: Trained) -> Tensor:
    return found.learner.state_dict()["net.1.weight"]


def interrupt(step: int, learner: object) -> Mapping[str, float]:
    signal.raise_signal(signal.SIGTERM)
    return {}


def test_the_line_is_found() -> None:
    found = trained(config=Config(steps=150, batch=32, lr=0.1, weight_decay=0.0, ema=0.9))
    assert weight_of(found).tolist()[0] == pytest.approx([2.0, -1.0], abs=0.02)
    assert found.curve[-1]["loss"] < 1e-3 * found.curve[0]["loss"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stopped_training_goes_on_with_the_same_numbers(number: signal.Signals, tmp_path: Path) -> None:
    def stop(step: int, learner: object) -> Mapping[str, float]:
        signal.raise_signal(number)
        return {}

    with pytest.raises(StoppedError, match="stopped by a signal at 28%: repeat the command"):
        trained(tmp_path, dropout=0.2, check=stop)
    found = trained(tmp_path, dropout=0.2)
    assert found.steps == 40
    assert same(found, trained(dropout=0.2))


def test_compiling_changes_no_step(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled: list[LineLearner] = []
    monkeypatch.setattr(LineLearner, "compile_parts", lambda self: compiled.append(self))
    assert same(trained(config=replace(CONFIG, compile=True), dropout=0.5), trained(dropout=0.5))
    assert len(compiled) == 1


def test_curves_hold_losses_and_checks_of_all_calls(tmp_path: Path) -> None:
    seen: list[int] = []

    def check(step: int, learner: object) -> Mapping[str, float]:
        seen.append(step)
        if seen == [20]:
            signal.raise_signal(signal.SIGTERM)
        return {"error": float(step)}

    config = replace(CONFIG, checks=2)
    with pytest.raises(StoppedError):
        trained(tmp_path, config=config, check=check)
    trained(tmp_path, config=config, check=check)
    assert seen == [20, 40]
    with (tmp_path / "curves.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["step"]) for row in rows] == [10, 20, 21, 30, 40]
    assert [row["error"] for row in rows] == ["", "20.0", "", "", "40.0"]
    assert all(float(row["square"]) == float(row["loss"]) for row in rows)


def test_a_training_outlives_a_check_that_fails(tmp_path: Path) -> None:
    def check(step: int, learner: object) -> Mapping[str, float]:
        raise RuntimeError(f"no score at step {step}")

    with pytest.raises(RuntimeError, match="no score at step 40"):
        trained(tmp_path, config=replace(CONFIG, checks=1), check=check)
    assert same(trained(tmp_path, config=replace(CONFIG, checks=1), check=check), trained())


def test_the_best_weights_answer(tmp_path: Path) -> None:
    """Of the second check; a call that goes on remembers them."""
    kept: list[Tensor] = []

    def check(step: int, learner: Any) -> Mapping[str, float]:
        kept.append(learner.state_dict()["net.1.weight"].clone())
        if step == 30:
            signal.raise_signal(signal.SIGTERM)
        return {BETTER: {10: 1.0, 20: 3.0, 30: 2.0, 40: 0.0}[step]}

    with pytest.raises(StoppedError):
        trained(tmp_path, check=check)
    found = trained(tmp_path, check=check)
    assert len(kept) == 4
    assert torch.equal(weight_of(found), kept[1])
    assert BETTER not in found.curve[-1]


def test_a_training_begins_from_weights_and_moments(tmp_path: Path) -> None:
    """Weights are rounded to bfloat16, so the first loss is that of the rounded weights, not of fresh ones."""
    first = trained(tmp_path)
    rounded = LineLearner()
    load_weights([tmp_path / "weights.pt"], rounded)
    assert torch.allclose(rounded.net[1].weight, weight_of(first), rtol=2**-8)  # type: ignore[arg-type]
    config = Config(steps=1, batch=8, lr=1e-9, weights=str(tmp_path / "weights.pt"), seed=1)
    second = trained(config=config)
    assert second.curve[0]["loss"] < 0.1 * trained(config=replace(config, weights="")).curve[0]["loss"]
    moments = torch.load(tmp_path / "moments_0.pt", weights_only=True)
    assert moments["net.1.weight"]["step"] == 40
    assert moments["net.1.weight"]["exp_avg"].dtype == torch.bfloat16
    optimizer = torch.optim.AdamW(rounded.parameters())
    load_weights([tmp_path / "weights.pt"], rounded, optimizer)
    kept = torch.load(tmp_path / "checkpoint.pt", weights_only=True)["optimizer"]["state"][0]
    state = optimizer.state[next(rounded.parameters())]
    assert torch.allclose(state["exp_avg_sq"], kept["exp_avg_sq"], rtol=2**-8)
    assert state["exp_avg_sq"].dtype == torch.float32
    with pytest.raises(ConfigError, match="no weights of this network"):
        trained(config=replace(config, weights=str(tmp_path / "curves.csv")))


def test_a_training_begins_from_the_mean_of_several_weights(tmp_path: Path) -> None:
    learners = [trained(tmp_path / name, config=replace(CONFIG, steps=steps)) for name, steps in (("a", 20), ("b", 40))]
    files = ",".join(str(tmp_path / name / "weights.pt") for name in "ab")
    mean = trained(config=Config(steps=1, batch=8, lr=1e-9, weights=files))
    expected = torch.stack([weight_of(each) for each in learners]).mean(dim=0)
    assert not torch.allclose(weight_of(learners[0]), weight_of(learners[1]), rtol=0.05)
    assert torch.allclose(weight_of(mean), expected, rtol=2**-7)


def test_the_time_given_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = itertools.count()  # a step takes a hundredth of a second
    monkeypatch.setattr(loop, "time", SimpleNamespace(perf_counter=lambda: 0.01 * next(clock)))
    found = trained(config=Config(minutes=0.005, batch=8, checks=0))
    assert found.seconds == pytest.approx(0.3, abs=0.011)
    assert found.steps == pytest.approx(30, abs=1)
    assert found.curve[-1]["lr"] < 0.1 * Config(minutes=1).lr


def test_the_average_follows_the_weights() -> None:
    last, average = trained(config=replace(CONFIG, ema=0.0)), trained(config=replace(CONFIG, ema=0.999))
    assert not same(last, average)
    assert torch.allclose(weight_of(last), weight_of(average), atol=0.5)


class Stream:
    """Examples of which there are more at each step."""

    def __init__(self) -> None:
        self.whole, self.known = line(), 0

    def __len__(self) -> int:
        return self.known

    def batch(self, rows: Tensor, chance: torch.Generator | None = None) -> Line:
        return self.whole.batch(rows)

    def advance(self, step: int) -> None:
        assert self.known == step
        self.known += 1

    def state_dict(self) -> dict[str, Any]:
        return {"known": self.known}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.known = state["known"]


def test_a_stream_goes_on_where_it_stopped(tmp_path: Path) -> None:
    whole = train(LineLearner(), Stream(), CONFIG, device=CPU)
    with pytest.raises(StoppedError):
        train(LineLearner(), Stream(), CONFIG, device=CPU, out=tmp_path, check=interrupt)
    assert same(train(LineLearner(), Stream(), CONFIG, device=CPU, out=tmp_path), whole)


def test_the_learning_rate_rises_then_falls() -> None:
    rates = [learning_rate(step / 100, 0.05) for step in range(101)]
    assert max(rates) == rates[5] == 1.0
    assert rates[1] == pytest.approx(0.2)
    assert rates[-1] == pytest.approx(0.0, abs=1e-6)


def test_a_checkpoint_of_other_options_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StoppedError):
        trained(tmp_path, check=interrupt)
    with pytest.raises(ConfigError, match=r"with lr 0.1, not 0.2: give another folder"):
        trained(tmp_path, config=replace(CONFIG, lr=0.2))


def test_a_loss_that_is_not_finite_stops_the_training() -> None:
    with pytest.raises(ConfigError, match="lower --lr"):
        trained(config=Config(steps=200, batch=8, lr=1e30, ema=0.0))


@pytest.mark.parametrize("options", [{}, {"steps": 1, "minutes": 1.0}, {"steps": 1, "batch": 0}])
def test_invalid_options_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match="give"):
        Config(**options)


def numbered(*numbers: int) -> Line:
    values = torch.tensor(numbers, dtype=torch.float32)
    return Line(values[:, None].expand(-1, 2).clone(), values)


def pool(first: Line, *, fresh: int, room: int) -> FreshPool[Line]:
    def stream(begin: int) -> Iterator[tuple[int, Line]]:
        """Every third drape does not settle."""
        yield from ((k, numbered(100 + k)) for k in range(begin, fresh) if k % 3 != 2)

    return FreshPool(LineLearner(), first, stream, room=room)


def advance_to(found: FreshPool[Line], received: int) -> None:
    begun = time.monotonic()
    while found.received < received:
        assert time.monotonic() - begun < 60, f"received {found.received} of {received}"
        found.advance(0)
        time.sleep(0.001)


def contents(found: FreshPool[Line]) -> list[float]:
    return found.batch(torch.arange(len(found))).y.tolist()


def test_fresh_examples_fill_the_room_then_replace_the_oldest() -> None:
    found = pool(numbered(0, 1), fresh=5, room=4)
    advance_to(found, 4)
    assert contents(found) == [103, 104, 100, 101]


def test_a_pool_continues_after_the_last_index_received() -> None:
    """Drapes that do not settle have indices, too: 100, 101, 103, 104 are followed by 106, not by 104."""
    stopped = pool(numbered(0), fresh=6, room=8)
    advance_to(stopped, 4)
    found = pool(numbered(0), fresh=8, room=8)
    found.load_state_dict(stopped.state_dict())
    advance_to(found, 6)
    assert contents(found) == [0, 106, 107]


def test_an_error_of_the_stream_is_raised() -> None:
    def stream(begin: int) -> Iterator[tuple[int, Line]]:
        yield 0, numbered(1)
        raise ValueError("no cloth")

    found = FreshPool(LineLearner(), numbered(0), stream, room=4)
    with pytest.raises(ValueError, match="no cloth"):
        advance_to(found, 2)


def test_a_batch_takes_the_values_of_another_of_its_shapes() -> None:
    """As a recorded step needs, whose tensors stay where they are."""
    held, other = numbered(0, 1), numbered(2, 3)
    place = held.x.data_ptr()
    replace_tensors(held, other)
    assert held.y.tolist() == [2, 3]
    assert held.x.data_ptr() == place
    with pytest.raises(ValueError, match="shapes"):
        replace_tensors(held, numbered(1))
