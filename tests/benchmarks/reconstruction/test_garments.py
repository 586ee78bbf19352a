"""Garment sets: what is read is what was made, hashes tell sets apart, and splits share neither design nor body."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from benchmarks.reconstruction import garments, tasks
from benchmarks.reconstruction.derived import CENTRE
from benchmarks.reconstruction.garments import GarmentSet, Split, fresh_garments, generated, read_folder, split_off
from benchmarks.reconstruction.models import baselines
from benchmarks.reconstruction.models.baselines import ceiling, nearest, typical
from benchmarks.reconstruction.tasks import TASKS, task_named
from gcd_dataset.errors import ConfigError
from gcd_dataset.exports.published import garment_type
from gcd_dataset.generator import MakeConfig
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.maker import make
from gcd_dataset.generator.recipe import recipe_of
from gcd_dataset.loaders import GeneratedGarments
from gcd_dataset.measurements import MEASURES
from gcd_dataset.metrics import score_pattern
from gcd_dataset.records import Drape, Outcome
from gcd_dataset.shards import ShardWriter
from tests.benchmarks.reconstruction.conftest import SKIRTS

PATTERNS: dict[str, Any] = {"points": 0, "stage": "pattern", "drape": None}


def same(one: GarmentSet, other: GarmentSet) -> bool:
    return (
        one.keys == other.keys
        and one.kinds == other.kinds
        and all(np.array_equal(getattr(one, n), getattr(other, n)) for n in ("designs", "bodies", "shapes", "points"))
        and one.patterns_hash == other.patterns_hash
    )


def test_a_set_holds_the_garments_that_were_made(six: GarmentSet) -> None:
    config = MakeConfig(stage="mesh", resolution=5.0, picture=0, points=512, design=Overlay.from_dict(SKIRTS))
    sample = make(0, 4, config)
    assert sample.points is not None
    assert sample.shape is not None
    assert six.keys[4] == "0_000000004"
    assert score_pattern(six.pattern(4), sample.pattern).stitch_f1 == 1.0
    assert [panel.label for panel in six.pattern(4).panels] == [panel.label for panel in sample.pattern.panels]
    assert np.allclose(six.points[4][:, :3] + CENTRE, sample.points[:, :3], atol=0.1)
    assert np.allclose(six.shapes[4], sample.shape.weights)
    assert six.measures[4][MEASURES.index("waist")] == pytest.approx(sample.measurements.waist)
    assert set(six.kinds) == {"skirt"}


def test_a_saved_set_is_read_as_it_was(six: GarmentSet, tmp_path: Path) -> None:
    six.save(tmp_path / "set.npz")
    assert same(GarmentSet.load(tmp_path / "set.npz"), six)
    assert GarmentSet.load(tmp_path / "set.npz").recipe == six.recipe
    whole = (tmp_path / "set.npz").read_bytes()
    for damaged in (b"PK", b"", whole[:1000]):
        (tmp_path / "set.npz").write_bytes(damaged)
        with pytest.raises(ConfigError, match="delete the file"):
            GarmentSet.load(tmp_path / "set.npz")


def test_a_cached_set_grows_and_holds_the_smaller_ones(tmp_path: Path) -> None:
    made = {count: generated(count, 3, cache=tmp_path, **PATTERNS) for count in (3, 5, 2)}
    assert len(list(tmp_path.iterdir())) == 1
    assert [len(found) for found in made.values()] == [3, 5, 2]
    assert same(made[2], made[5].select([0, 1]))
    assert same(made[5], generated(5, 3, **PATTERNS))


def test_a_stopped_call_keeps_the_garments_that_it_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = generated(5, 3, **PATTERNS)
    portions, begun = garments._portions, list[int]()

    def stopped(found: Any, first: int, count: int) -> Iterator[tuple[int, GarmentSet]]:
        begun.append(first)
        yield from islice(portions(found, first, count), 2)
        if len(begun) == 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(garments, "PORTION", 2)
    monkeypatch.setattr(garments, "_portions", stopped)
    with pytest.raises(KeyboardInterrupt):
        generated(5, 3, cache=tmp_path, **PATTERNS)
    assert same(generated(5, 3, cache=tmp_path, **PATTERNS), whole)
    assert begun == [0, 4]


def test_workers_make_the_same_set() -> None:
    assert same(generated(3, 0, workers=2, **PATTERNS), generated(3, 0, **PATTERNS))


def numbered(designs: list[int], bodies: list[int], six: GarmentSet) -> GarmentSet:
    """A set with these designs and bodies; its patterns are copies."""
    found = six.select(np.arange(len(designs)) % len(six))
    keys = tuple(str(k) for k in range(len(designs)))
    return replace(found, designs=np.array(designs), bodies=np.array(bodies), keys=keys)


def test_a_split_shares_neither_design_nor_body(six: GarmentSet) -> None:
    # Ten designs, each on a body of its own, and on body 0, which all wear.
    whole = numbered([k // 2 for k in range(20)], [0 if k % 2 else k + 1 for k in range(20)], six)
    split = split_off(whole, 3, checked=2)
    assert (len(np.unique(split.test.designs)), len(np.unique(split.check.designs))) == (3, 2)
    assert (len(split.train), len(split.check), len(split.test)) == (10, 2, 3)
    assert 0 not in split.test.bodies
    assert not set(split.train.bodies) & set(split.test.bodies)
    assert split.first(4).train.keys == split.train.keys[:4]
    assert split.first(4).test.keys == split.test.keys


def test_a_kind_is_left_out(six: GarmentSet) -> None:
    named = replace(six, kinds=("skirt", "dress") * 3)
    split = Split(named.select([0, 1]), named.select([2, 3]), named.select([4, 5])).without("dress")
    assert (split.train.kinds, split.check.kinds, split.test.kinds) == (("skirt",), ("skirt",), ("dress",))
    with pytest.raises(ConfigError, match="no pants to test on: choose one of dress, skirt"):
        Split(named.select([0, 1]), named.select([2, 3]), named.select([4, 5])).without("pants")


def write_folder(folder: Path, stage: str, *outcomes: Outcome, points: int = 64, design: Any = ()) -> str:
    """Write garments of a stage; the folder. Their drapes are box meshes."""
    overlay = Overlay.from_dict(dict(design))
    config = MakeConfig(resolution=8.0, picture=0, points=points, stage="mesh", device="cpu", design=overlay)
    with ShardWriter(folder, seed=5, recipe=recipe_of(config)) as writer:
        for index, outcome in enumerate(outcomes):
            sample = make(5, index, config if stage != "pattern" else MakeConfig(stage="pattern"))
            if stage == "drape":
                assert sample.box_mesh is not None
                drape = Drape(sample.box_mesh.vertices, outcome, 1, 0, 0, 1.0, 1.0)
                sample = replace(sample, drape=drape)
            writer.write(sample)
    return str(folder)


def test_garments_that_did_not_settle_are_left_out(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, "drape", Outcome.SETTLED, Outcome.SLID_OFF, Outcome.SETTLED)
    assert read_folder(folder, points=64).keys == ("5_000000000", "5_000000002")


@pytest.mark.parametrize(("stage", "tasks"), [("pattern", "T0 T1 T2 T6"), ("mesh", "T1 T1-scan T4"), ("drape", "T0")])
def test_garments_of_another_stage_are_refused(stage: str, tasks: str, tmp_path: Path) -> None:
    folder = write_folder(tmp_path, stage, *2 * [Outcome.SETTLED])
    for name in tasks.split():
        needed = "mesh" if name == "T0" else "drape"
        with pytest.raises(ConfigError, match=f"garments of stage {stage}: give garments made with --stage {needed}$"):
            task_named(name).load(1, source=folder)
    assert len(read_folder(folder, points=0)) == 2  # a task without points, T3, reads garments of any stage


def test_a_stream_begins_at_any_garment() -> None:
    stream = fresh_garments(_key, 3, first=2, **PATTERNS)
    assert [next(stream) for _ in range(3)] == [(k, f"3_{k:09d}") for k in (2, 3, 4)]


def _key(garments: GarmentSet) -> str:
    return garments.keys[0]


def test_a_scan_shows_one_side_of_the_garment(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, "drape", Outcome.SETTLED, points=4096, design=SKIRTS)
    whole, scanned = (
        read_folder(folder, points=points, extra=extra)
        for points, extra in ((4096, ()), (8192, task_named("T1-scan").extra))
    )
    assert scanned.points.shape == (1, 8192, 6)
    assert "scan" not in scanned.ragged
    ours, theirs = scanned.points[0, :, :3].astype(float), whole.points[0, :, :3].astype(float)
    assert 0.2 < np.mean(cKDTree(ours).query(theirs)[0] < 3.0) < 0.8
    assert np.mean(cKDTree(theirs).query(ours)[0] < 6.0) > 0.95


# ---------------------------------------------------------------------------------------------------------------- tasks


COARSE: dict[str, Any] = {"resolution": 6.0, "design": SKIRTS}


def test_the_test_set_depends_neither_on_the_task_nor_on_the_size() -> None:
    mesh = TASKS["T0"].load(3, tested=2, **COARSE)
    pattern = TASKS["T3"].load(5, tested=2, design=SKIRTS)
    assert mesh.test.patterns_hash == pattern.test.patterns_hash
    assert mesh.test.keys == pattern.test.keys
    assert mesh.train.patterns_hash == pattern.train.select(range(3)).patterns_hash
    assert mesh.train.points.shape == (3, 8192, 6)
    assert pattern.train.points.shape == (5, 0, 6)
    assert not np.isin(pattern.test.bodies, pattern.train.bodies).any()


def test_another_seed_has_other_garments_to_train_on_and_the_same_test_set() -> None:
    one, other = (TASKS["T3"].load(3, tested=2, seed=seed, design=SKIRTS) for seed in (0, 7))
    assert one.test.keys == other.test.keys
    assert not np.isin(other.train.designs, one.train.designs).any()
    with pytest.raises(ConfigError, match="2 designs are in train and test"):
        TASKS["T3"].load(3, tested=2, seed=1, design=SKIRTS)


@pytest.mark.long
def test_the_validation_set_has_enough_trousers_jumpsuits_and_hoods(monkeypatch: pytest.MonkeyPatch) -> None:
    """500 garments as sampled, and 60 and more of each kind; none is trained or tested on."""
    counts = [count for _, count, _ in tasks.VALIDATION]
    assert counts[0] >= 500
    assert min(counts[1:]) > 60
    monkeypatch.setattr(tasks, "VALIDATION", [(seed, 4, design) for seed, _, design in tasks.VALIDATION])
    found, split = TASKS["T3"].validation(500), TASKS["T3"].load(30, tested=30)
    assert found.kinds[4:12] == ("pants",) * 4 + ("jumpsuit",) * 4
    seed, _, design = tasks.VALIDATION[3]
    hoods = GeneratedGarments(4, seed, stage="pattern", drape=None, design=design, fields=["design"])
    assert all("hoodie" in garment_type(hoods[k]["design"])["styles"] for k in range(4))
    for other in (split.train, split.check, split.test):
        assert not np.isin(found.designs, other.designs).any()
        assert not np.isin(found.bodies, other.bodies).any()


CPU = torch.device("cpu")


def test_the_nearest_garment_to_a_training_garment_is_itself(six: GarmentSet) -> None:
    points = torch.from_numpy(six.points[..., :3]).float()
    assert baselines.nearest_garments(points[:, :256], points[:, 256:]).tolist() == [0, 1, 2, 3, 4, 5]
    answers = nearest(six, six.select([4, 1]), device=CPU)
    assert [answer == six.pattern(k) for answer, k in zip(answers, (4, 1), strict=True)] == [True, True]


def test_the_most_typical_garment_is_central(six: GarmentSet) -> None:
    cloud = torch.rand(64, 3, generator=torch.Generator().manual_seed(0))
    assert baselines.most_typical(torch.stack([cloud + shift for shift in (0.0, 5.0, 9.0)])) == 1
    answers = typical(six, six.select([0, 1, 2]), device=CPU)
    assert len(answers) == 3
    assert answers[0] == answers[2]


def test_the_ceiling_is_nearly_the_truth(six: GarmentSet) -> None:
    (answer,) = ceiling(six, six.select([3]), device=CPU)
    score = score_pattern(answer, six.pattern(3))
    assert score.iou > 0.99
    assert score.stitch_f1 == 1.0
