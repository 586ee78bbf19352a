"""A sample depends on seed, index and recipe alone, with any draper and any number of workers."""

import io
import json
import re
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, Self
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image

from gcd_dataset.errors import ConfigError, DrapeError, PatternError
from gcd_dataset.generator import pipeline
from gcd_dataset.generator.body import build_body, draw_shape, measure, named_pose, neutral_shape, walk
from gcd_dataset.generator.drapers import DrapeReply, DrapeRequest
from gcd_dataset.generator.drapers.draper import DrapeWork, in_order
from gcd_dataset.generator.garments import Reject, attempted_design, design_from_dict, garment_tags
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.maker import make, produce
from gcd_dataset.generator.pipeline import build_pattern, fit
from gcd_dataset.generator.recipe import MakeConfig, layout_of_samples, recipe_of
from gcd_dataset.records import Drape, Measurements, Outcome
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.shards.codec import decode_field, decode_fields, decode_sample, encode_sample
from tests.generator.body.test_motion import A_POSE, bvh, turns_of

FLAT = MakeConfig(stage="pattern")
MESHED = MakeConfig(stage="mesh", resolution=8.0, points=64)
DRAPED = MakeConfig(resolution=8.0, points=64, picture=48, device="cpu")


def test_a_sample_is_the_same_alone_and_in_any_order() -> None:
    in_order = list(produce(5, range(3), MESHED))
    assert in_order == list(produce(5, [2, 1, 0], MESHED))[::-1]
    assert make(5, 2, MESHED) == in_order[2]
    assert [sample.provenance.index for sample in in_order] == [0, 1, 2]


def test_seeds_and_indices_make_different_garments() -> None:
    first, second, other = make(5, 0, FLAT), make(5, 1, FLAT), make(6, 0, FLAT)
    assert first.design != second.design
    assert first.design != other.design
    assert first.measurements != other.measurements


def test_a_stage_leaves_out_the_later_fields_and_holds_gathers_and_tags() -> None:
    flat, meshed = make(5, 0, FLAT), make(5, 0, MESHED)
    assert (flat.box_mesh, flat.points, meshed.drape, meshed.front) == (None, None, None, None)
    assert meshed.pattern == flat.pattern
    assert meshed.points is not None
    assert meshed.points.shape == (64, 6)
    for sample in (flat, meshed):
        assert sample.gathers == sample.pattern.gather_ratios()
        assert sample.tags == garment_tags(sample.measurements, design_from_dict(sample.design), sample.pattern)
        assert sample.tags


def test_a_pattern_keeps_the_gathers_of_its_seams() -> None:
    """Levels one and a half times as long as the hems above: the ratio of exactly those seams."""
    values = {
        "meta": {"bottom": "SkirtLevels", "wb": "FittedWB"},
        "levels-skirt": {"base": "SkirtCircle", "level": "Skirt2", "num_levels": 2, "level_ruffle": 1.5},
    }
    pattern = build_pattern(measure(build_body(neutral_shape())), design_from_dict(values))
    ratios = pattern.gather_ratios()
    assert len(ratios) == len(pattern.seams)
    for seam, ratio in zip(pattern.seams, ratios, strict=True):
        between_levels = seam.left.panel.rpartition("_")[2] != seam.right.panel.rpartition("_")[2]
        sides = pattern.panel(seam.left.panel).edges[seam.left.edge].name
        if sides == "bottom" and between_levels and "wb" not in seam.left.panel:
            assert ratio == pytest.approx(1 / 1.5, abs=1e-3)
        elif sides in ("right", "left"):
            assert ratio == pytest.approx(1.0, abs=1e-3)
    assert sum(ratio < 0.7 for ratio in ratios) == 4  # front and back of two levels


def test_both_bodies_wear_one_design() -> None:
    neutral, random, following = produce(9, [4, 5, 6], replace(FLAT, bodies="both"))
    assert neutral.design == random.design != following.design
    assert neutral.provenance.body_name == following.provenance.body_name == "neutral"
    assert random.measurements != neutral.measurements == following.measurements
    assert random.measurements == make(9, 2, FLAT).measurements  # the random body of number 2


