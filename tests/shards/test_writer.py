"""The small writer: new splits in ascending order, all or nothing."""

import hashlib
import json
import os
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gcd_dataset.errors import ConfigError, OutputError, ShardError
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.shards import ShardReader, ShardWriter, encode_sample
from gcd_dataset.shards.access import Place, lock_file, unlock
from gcd_dataset.shards.layout import is_picture, recipe_hash
from gcd_dataset.shards.manifest import Plan
from gcd_dataset.shards.notes import gather
from gcd_dataset.shards.writer import Draft, draft_name, shard_size_of
from tests.shards.folders import RECIPE, SHARD_SIZE, contents, fill, forbidden, open_writer, public_folder


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    """Ten samples in shards of four."""
    return fill(tmp_path / "whole", range(10))


def test_members_lie_in_two_tars_that_the_manifest_lists(whole: Path, tmp_path: Path) -> None:
    reader = ShardReader(whole)
    assert reader.record.plan == Plan("garments", 0, RECIPE, 10, SHARD_SIZE)
    assert [shard.count for shard in reader.record.shards] == [4, 4, 2]
    for position in range(10):
        assert reader.read(position, reader.layout.members) == encode_sample(fake_sample(0, position))
    assert [member for member in reader.layout.members if is_picture(member)] == ["front.jpg", "back.jpg"]
    for shard in reader.record.shards:
        main, views = ((whole / shard.name("train", views=views)).read_bytes() for views in (False, True))
        assert b"front.jpg" in views and b"front.jpg" not in main.replace(b'"front.jpg"', b"")
        assert (shard.size, shard.sha256) == (len(main), hashlib.sha256(main).hexdigest())
        assert (shard.views_size, shard.views_sha256) == (len(views), hashlib.sha256(views).hexdigest())
    members = {name: data for name, data in encode_sample(fake_sample(0, 0)).items() if not is_picture(name)}
    with open_writer(tmp_path / "bare") as writer:
        writer.add(0, members)
    assert not (tmp_path / "bare" / "views").exists()
    assert ShardReader(tmp_path / "bare").read(0, members) == members


def test_samples_ascend_and_splits_are_new(whole: Path, tmp_path: Path) -> None:
    with open_writer(tmp_path / "new") as writer:
        writer.write(fake_sample(0, 3))
        with pytest.raises(ConfigError, match="gcd_000000003 after gcd_000000003: write samples in ascending order"):
            writer.write(fake_sample(0, 3))
    with pytest.raises(OutputError, match="this writer is closed"):
        writer.write(fake_sample(0, 4))
    for number in (-5, 2**31):
        with open_writer(tmp_path / str(number)) as writer, pytest.raises(ConfigError, match="numbers from 0 to 2"):
            writer.add(number, encode_sample(fake_sample(0, 3)))
    before = contents(whole)
    with pytest.raises(ConfigError, match="holds split train already: choose another folder"):
        open_writer(whole)
    fill(whole, [0], split="test")
    assert (len(ShardReader(whole)), len(ShardReader(whole, "test"))) == (10, 1)
    assert before.items() <= {**contents(whole), "manifest.json": before["manifest.json"]}.items()


def test_what_cannot_be_written_is_refused_at_once(tmp_path: Path) -> None:
    for options in ({"seed": -1}, {"count": -1}, {"shard_size": 0}):
        given: dict[str, Any] = {"seed": 0, "recipe": RECIPE, **options}
        with pytest.raises(ConfigError, match=rf"{tmp_path}: .* no data set can be written with it"):
            ShardWriter(tmp_path, **given)
    assert not contents(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="file/out: cannot be written"):
        open_writer(tmp_path / "file" / "out")
    with public_folder() as folder, forbidden(folder, 0o555), pytest.raises(OutputError, match="cannot be written"):
        fill(folder, range(2))


def test_samples_have_the_same_members(tmp_path: Path) -> None:
    with open_writer(tmp_path) as writer:
        writer.write(fake_sample(0, 0))
        with pytest.raises(ConfigError, match=r"its samples differ in caption\.txt: give the same members to all"):
            writer.write(replace(fake_sample(0, 1), caption="a skirt"))
        with pytest.raises(ShardError, match=r"sample 7 cannot be stored: its meta\.json says 1"):
            writer.add(7, encode_sample(fake_sample(0, 1)))


def test_nothing_stays_of_an_error_and_a_kill_is_no_hindrance(tmp_path: Path, whole: Path) -> None:
    """Between two samples, and before the second of three shards gets its name: then equal bytes."""
    folder = tmp_path / "new"
    with pytest.raises(KeyboardInterrupt), open_writer(folder) as writer:
        for index in range(6):
            writer.write(fake_sample(0, index))
        raise KeyboardInterrupt
    assert not contents(folder)
    put = Place.put

    def refused(place: Place, path: Path, name: str) -> None:
        if name == "train-00001.tar":
            raise KeyboardInterrupt
        put(place, path, name)

    with pytest.MonkeyPatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(Place, "put", refused)
        fill(folder, range(10))
    assert not contents(folder)
    if (child := os.fork()) == 0:
        writer = open_writer(folder)
        for index in range(6):
            writer.write(fake_sample(0, index))
        os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    assert contents(fill(folder, range(10))) == contents(whole)


