"""``produce`` makes the same samples with any draper and any number of workers."""

import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Self

import pytest

from gcd_dataset.errors import ConfigError, PatternError
from gcd_dataset.generator import pipeline
from gcd_dataset.generator.drapers import DrapeReply, DrapeRequest, SharedDraper, address_for
from gcd_dataset.generator.drapers.draper import DrapeWork, in_order
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.pipeline import sample_key
from gcd_dataset.generator.recipe import MakeConfig, devices_of
from gcd_dataset.records import Sample
from gcd_dataset.shards.codec import encode_sample

FLAT = MakeConfig(stage="pattern", bodies="both")
MESHED = MakeConfig(stage="mesh", resolution=8.0, points=16, bodies="both")
DRAPED = MakeConfig(resolution=10.0, points=16, picture=16, device="cpu", on_fail="keep")


def test_workers_and_a_single_process_make_the_same_samples() -> None:
    alone = list(produce(5, range(7), MESHED))
    assert list(produce(5, range(7), MESHED, workers=3)) == alone


def test_workers_return_the_results_of_finished() -> None:
    alone = [encode_sample(sample) for sample in produce(5, [4, 0, 1], FLAT)]
    assert list(produce(5, [4, 0, 1], FLAT, workers=2, finished=encode_sample)) == alone


def test_a_draping_process_gives_the_same_samples() -> None:
    here = list(produce(5, range(2), DRAPED))
    with SharedDraper(address_for("cpu")) as draper:
        assert list(produce(5, range(2), DRAPED, draper=draper)) == here


SCRIPT = """
from gcd_dataset.generator import MakeConfig, produce
config = MakeConfig(stage="pattern")
if __name__ == "__main__" or not {guarded}:
    print([sample.key for sample in produce(5, range(2), config, workers=2)])
"""


def run(*arguments: str, given: str = "") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *arguments]
    return subprocess.run(command, input=given, capture_output=True, text=True, check=False, timeout=120)


def test_workers_serve_a_script_from_standard_input() -> None:
    """Which has no file that a spawned worker could import."""
    finished = run("-", given=SCRIPT.format(guarded=True))
    assert finished.stdout.strip() == str([sample_key(0), sample_key(1)]), finished.stderr


def test_the_error_of_a_script_without_main_guard_names_the_remedy(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(guarded=False))
    finished = run(str(script))
    assert finished.returncode == 1
    assert "must start them under if __name__" in finished.stderr


def test_indices_may_be_infinite() -> None:
    def forever() -> Iterator[int]:
        while True:
            yield from (0, 1)

    made = produce(5, forever(), FLAT)
    first, second, third = next(made), next(made), next(made)
    assert first == third != second


def test_samples_before_a_failure_are_yielded(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(seed: int, number: int, *_: object) -> pipeline.DressedDesign:
        if number == 2:
            raise PatternError("sample 4: 3 designs were rejected")
        return pipeline.prepare(seed, number, FLAT)

    monkeypatch.setattr("gcd_dataset.generator.maker.prepare", never)
    made: list[Sample] = []
    with pytest.raises(PatternError, match="sample 4"):
        made.extend(produce(5, range(6), FLAT, ahead=6))
    assert [sample.provenance.index for sample in made] == [0, 1, 2, 3]


def test_a_failure_in_a_worker_is_raised_here() -> None:
    heavy = Overlay.from_dict({"meta": {"upper": "none", "bottom": "SkirtCircle"}, "flare-skirt": {"length": 0.9}})
    with pytest.raises(PatternError, match="2 designs were rejected, the last for: too_heavy"):
        list(produce(5, range(4), replace(FLAT, design=heavy, max_attempts=2), workers=2))


@pytest.mark.parametrize(
    ("name", "devices"),
    [("cpu", ("cpu",)), ("cuda", ("cuda:0",)), ("cuda:1", ("cuda:1",)), ("cuda:0,1,1", ("cuda:0", "cuda:1"))],
)
def test_devices_are_named(name: str, devices: tuple[str, ...]) -> None:
    assert devices_of(MakeConfig(device=name)) == devices


def test_a_malformed_device_is_an_error() -> None:
    with pytest.raises(ConfigError, match="several as cuda:0,1"):
        devices_of(MakeConfig(device="gpu"))


def test_a_failure_waits_for_the_results_before_it() -> None:
    """The third piece of work fails first, while the first two are pending."""
    begun: list[DrapeRequest] = []

    class Backwards:
        at_once = 4

        def send(self, request: DrapeRequest) -> None:
            begun.append(request)

        def poll(self) -> bool:
            return False

        def receive(self) -> DrapeReply:
            return DrapeReply(begun.pop().number, None, None)  # type: ignore[arg-type]

        def __enter__(self) -> Self:
            return self

        def __exit__(self, *_: object) -> None:
            pass

    def piece(number: int) -> DrapeWork[int]:
        def finish(_: Sequence[DrapeReply]) -> int:
            if number == 2:
                raise PatternError("piece 2")
            return number

        return DrapeWork([None], finish)  # type: ignore[list-item]

    made: list[int] = []
    with pytest.raises(PatternError, match="piece 2"):
        made.extend(in_order(map(piece, range(4)), Backwards(), ahead=4, at_once=4))
    assert made == [0, 1]