def test_one_design_may_have_many_wearers() -> None:
    config = replace(FLAT, bodies="female", bodies_each=3)
    first, second, third, following = produce(9, [3, 4, 5, 6], config)
    assert first.design == second.design == third.design != following.design
    assert len({sample.provenance.body_name for sample in (first, second, third)}) == 3
    assert first.measurements != second.measurements != third.measurements != first.measurements
    assert first.measurements == make(9, 1, replace(config, bodies_each=1)).measurements
    assert second == make(9, 4, config)
    neutral, *others = produce(9, range(3), replace(config, bodies="both", bodies_each=2))
    assert neutral.provenance.body_name == "neutral"
    assert {sample.design == neutral.design for sample in others} == {True}
    with pytest.raises(ConfigError, match="one neutral body"):
        replace(config, bodies="neutral")


def test_turned_arms_do_not_change_the_pattern() -> None:
    in_pose = list(produce(5, range(4), FLAT))
    turned = list(produce(5, range(4), replace(FLAT, arms=15)))
    assert [sample.pattern for sample in turned] == [sample.pattern for sample in in_pose]
    assert [sample.measurements for sample in turned] == [sample.measurements for sample in in_pose]
    turns = [np.degrees(sample.shape.arm_angle) for sample in turned if sample.shape]
    assert len(set(turns)) == 4
    assert 1.0 < np.abs(turns).max() <= 15.0
    assert make(5, 2, replace(FLAT, arms=15)) == turned[2]
    assert "arms" not in recipe_of(FLAT)
    assert recipe_of(replace(FLAT, arms=15))["arms"] == 15.0
    with pytest.raises(ConfigError, match="arms is 50"):
        replace(FLAT, arms=50)


SHORT = Overlay.from_dict({"meta": {"upper": "none", "bottom": "SkirtCircle"}, "flare-skirt": {"length": 0.2}})


def test_poses_are_drawn_by_seed_and_number_and_change_no_pattern() -> None:
    plain = replace(DRAPED, design=SHORT)
    standing = replace(plain, poses="standing")
    first, second = produce(5, range(2), standing)
    assert make(5, 1, standing) == second
    before = make(5, 1, plain)
    assert (second.pattern, second.measurements) == (before.pattern, before.measurements)
    assert first.shape and second.shape and before.shape and first.shape.pose and second.shape.pose
    stored = decode_sample(encode_sample(second)).shape
    assert stored and stored.pose == second.shape.pose
    assert (second.shape.pose.name, second.shape.pose.cuts) == ("standing", 0)
    assert first.shape.pose != second.shape.pose
    assert second.shape == replace(before.shape, pose=second.shape.pose)
    assert "poses" not in recipe_of(plain)
    assert layout_of_samples(standing).members == tuple(encode_sample(first))


@pytest.fixture
def steps(tmp_path: Path) -> MakeConfig:
    """Short skirts on bodies that walk for three frames."""
    frames = [turns_of(pose) for pose in walk()[20:23]]
    (tmp_path / "steps.bvh").write_text(bvh(A_POSE, frames))
    return replace(DRAPED, picture=0, design=SHORT, poses=str(tmp_path / "steps.bvh"))


def test_a_motion_begins_with_the_draped_garment(steps: MakeConfig, tmp_path: Path) -> None:
    """And goes on with the body; of a file its content decides, wherever it lies, of a gait its name."""
    sample = make(5, 1, steps)
    assert sample.motion and sample.drape and sample.shape and sample.shape.pose
    assert (len(sample.motion.poses), sample.motion.asked, sample.motion.ended) == (3, 3, Outcome.SETTLED)
    np.testing.assert_array_equal(sample.motion.vertices[0], sample.drape.vertices)
    assert np.abs(np.diff(sample.motion.vertices, axis=0)).max(axis=(1, 2)).min() > 0.2
    assert sample.shape.pose.name == "steps, frame 1"
    members = encode_sample(sample)
    assert tuple(members) == layout_of_samples(steps).members
    assert "motion.z" in members and "pose.z" in members
    stored = decode_sample(members).motion
    assert stored and (stored.asked, stored.ended) == (3, Outcome.SETTLED)
    np.testing.assert_array_equal(stored.vertices, sample.motion.vertices)
    assert members == encode_sample(next(produce(5, [1], steps)))
    (tmp_path / "other").mkdir()
    (tmp_path / "other/steps.bvh").write_text((tmp_path / "steps.bvh").read_text())
    assert recipe_of(steps) == recipe_of(replace(steps, poses=str(tmp_path / "other/steps.bvh")))
    assert recipe_of(replace(steps, poses="walk"))["poses"] == "walk"