def test_a_set_of_fewer_samples_than_planned_is_unfinished(tmp_path: Path) -> None:
    fill(tmp_path, range(7), count=100, shard_size=None)
    message = ShardReader(tmp_path).store.unfinished("train")
    assert message == "7 of 100 samples are made: the same command goes on"
    assert [shard.count for shard in ShardReader(tmp_path).record.shards] == [5, 2]


def test_shards_hold_whole_designs_and_are_a_function_of_the_count() -> None:
    for count in (1, 19, 20, 400, 640, 8192, 8193, 10**7):
        for wearers in (1, 2, 3, 7):
            size = shard_size_of(count, wearers)
            assert size % wearers == 0
            assert 1 <= size < 128 + wearers
            assert count < 20 * wearers or -(-count // size) >= 20


def test_counts_of_rules_add_up(tmp_path: Path) -> None:
    reasons = [(), ("too_long: 180 cm", "too_long: 190 cm"), ("self_crossing: panel a",), ("too_long: 170 cm",)]
    redraws = [{}, {"tight_cuff": 2}, {"tight_cuff": 1, "self_crossing": 5}, {}]
    with ShardWriter(tmp_path, seed=0, recipe=RECIPE, shard_size=2) as writer:
        for index, (rejects, redrawn) in enumerate(zip(reasons, redraws, strict=True)):
            sample = fake_sample(0, index)
            writer.write(replace(sample, provenance=replace(sample.provenance, rejects=rejects, redraws=redrawn)))
    split = ShardReader(tmp_path).record
    assert list(split.rejects.items()) == [("too_long", 3), ("self_crossing", 1)]
    assert list(split.redraws.items()) == [("self_crossing", 5), ("tight_cuff", 3)]


def test_recipes_with_4_and_4_0_are_equal() -> None:
    plans = [Plan("garments", 0, {"spacing": spacing, "nested": {"list": [spacing]}}, 1, 1) for spacing in (4, 4.0)]
    plans[0].require_same(plans[1], "here")
    with pytest.raises(ConfigError, match=r"here: made with nested=.*, asked for nested=True"):
        plans[0].require_same(replace(plans[0], recipe={"spacing": 4, "nested": True}), "here")
    assert len({recipe_hash({"n": value}) for value in (1, True, 1.5)}) == 3


INDICES = range(4)
PLAN = Plan("garments", 0, fake_sample(0, 0).provenance.recipe, 10, SHARD_SIZE)


def draft(folder: Path, *, wait: bool = False) -> Draft | None:
    return Draft.open(Place(folder), PLAN, "train", 0, INDICES, wait=wait)


def own_draft(folder: Path) -> Draft:
    return draft(folder) or pytest.fail("locked, or finished")


def finished(folder: Path) -> dict[str, bytes]:
    with own_draft(folder) as opened:
        for index in INDICES:
            if index not in opened.done:
                opened.add(index, encode_sample(fake_sample(0, index)))
        opened.finish()
    return contents(folder)


def cut(path: Path) -> None:
    os.truncate(path, path.stat().st_size - 700)


def zeroed(path: Path) -> None:
    """After a power cut some blocks are zeros."""
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2] + bytes(4096) + content[len(content) // 2 + 4096 :])


@pytest.mark.parametrize("views", [False, True])
@pytest.mark.parametrize("damage", [cut, zeroed, Path.unlink])
def test_whole_samples_of_a_damaged_draft_are_kept(damage: Callable[[Path], None], views: bool, tmp_path: Path) -> None:
    folder = tmp_path / "damaged"
    with own_draft(folder) as opened:
        for index in range(3):
            opened.add(index, encode_sample(fake_sample(0, index)))
    damage(folder / draft_name("train", 0, PLAN.count, views=views))
    with own_draft(folder) as opened:
        assert opened.done < {0, 1, 2}
        assert opened.done == set(range(len(opened.done)))
    assert finished(folder) == finished(tmp_path / "whole")


def test_a_draft_belongs_to_one_process(tmp_path: Path) -> None:
    with own_draft(tmp_path):
        assert draft(tmp_path) is None
        assert (tmp_path / draft_name("train", 0, PLAN.count)).exists()
    finished(tmp_path)
    assert draft(tmp_path, wait=True) is None  # the shard is there
    assert not list(tmp_path.glob(".*"))


def test_skipped_samples_are_noted(tmp_path: Path) -> None:
    with own_draft(tmp_path) as opened:
        opened.add(0, encode_sample(fake_sample(0, 0)))
        for index in (1, 2, 3):
            opened.skip(index, "unreadable")
        opened.finish()
    note = json.loads((tmp_path / "train-00000.json").read_text())
    assert note["skipped"] == {"1": "unreadable", "2": "unreadable", "3": "unreadable"}
    manifest = gather(Place(tmp_path)).manifest
    assert (manifest.splits["train"].skipped, manifest.missing("train")) == (3, (4, 10))


def test_a_forked_child_does_not_keep_the_lock(tmp_path: Path) -> None:
    """A worker, forked by a process that holds the lock, outlives it."""
    held = lock_file(tmp_path / ".lock", wait=False) or pytest.fail("locked")
    ended, end = os.pipe()
    if (child := os.fork()) == 0:
        os.close(end)
        os.read(ended, 1)
        os._exit(0)
    assert lock_file(tmp_path / ".lock", wait=False) is None
    unlock(held)
    unlock(lock_file(tmp_path / ".lock", wait=False) or pytest.fail("locked"))
    for pipe in (end, ended):
        os.close(pipe)
    os.waitpid(child, 0)
