"""Kept failed drapes go to the split ``failed``, under their own numbers."""

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import fsspec
import pytest

from gcd_dataset import Job, export, generate
from gcd_dataset.cli import main
from gcd_dataset.generator.drape import outcome
from gcd_dataset.generator.drape.config import DrapeConfig, DrapeJob
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.hub.publish import stage
from gcd_dataset.loaders import ElasticSampler, GarmentDataset
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.making import garments
from gcd_dataset.records import Drape, Outcome, Sample
from tests.making.conftest import stopped
from tests.shards.folders import contents

COUNT = 8
FAILED, SETTLED = [1, 4, 5], [0, 2, 3, 6, 7]
KEPT = MakeConfig(bodies="both", resolution=10.0, device="cpu", on_fail="keep")
make = partial(generate, count=COUNT, seed=5, config=KEPT)


@cache
def sample(index: int) -> Sample:
    made = fake_sample(5, index)
    assert made.drape is not None
    drape = replace(made.drape, outcome=Outcome.NOT_SETTLED if index in FAILED else Outcome.SETTLED)
    return replace(made, drape=drape, provenance=replace(made.provenance, recipe=recipe_of(KEPT)))


@pytest.fixture
def out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The data set; from now on the garments are fake ones."""

    def made(
        seed: int, indices: Iterable[int], config: MakeConfig, *, finished: Callable[[Sample], Any], workers: int = 0
    ) -> Iterator[Any]:
        return (finished(sample(index)) for index in indices)

    monkeypatch.setattr(garments, "produce", made)
    make(tmp_path / "kept")
    return tmp_path / "kept"


def test_settled_drapes_go_to_train_and_others_to_failed(
    out: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    train, others = GarmentDataset(out), GarmentDataset(out, "failed")
    assert [item["meta"]["index"] for item in others] == FAILED
    assert [item["meta"]["index"] for item in train] == SETTLED
    assert all(item["meta"]["drape"]["outcome"] == "SETTLED" for item in train)
    assert all(item["meta"]["drape"]["outcome"] != "SETTLED" for item in others)
    assert len(GarmentDataset(out, "train+failed")) == COUNT
    assert train[f"gcd_{SETTLED[-1]:09d}"]["meta"]["index"] == SETTLED[-1]
    with pytest.raises(KeyError):
        train[f"gcd_{FAILED[0]:09d}"]
    assert sorted(ElasticSampler(train, seed=1)) == list(range(len(SETTLED)))
    assert [train.recipe(position)["index"] for position in range(len(train))] == SETTLED
    assert export(out, tmp_path / "train.h5").made == len(SETTLED)
    assert main(["info", str(out)]) == 0
    said = capsys.readouterr().out
    assert f"failed: {len(FAILED)} samples" in said and f"train: {len(SETTLED)} samples" in said
    options = ["--bodies", "both", "--resolution", "10", "--device", "cpu", "--on-fail", "keep", "--quiet"]
    assert main(["generate", str(tmp_path / "again"), "--count", str(COUNT), "--seed", "5", *options]) == 0
    assert f"train {len(SETTLED)}, failed {len(FAILED)}" in capsys.readouterr().out


def test_a_store_jobs_and_made_notes_hold_the_same(out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = contents(out)
    monkeypatch.setenv("HOME", str(tmp_path))
    url, root = f"memory://bucket/{tmp_path.name}", f"/bucket/{tmp_path.name}/"
    stopped(partial(make, url), after=4)
    make(url)
    store = fsspec.filesystem("memory")
    assert {name.removeprefix(root): store.cat_file(name) for name in store.find(root)} == whole
    for of in (2, 9):
        for number in reversed(range(of)):
            make(tmp_path / str(of), job=Job(number, of))
        assert contents(tmp_path / str(of)) == whole
    for path in (*out.glob("failed-*.json"), out / "manifest.json"):
        path.unlink()
    make(out)
    assert contents(out) == whole


def test_publishing_divides_train_and_keeps_failed(out: Path, tmp_path: Path) -> None:
    """Designs of failed drapes may also be in train: the split ``failed`` is no test set."""
    staged = stage(out, "org/garments", tmp_path / "staged")
    assert staged.manifest.counts["failed"] == len(FAILED)
    assert staged.garments == COUNT
    assert set(staged.manifest.splits) > {"failed", "train"}
    card = (staged.folder / "README.md").read_text()
    assert "but the neutral one, is in two splits; `failed` holds failed drapes" in card


def test_a_rejected_drape_is_reported_with_its_figures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a judge whom the first drape, coarse and fine, does not pass."""
    judge, is_first = outcome._judge, iter([True, True])

    def judged(job: DrapeJob, drape: Drape, config: DrapeConfig, status: int, *, overfull: bool) -> tuple[Outcome, str]:
        found, reason = judge(job, drape, config, status, overfull=overfull)
        return Outcome.THROUGH_BODY if next(is_first, False) else found, reason

    monkeypatch.setattr(outcome, "_judge", judged)
    skirt = Overlay.from_dict({"meta": {"upper": None, "bottom": "PencilSkirt"}})
    config = replace(KEPT, on_fail="retry", points=16, picture=0, bodies="neutral", design=skirt)
    generate(tmp_path, 1, seed=5, config=config, workers=0)
    line = json.loads((tmp_path / "rejects.jsonl").read_text().splitlines()[0])
    assert (line["index"], line["attempt"], line["rule"]) == (0, 0, "drape")
    assert line["figures"].keys() >= {"frames", "body_crossings", "body_through", "self_crossings", "stretch_p99"}