@pytest.mark.parametrize(("outcomes", "kept"), [(("SETTLED", "FELL"), 2), (("DIVERGED",), 1)])
def test_a_motion_that_fails_keeps_its_frames(
    steps: MakeConfig, monkeypatch: pytest.MonkeyPatch, outcomes: tuple[str, ...], kept: int
) -> None:
    def fail(job: object, rests: Sequence[Drape], *_: object, **__: object) -> Iterator[tuple[int, Drape]]:
        yield from ((0, replace(rests[0], outcome=Outcome[name])) for name in outcomes)

    monkeypatch.setattr("gcd_dataset.generator.drape.drape.drape_on", fail)
    meta = decode_field("meta", encode_sample(make(5, 1, steps)))
    assert meta["drape"]["outcome"] == "SETTLED"
    told = {"frames": kept, "asked": 3, "fps": 30.0, "ended": outcomes[-1]}
    assert meta["motion"] == told | {"crossings": [[0, 0, 0]] * kept}


def test_a_garment_that_never_rests_has_no_frames(steps: MakeConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    """It has the members and types of all others."""
    best = "gcd_dataset.generator.drape.batches.best_of"
    monkeypatch.setattr(best, lambda drapes: replace(drapes[-1], outcome=Outcome.FELL))
    members = encode_sample(make(5, 1, replace(steps, on_fail="keep")))
    assert decode_fields(members, ["motion_verts"])["motion_verts"].shape == (0, 3)
    assert json.loads(members["meta.json"])["motion"]["crossings"] == [[-1, -1, -1]]
    stored = decode_sample(members).motion
    assert stored and (stored.poses, stored.asked, stored.ended) == ((), 3, Outcome.FELL)


def test_pictures_and_maps_show_the_body_in_its_pose(tmp_path: Path) -> None:
    """Arms are level; a long sleeve stays near the skin. Of a file its content decides, wherever it lies."""
    level = {"shoulder": [0, 8, 0], "upper_arm": [0, 37, 0]}
    (tmp_path / "level.json").write_text(json.dumps([level]))
    shirt = {"meta": {"upper": "Shirt", "bottom": "none", "wb": "none"}, "sleeve": {"sleeveless": False, "length": 0.9}}
    given = replace(DRAPED, design=Overlay.from_dict(shirt), bodies="neutral", maps=True)
    sample = make(5, 0, replace(given, poses=str(tmp_path / "level.json")))
    assert sample.shape and sample.shape.pose == replace(named_pose("t-pose"), name="level")
    assert sample.drape and sample.maps and sample.front
    arms = np.abs(sample.drape.vertices[:, 0]) > 35.0
    assert sample.drape.vertices[arms, 1].min() > 115.0
    assert np.median(sample.maps.gap[arms]) < 6.0
    rows, columns = np.nonzero(np.asarray(Image.open(io.BytesIO(sample.front)).convert("L")) < 225)
    assert rows[columns < columns.min() + 3].mean() < 0.35 * DRAPED.picture  # a hand
    (tmp_path / "other").mkdir()
    (tmp_path / "other/level.json").write_text(json.dumps(level))
    recipes = [recipe_of(replace(DRAPED, poses=str(tmp_path / name))) for name in ("level.json", "other/level.json")]
    assert recipes[0] == recipes[1]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"stage": "mesh"}, "poses are of a drape, and stage mesh drapes nothing"),
        ({"outfits": "everyday"}, "poses are for single garments"),
        ({"outfits": "everyday", "poses": "walk"}, "poses are for single garments"),
    ],
)
def test_poses_that_no_drape_has_are_refused(options: dict, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        replace(DRAPED, **{"poses": "standing", **options})


def test_random_wearers_are_women_and_men_named_by_their_sex() -> None:
    samples = [make(9, index, replace(FLAT, bodies="random")) for index in range(6)]
    names = [sample.provenance.body_name for sample in samples]
    assert {name.partition(":")[0] for name in names} == {"female", "male"}
    index = next(index for index, name in enumerate(names) if name == f"female:9:{index}")
    assert samples[index].measurements == make(9, index, replace(FLAT, bodies="female")).measurements


@pytest.mark.parametrize("group", ["female", "male", "pooled"])
def test_adults_of_a_group_wear_designs_under_its_name(group: Literal["female", "male", "pooled"]) -> None:
    sample = make(9, 2, replace(FLAT, bodies=group))
    assert sample.provenance.body_name == f"{group}:9:2"
    assert sample.measurements == measure(build_body(draw_shape(rng(9, 2, Stage.BODY), group=group)))


def test_a_draped_sample_is_complete() -> None:
    sample = make(5, 1, DRAPED)
    assert sample.drape is not None and sample.box_mesh is not None and sample.points is not None
    assert sample.drape.outcome is Outcome.SETTLED
    assert sample.drape.vertices.shape == sample.box_mesh.vertices.shape
    assert np.linalg.norm(sample.drape.vertices - sample.box_mesh.vertices, axis=1).max() > 3.0
    low, high = sample.drape.vertices.min(axis=0) - 0.01, sample.drape.vertices.max(axis=0) + 0.01
    assert ((sample.points[:, :3] >= low) & (sample.points[:, :3] <= high)).all()
    for jpeg in (sample.front, sample.back):
        assert jpeg is not None
        assert Image.open(io.BytesIO(jpeg)).size == (48, 48)


NEUTRAL = measure(build_body(neutral_shape()))


class Failing:
    """A draper that fails the first ``times`` drapes of each wearer; vertices stay at their start positions."""

    at_once = 2

    def __init__(self, times: int, *, but_neutral: bool = False) -> None:
        self.times, self.but_neutral = times, but_neutral
        self.tried = Counter[Measurements]()
        self.replies = deque[DrapeReply]()

    def send(self, request: DrapeRequest) -> None:
        size = request.job.measurements
        self.tried[size] += 1
        fails = self.tried[size] <= self.times and not (self.but_neutral and size == NEUTRAL)
        outcome = Outcome.NOT_SETTLED if fails else Outcome.SETTLED
        drape = Drape(request.job.box_mesh.vertices, outcome, 1, 0, 0, 1.0, 1.0)
        self.replies.append(DrapeReply(request.number, drape, None))

    def poll(self) -> bool:
        return bool(self.replies)

    def receive(self) -> DrapeReply:
        return self.replies.popleft()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.replies.clear()


@pytest.mark.parametrize(("options", "told"), [({"maps": True}, "maps"), ({"poses": "walk"}, "motion")])
def test_a_draper_that_makes_less_than_it_is_asked_for_is_named(options: dict, told: str) -> None:
    with pytest.raises(DrapeError, match=rf"the draper made no {told}: .* where DrapeRequest.{told} is set"):
        next(produce(5, [0], replace(DRAPED, picture=0, **options), draper=Failing(0)))


def test_failed_drapes_raise_the_number_of_attempts_and_redraws_are_those_of_all() -> None:
    """A rejected design adds the redraws of the next attempt, and itself."""
    samples = list(produce(5, range(3), replace(DRAPED, picture=0), draper=Failing(2)))
    assert [sample.provenance.index for sample in samples] == [0, 1, 2]
    for index, sample in enumerate(samples):
        made = sample.provenance
        assert made.rejects.count("drape: not_settled") == 2
        assert made.attempts == len(made.rejects) + 1
        redraws = Counter(reject.partition(":")[0] for reject in made.rejects)
        for number in range(made.attempts):
            redraws += attempted_design(5, index, number, [sample.measurements]).by_rule()
        assert made.redraws == redraws
        assert list(made.redraws) == sorted(made.redraws)
        assert sample.drape is not None
        assert sample.drape.outcome is Outcome.SETTLED


def test_after_a_failed_drape_the_upper_and_the_bottom_stay() -> None:
    config = replace(DRAPED, picture=0, bodies="random")
    first, second = (produce(5, range(4), config, draper=Failing(times)) for times in (0, 1))
    for kept, again in zip(first, second, strict=True):
        for part in ("upper", "bottom"):
            assert kept.design["meta"][part] == again.design["meta"][part]
        assert kept.design != again.design


def test_a_failed_drape_and_the_last_attempt_can_be_kept() -> None:
    """A garment that never settles does not stop a data set."""
    [kept] = produce(5, [0], replace(DRAPED, picture=0, on_fail="keep"), draper=Failing(1))
    [last] = produce(5, [7], replace(DRAPED, picture=0, max_attempts=3), draper=Failing(99))
    assert [sample.drape and sample.drape.outcome for sample in (kept, last)] == [Outcome.NOT_SETTLED] * 2
    assert kept.provenance.rejects == make(5, 0, FLAT).provenance.rejects
    assert last.provenance.attempts == 3


def test_another_attempt_does_not_build_the_wearers_again(monkeypatch: pytest.MonkeyPatch) -> None:
    config = replace(FLAT, bodies="both")
    first = pipeline.prepare(77, 3, config)
    monkeypatch.setattr(pipeline, "build_body", build := Mock(wraps=build_body))
    monkeypatch.setattr(pipeline, "measure", tape := Mock(wraps=measure))
    again = pipeline.prepare(77, 3, config)
    assert [worn.body for worn in again.dressed] == [worn.body for worn in first.dressed]
    build.assert_not_called()
    tape.assert_not_called()


def test_a_failed_drape_rejects_the_design_for_both_bodies() -> None:
    """Only the random body's drape fails, once; the neutral body gets the next design too."""
    config = replace(DRAPED, picture=0, bodies="both")
    neutral, random = produce(5, [6, 7], config, draper=Failing(1, but_neutral=True))
    assert neutral.design == random.design
    assert neutral.provenance.rejects == random.provenance.rejects
    assert neutral.provenance.rejects.count("drape: not_settled") == 1
    assert list(produce(5, [6], config, draper=Failing(1, but_neutral=True))) == [neutral]


def test_the_error_of_an_index_without_a_pattern_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(size: object, design: object, *, name: str) -> Reject:
        return Reject("short_edge", "it is 0.3 cm")

    monkeypatch.setattr(pipeline, "try_on", never)
    message = "sample 7 of seed 5: 3 designs were rejected, the last for: short_edge: it is 0.3 cm"
    with pytest.raises(PatternError, match=message):
        make(5, 7, replace(FLAT, max_attempts=3))


@pytest.mark.parametrize(
    ("option", "value", "expected"),
    [
        ("resolution", "fine", "resolution is 'fine': give a number"),
        ("points", 3.5, "points is 3.5: give a whole number"),
        ("picture", True, "picture is True: give a whole number"),
        ("device", 3, "device is 3: give a word"),
        ("max_attempts", 0, "max_attempts is 0: give 1 to 10000"),
        ("points", 10**12, "points is 1000000000000: give 0 to 1048576"),
        ("points", 10**20, "points is 10**15 or more: give 0 to 1048576"),
        ("picture", 200_000, "picture is 200000: give 0 to 4096"),
        ("bodies_each", 10**9, "bodies_each is 1000000000: give 1 to 10000"),
        ("resolution", 50, "resolution is 50 cm: give a length from 0.2 to 10"),
        ("bodies", "fat", "unknown bodies 'fat': choose one of neutral, random, "),
        ("fabric", "denin", "unknown fabric 'denin': choose one of default, gcd_soft"),
    ],
)
def test_options_are_checked(option: str, value: object, expected: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(expected)):
        MakeConfig(**{option: value})  # type: ignore[arg-type]


def test_a_recipe_is_the_same_with_2_and_2_0_and_another_with_a_fabric() -> None:
    whole, same = (json.dumps(recipe_of(replace(DRAPED, resolution=value))) for value in (2, 2.0))
    assert whole == same
    assert recipe_of(DRAPED)["device"] == "cpu"
    assert "fabric" not in recipe_of(DRAPED)  # recipes from before the option keep their hash
    assert recipe_of(replace(DRAPED, fabric="denim"))["fabric"] == "denim"


def test_trousers_are_draped_on_legs_apart() -> None:
    """The measures are taken with legs together, as for every body."""
    worn = [Overlay.from_dict({"meta": {"upper": "none", "bottom": name}}) for name in ("Pants", "PencilSkirt")]
    trousers, skirt = (make(5, 0, replace(FLAT, design=overlay)) for overlay in worn)
    assert trousers.shape is not None
    assert skirt.shape is not None
    assert (trousers.shape.legs_apart, skirt.shape.legs_apart) == (True, False)
    assert trousers.measurements == skirt.measurements == measure(build_body(skirt.shape))


def test_an_overlay_is_part_of_the_recipe() -> None:
    hoodies = Overlay.from_dict({"meta": {"upper": "Shirt"}, "collar": {"component": {"style": "Hood2Panels"}}})
    config = replace(FLAT, design=hoodies)
    assert {"left_hood", "right_hood"} <= {panel.name for panel in make(5, 0, config).pattern.panels}
    assert Overlay.from_dict(recipe_of(config)["design"]) == hoodies
    assert recipe_of(config) != recipe_of(FLAT)


def test_one_design_fits_many_bodies() -> None:
    sizes = [measure(build_body(draw_shape(rng(3, number, Stage.BODY)))) for number in range(3)]
    design = design_from_dict({"meta": {"upper": "FittedShirt", "bottom": "PencilSkirt"}})
    patterns = fit(design, sizes)
    assert [pattern.name for pattern in patterns] == ["wearer_0", "wearer_1", "wearer_2"]
    assert patterns[1] == build_pattern(sizes[1], design, name="wearer_1")
    tall = design_from_dict({"meta": {"bottom": "SkirtCircle"}, "flare-skirt": {"length": 0.9}})
    with pytest.raises(PatternError, match=r"wearer 0: too_heavy: length 0\.90 .*: change the design, or leave"):
        fit(tall, sizes)


def test_workers_and_a_single_process_make_the_same_samples() -> None:
    """Also where the workers return results of ``finished``, in the order of the indices."""
    coarse = replace(MESHED, bodies="both")
    alone = [encode_sample(sample) for sample in produce(5, [4, 0, 1, 5], coarse)]
    assert list(produce(5, [4, 0, 1, 5], coarse, workers=2, finished=encode_sample)) == alone


def test_indices_may_be_infinite() -> None:
    def forever() -> Iterator[int]:
        while True:
            yield from (0, 1)

    made = produce(5, forever(), replace(FLAT, bodies="both"))
    first, second, third = next(made), next(made), next(made)
    assert first == third != second


def test_a_failure_waits_for_the_results_before_it() -> None:
    """The third piece of work fails first, while the first two are pending."""
    begun: list[DrapeRequest] = []

    def receive() -> DrapeReply:
        return DrapeReply(begun.pop().number, None, None)  # type: ignore[arg-type]

    backwards = Mock(at_once=4, send=begun.append, poll=lambda: False, receive=receive)

    def piece(number: int) -> DrapeWork[int]:
        def finish(_: Sequence[DrapeReply]) -> int:
            if number == 2:
                raise PatternError("piece 2")
            return number

        return DrapeWork([None], finish)  # type: ignore[list-item]

    made: list[int] = []
    with pytest.raises(PatternError, match="piece 2"):
        made.extend(in_order(map(piece, range(4)), backwards, ahead=4, at_once=4))
    assert made == [0, 1]
