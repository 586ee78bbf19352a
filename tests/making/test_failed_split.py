"""Kept failed drapes go to the split ``failed``, under their own numbers."""

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import fsspec
import h5py
import pytest

from gcd_dataset import Job, export, generate
from gcd_dataset.cli import main
from gcd_dataset.generator.drape import outcome
from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.hub.publish import stage
from gcd_dataset.loaders import ElasticSampler, GarmentDataset
from gcd_dataset.making import garments
from gcd_dataset.records import Drape, Outcome, Sample
from tests.making.real import contents, stopped

COUNT = 8
KEPT = MakeConfig(
    bodies="both",
    resolution=10.0,
    points=16,
    picture=0,
    device="cpu",
    on_fail="keep",
    design=Overlay.from_dict({"meta": {"upper": None, "bottom": "PencilSkirt"}}),
)


@pytest.fixture(scope="module")
def strict() -> Iterator[None]:
    """A narrow limit on body edges through the cloth, so that some drapes always fail."""
    judge = outcome._judge

    def judged(job: DrapeJob, drape: Drape, config: DrapeConfig, status: int, *, overfull: bool) -> tuple[Outcome, str]:
        found, reason = judge(job, drape, config, status, overfull=overfull)
        return (Outcome.THROUGH_BODY if found is Outcome.SETTLED and drape.body_through > 80 else found), reason

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(outcome, "_judge", judged)
        yield


@pytest.fixture(scope="module")
def samples(strict: None) -> tuple[Sample, ...]:
    """Skirts on two bodies; some settled and some failed."""
    return tuple(produce(5, range(COUNT), KEPT))


@pytest.fixture(scope="module")
def failed(samples: tuple[Sample, ...]) -> list[int]:
    found = [k for k, sample in enumerate(samples) if sample.drape and sample.drape.outcome is not Outcome.SETTLED]
    assert 0 < len(found) < COUNT
    return found


@pytest.fixture(autouse=True)
def made_before(samples: tuple[Sample, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    def made(
        seed: int, indices: Iterable[int], config: MakeConfig, *, finished: Callable[[Sample], Any], workers: int = 0
    ) -> Iterator[Any]:
        assert config == KEPT
        return (finished(samples[index]) for index in indices)

    monkeypatch.setattr(garments, "produce", made)


@pytest.fixture
def out(tmp_path: Path) -> Path:
    generate(tmp_path / "kept", COUNT, seed=5, config=KEPT)
    return tmp_path / "kept"


def test_settled_drapes_go_to_train_and_others_to_failed(out: Path, failed: list[int]) -> None:
    train, others = GarmentDataset(out), GarmentDataset(out, "failed")
    assert [item["meta"]["index"] for item in others] == failed
    assert [item["meta"]["index"] for item in train] == [k for k in range(COUNT) if k not in failed]
    assert all(item["meta"]["drape"]["outcome"] == "SETTLED" for item in train)
    assert all(item["meta"]["drape"]["outcome"] != "SETTLED" for item in others)
    assert len(GarmentDataset(out, "train+failed")) == COUNT


def test_readers_cope_with_gaps(out: Path, failed: list[int], tmp_path: Path) -> None:
    train = GarmentDataset(out)
    settled = [k for k in range(COUNT) if k not in failed]
    assert train[f"gcd_{settled[-1]:09d}"]["meta"]["index"] == settled[-1]
    with pytest.raises(KeyError):
        train[f"gcd_{failed[0]:09d}"]
    assert sorted(ElasticSampler(train, seed=1)) == list(range(len(settled)))
    assert [train.recipe(position)["index"] for position in range(len(train))] == settled
    export(out, tmp_path / "train.h5")
    with h5py.File(tmp_path / "train.h5") as file:
        assert len(file.keys()) > 0
    assert export(out, tmp_path / "published", "published").made == len(settled)


def test_info_and_verify_know_both_splits(out: Path, failed: list[int], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(out), "--bytes"]) == 0
    assert "nothing harmful found" in capsys.readouterr().out
    assert main(["info", str(out)]) == 0
    said = capsys.readouterr().out
    assert f"failed: {len(failed)} samples" in said
    assert f"train: {COUNT - len(failed)} samples" in said


def test_counts_are_printed_by_split(
    tmp_path: Path, failed: list[int], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "kept.toml"
    config.write_text('[design.meta]\nupper = "none"\nbottom = "PencilSkirt"\n')
    options = ["--bodies", "both", "--resolution", "10", "--points", "16", "--picture", "0", "--device", "cpu"]
    command = ["generate", str(tmp_path / "kept"), "--count", str(COUNT), "--seed", "5", "--config", str(config)]
    assert main([*command, *options, "--on-fail", "keep", "--quiet"]) == 0
    assert f"train {COUNT - len(failed)}, failed {len(failed)}" in capsys.readouterr().out


def test_a_store_holds_the_same_as_a_folder(out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    url = f"memory://bucket/{tmp_path.name}"

    stopped(partial(generate, url, COUNT, seed=5, config=KEPT), after=4)
    generate(url, COUNT, seed=5, config=KEPT)
    store = fsspec.filesystem("memory")
    root = f"/bucket/{tmp_path.name}/"
    assert {name.removeprefix(root): store.cat_file(name) for name in store.find(root)} == contents(out)


@pytest.mark.parametrize("of", [2, 9])
def test_jobs_of_both_splits_are_one_run(of: int, out: Path, tmp_path: Path) -> None:
    for number in reversed(range(of)):
        generate(tmp_path / "jobs", COUNT, seed=5, config=KEPT, job=Job(number, of))
    assert contents(tmp_path / "jobs") == contents(out)


def test_notes_of_failed_drapes_are_made_again(out: Path) -> None:
    before = contents(out)
    for name in [name for name in before if name.startswith("failed-") and name.endswith(".json")]:
        (out / name).unlink()
    (out / "manifest.json").unlink()
    generate(out, COUNT, seed=5, config=KEPT)
    assert contents(out) == before


def test_publishing_divides_train_and_keeps_failed(out: Path, failed: list[int], tmp_path: Path) -> None:
    """Designs of failed drapes may also be in train: the split ``failed`` is no test set."""
    staged = stage(out, "org/garments", tmp_path / "staged")
    assert staged.manifest.counts["failed"] == len(failed)
    assert staged.garments == COUNT
    assert set(staged.manifest.splits) > {"failed", "train"}
    card = (staged.folder / "README.md").read_text()
    assert "but the neutral one, is in two splits; `failed` holds failed drapes" in card


def test_a_rejected_drape_is_reported_with_its_figures(
    tmp_path: Path, strict: None, monkeypatch: pytest.MonkeyPatch, failed: list[int]
) -> None:
    monkeypatch.setattr(garments, "produce", produce)
    design = failed[0] // 2
    config = replace(KEPT, on_fail="retry", max_attempts=2)
    generate(tmp_path, 2 * design + 1, seed=5, config=config, workers=0)
    message = [json.loads(line) for line in (tmp_path / "rejects.jsonl").read_text().splitlines()]
    [line] = [line for line in message if line["design"] == design]
    assert (line["index"], line["attempt"], line["rule"]) == (failed[0], 0, "drape")
    assert line["figures"].keys() >= {"frames", "body_crossings", "self_crossings", "stretch_p99"}
    assert line["figures"]["body_through"] > 80 or line["reason"] != "through_body"
