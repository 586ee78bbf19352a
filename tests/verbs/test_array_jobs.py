"""A data set made in parts equals the data set of a single run, byte for byte."""

import errno
import json
import os
import re
import shutil
import signal
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from gcd_dataset.cli import main
from gcd_dataset.errors import ConfigError, GcdError, OutputError, ShardError
from gcd_dataset.generator.maker import produce
from gcd_dataset.generator.recipes import Recipe
from gcd_dataset.hub.publish import stage
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.shards.access import locked
from gcd_dataset.shards.job_parts import part_folder
from gcd_dataset.shards.layout import lock_name
from gcd_dataset.verbs import (
    JobPart,
    Progress,
    convert,
    generate,
    generate_people,
    generate_recipe,
    making,
    merge,
    merging,
    storing,
)
from gcd_dataset.verbs.seal import claim
from gcd_dataset.verbs.storing import GarmentWriter, split_rule
from tests.verbs.real import COUNT, CUFFED, contents, killed, made_once

SHARD_SIZE = 4


@pytest.fixture(autouse=True)
def small_shards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(storing, "SHARD_SIZE", SHARD_SIZE)
    monkeypatch.setattr(making, "produce", made_once)


@pytest.fixture
def whole(tmp_path: Path) -> dict[str, bytes]:
    """The files of a data set made in a single run."""
    generate(tmp_path / "whole", COUNT, config=CUFFED)
    return contents(tmp_path / "whole")


def part_of(out: Path, number: int, of: int, **options: Any) -> Any:
    return generate(out, **{"count": COUNT, "config": CUFFED, "part": JobPart(number, of), **options})


def parts_in(out: Path, of: int) -> Path:
    for number in range(of):
        part_of(out, number, of)
    return out


@pytest.mark.parametrize(
    ("of", "order"),
    [
        (1, [0]),
        (2, [1, 0]),
        (3, [2, 0, 2, 1, 0]),
        (7, [3, 1, 6, 0, 5, 2, 4]),  # more parts than shards
        (30, [*range(30)]),  # more parts than designs
    ],
)
def test_parts_in_any_order_are_one_run(of: int, order: list[int], whole: dict[str, bytes], tmp_path: Path) -> None:
    out = tmp_path / "parts"
    for number in order:
        part_of(out, number, of)
    assert merge(out) == {"train": COUNT}
    assert contents(out) == whole


def test_a_shard_of_one_part_is_moved_not_copied(tmp_path: Path, whole: dict[str, bytes]) -> None:
    out = parts_in(tmp_path / "parts", 2)
    first, second = (part_folder(out, number, 2) for number in (0, 1))
    assert sorted(path.name for path in first.glob("*.tar")) == [f"train-0000{k}.tar" for k in (0, 1, 2)]
    assert sorted(path.name for path in second.glob("*.tar")) == [f"train-0000{k}.tar" for k in (3, 4, 5)]
    before = {path.name: path.stat().st_ino for folder in (first, second) for path in folder.glob("*.tar")}
    merge(out)
    assert {path.name: path.stat().st_ino for path in out.glob("*.tar")} == before
    assert contents(out) == whole


@pytest.mark.parametrize(("of", "count", "wearers"), [(3, 23, 2), (7, 5, 1), (4, 100, 3), (1, 1, 2), (9, 64, 2)])
def test_parts_share_out_whole_designs(of: int, count: int, wearers: int) -> None:
    ranges = [JobPart(number, of).indices(count, wearers=wearers) for number in range(of)]
    assert [index for indices in ranges for index in indices] == list(range(count))
    assert all(indices.start % wearers == 0 for indices in ranges if indices)
    assert max(map(len, ranges)) - min(map(len, ranges)) <= 2 * wearers


def test_a_killed_part_goes_on(tmp_path: Path, whole: dict[str, bytes]) -> None:
    out = tmp_path / "parts"
    part_of(out, 0, 2)
    killed(partial(part_of, out, 1, 2), after=7)
    with pytest.raises(ShardError, match=r"part 1/2 is not finished: run gcd generate .* --shard 1/2"):
        merge(out)
    assert part_of(out, 1, 2).made == COUNT - 12 - 7
    merge(out)
    assert contents(out) == whole


def test_a_finished_part_makes_nothing_and_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "parts"
    options = ["--count", "3", "--stage", "pattern", "--quiet", "--shard", "1/2"]
    assert main(["generate", str(out), *options]) == 0
    said = capsys.readouterr().out
    assert "part 1/2: 2 garments, 2 of them made now" in said
    assert f"1 of 2 parts are finished: make the others, then run gcd merge {out}" in said
    before = contents(out)
    assert main(["generate", str(out), *options]) == 0
    assert "part 1/2 is there already: 2 garments, 0 of them made now" in capsys.readouterr().out
    assert contents(out) == before
    assert main(["generate", str(out), *options[:-1], "0/2"]) == 0
    assert main(["merge", str(out), "--quiet"]) == 0
    assert f"{out}: 3 garments: train 3" in capsys.readouterr().out
    before = contents(out)
    assert main(["generate", str(out), *options]) == 0
    assert "part 1/2 is there already" in capsys.readouterr().out
    assert contents(out) == before


def test_a_finished_part_records_its_plan(tmp_path: Path) -> None:
    parts_in(tmp_path, 3)
    record = json.loads((part_folder(tmp_path, 1, 3) / "part.json").read_text())
    assert [record[name] for name in ("part", "of", "first", "stop", "count", "seed")] == [1, 3, 8, 16, COUNT, 0]
    assert record["versions"].keys() >= {"gcd_dataset", "numpy"}
    assert [shard["count"] for shard in record["splits"]["train"]] == [4, 4]


@pytest.mark.parametrize("of", [1, 3])
def test_parts_of_a_recipe_are_the_data_set_of_its_name(
    of: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(making, "produce", produce)
    recipe = tmp_path / "flat.toml"
    recipe.write_text(
        'name = "flat"\nabout = "flat"\ndesigns = 6\nseed = 3\n[options]\nstage = "pattern"\nbodies = "both"\n'
        "[splits]\ntest = 0.3\ntrain = 0.7\n"
    )
    command = ["generate", "--recipe", str(recipe), "--quiet"]
    assert main([*command, str(tmp_path / "whole")]) == 0
    for number in range(of):
        assert main([*command, str(tmp_path / "parts"), "--shard", f"{number}/{of}"]) == 0
    merge(tmp_path / "parts")
    assert contents(tmp_path / "parts") == contents(tmp_path / "whole")
    assert main(["verify", str(tmp_path / "parts"), "--recipe", str(recipe)]) == 0
    assert main([*command, str(tmp_path / "parts"), "--shard", "0/2"]) == 0
    assert "part 0/2 is there already: 6 garments" in capsys.readouterr().out


def test_parts_of_another_recipe_are_refused(tmp_path: Path) -> None:
    recipe = Recipe("flat", "flat", 6, 0, CUFFED, {"train": 1.0})
    generate_recipe(tmp_path, recipe, part=JobPart(0, 2))
    for other in (replace(recipe, splits={"test": 0.5, "train": 0.5}), replace(recipe, name="other")):
        with pytest.raises(
            ConfigError, match=r"made by recipe flat \(.*\), asked for .*: use the same or another folder"
        ):
            generate_recipe(tmp_path, other, part=JobPart(1, 2))
    with pytest.raises(ConfigError, match="continue with --recipe, or choose another folder"):
        part_of(tmp_path, 1, 2, count=12)
    with pytest.raises(ShardError, match=r"part 1/2 is missing: run gcd generate \S+ --recipe FILE\.toml --shard 1/2"):
        merge(tmp_path)


def test_a_recipe_that_is_refused_leaves_no_name_among_parts_of_none(tmp_path: Path, whole: dict[str, bytes]) -> None:
    out = tmp_path / "out"
    part_of(out, 0, 2)
    recipe = Recipe("flat", "flat", 6, 0, CUFFED, {"train": 1.0})
    with pytest.raises(ConfigError, match="parts begun with count=23"):
        generate_recipe(out, recipe, part=JobPart(0, 2))
    with pytest.raises(ConfigError, match="1 of 2 parts are finished"):
        generate_recipe(out, recipe)
    part_of(out, 1, 2)
    merge(out)
    assert contents(out) == whole


def test_parts_that_a_named_set_refuses_leave_no_plan(tmp_path: Path) -> None:
    recipe = Recipe("flat", "flat", 6, 0, CUFFED, {"train": 1.0})
    claim(tmp_path, recipe)
    with pytest.raises(ConfigError, match="continue with --recipe"):
        part_of(tmp_path, 0, 2)
    assert not (tmp_path / ".parts").exists()


def test_a_recipe_whose_merge_was_killed_gets_its_hash_by_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recipe = Recipe("flat", "flat", 6, 0, CUFFED, {"train": 1.0})
    generate_recipe(tmp_path / "whole", recipe)
    for number in (0, 1):
        generate_recipe(tmp_path / "parts", recipe, part=JobPart(number, 2))

    def work(on_progress: Callable[..., None]) -> None:
        monkeypatch.setattr(merging, "seal", lambda *_: os.kill(os.getpid(), signal.SIGKILL))
        merge(tmp_path / "parts")

    killed(work, after=99)
    merge(tmp_path / "parts")
    assert contents(tmp_path / "parts") == contents(tmp_path / "whole")


# ------------------------------------------------------------------------------------------------------ a broken merge


@pytest.mark.parametrize("after", range(8))
def test_a_merge_killed_at_any_shard_is_finished_by_the_next(
    after: int, tmp_path: Path, whole: dict[str, bytes]
) -> None:
    out = parts_in(tmp_path / "parts", 5)
    if after < 7:  # progress is reported before the first shard, and after each of six
        killed(partial(merge, out), after=after)
        with pytest.raises(ShardError, match="was stopped: run gcd merge"):
            GarmentDataset(out)
        with pytest.raises(ConfigError, match="was stopped: run gcd merge"):
            part_of(out, 1, 5)
    merge(out)
    assert contents(out) == whole


@pytest.mark.parametrize(
    "where",
    [
        "gcd_dataset.verbs.merging._write_manifest",
        "gcd_dataset.verbs.merging._remove",
        "gcd_dataset.shards.growing.shard_record",
        "gcd_dataset.shards.growing.sync_folder",
        "shutil.rmtree",
    ],
)
def test_a_merge_killed_between_its_steps_is_finished_by_the_next(
    where: str, tmp_path: Path, whole: dict[str, bytes]
) -> None:
    out = parts_in(tmp_path / "parts", 5)

    def work(on_progress: Callable[..., None]) -> None:
        def killed_there(*_: object) -> None:
            os.kill(os.getpid(), signal.SIGKILL)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(where, killed_there)
            merge(out)

    killed(work, after=99)
    merge(out)
    assert contents(out) == whole


def test_a_disk_full_while_merging_loses_nothing(
    tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = parts_in(tmp_path / "parts", 5)
    left, pwrite = [150_000], os.pwrite

    def write(file: int, data: memoryview, offset: int) -> int:
        left[0] -= len(data)
        if left[0] < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return pwrite(file, data, offset)

    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", write)
        with pytest.raises(OutputError, match=r"train-0000\d\.tar\.part.*No space left.*make room there"):
            merge(out)
    assert merge(out) == {"train": COUNT}
    assert contents(out) == whole


def test_two_merges_at_once_keep_out_of_each_others_way(tmp_path: Path, whole: dict[str, bytes]) -> None:
    out = parts_in(tmp_path / "parts", 2)
    with (
        locked(out / lock_name("train"), "merging its parts"),
        pytest.raises(OutputError, match=r"another process is merging its parts, .*wait for it"),
    ):
        merge(out)
    merge(out)
    assert contents(out) == whole


def test_a_part_that_is_being_made_is_not_merged(tmp_path: Path, whole: dict[str, bytes]) -> None:
    out = parts_in(tmp_path / "parts", 2)
    with (
        GarmentWriter(part_folder(out, 1, 2), 0, CUFFED, split_rule(CUFFED)),
        pytest.raises(OutputError, match="00001-of-00002: another process is making this part"),
    ):
        merge(out)
    merge(out)
    assert contents(out) == whole


def test_a_damaged_part_is_named_and_made_again(tmp_path: Path, whole: dict[str, bytes]) -> None:
    out = parts_in(tmp_path / "parts", 3)
    shard = part_folder(out, 1, 3) / "train-00003.tar"
    os.truncate(shard, 5000)
    with pytest.raises(
        ShardError, match=r"00001-of-00003/train-00003\.tar: only 5000 of .* delete it and run .*--shard 1/3"
    ):
        merge(out)
    shard.unlink()
    assert part_of(out, 1, 3).made == 4
    merge(out)
    assert contents(out) == whole


def test_a_byte_that_changed_in_a_shared_shard_is_found(tmp_path: Path) -> None:
    out = parts_in(tmp_path / "parts", 5)
    shard = part_folder(out, 3, 5) / "train-00003.tar"
    content = bytearray(shard.read_bytes())
    content[2000] ^= 1
    shard.write_bytes(content)
    with pytest.raises(
        ShardError, match=r"train-00003\.tar: only \d of its \d samples are undamaged: delete it and run"
    ):
        merge(out)


# ------------------------------------------------------------------------------------------------------------ bad input


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"seed": 1}, "seed=0, asked for seed=1"),
        ({"count": COUNT + 1}, "count=23, asked for count=24"),
        ({"part": JobPart(1, 4)}, "parts=2, asked for parts=4"),
        ({"config": replace(CUFFED, bodies="neutral")}, "bodies='both', asked for bodies='neutral'"),
    ],
)
def test_parts_that_do_not_belong_together_are_refused(changed: dict[str, Any], message: str, tmp_path: Path) -> None:
    part_of(tmp_path, 0, 2)
    before = contents(tmp_path)
    with pytest.raises(ConfigError, match=rf"parts\.json: parts begun with {message}: use the same, .*start over"):
        part_of(tmp_path, 1, 2, **changed)
    assert contents(tmp_path) == before


@pytest.mark.parametrize("package", ["gcd_dataset", "numpy"])
def test_parts_of_another_version_are_refused(package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    part_of(tmp_path, 0, 2)
    plan = tmp_path / ".parts/parts.json"
    plan.write_text(re.sub(rf'"{package}":"[^"]*"', f'"{package}":"99.1"', plan.read_text()))
    with pytest.raises(ConfigError, match=rf"begun with {package}='99\.1', asked for {package}="):
        part_of(tmp_path, 1, 2)


@pytest.mark.parametrize(
    ("name", "value"), [("seed", 5), ("count", 99), ("recipe_sha256", "0"), ("schema", 1), ("of", 9)]
)
def test_a_part_copied_from_elsewhere_is_refused(name: str, value: object, tmp_path: Path) -> None:
    parts_in(tmp_path, 2)
    note = part_folder(tmp_path, 1, 2) / "part.json"
    note.write_text(json.dumps({**json.loads(note.read_text()), name: value}))
    with pytest.raises(
        ConfigError, match=r"part\.json: made with .*, the other parts with .*: delete .* and run gcd gen"
    ):
        merge(tmp_path)
    part_of(tmp_path, 0, 2)  # the failed merge left no lock


def test_a_folder_that_holds_a_copy_of_another_part_is_refused(tmp_path: Path) -> None:
    parts_in(tmp_path, 2)
    before = contents(part_folder(tmp_path, 0, 2))
    shutil.rmtree(part_folder(tmp_path, 1, 2))
    shutil.copytree(part_folder(tmp_path, 0, 2), part_folder(tmp_path, 1, 2))
    with pytest.raises(
        ConfigError, match=r"00001-of-00002/part\.json: record of part 0, expected part 1: delete .* and run"
    ):
        merge(tmp_path)
    assert contents(part_folder(tmp_path, 0, 2)) == before  # no shard was moved


def test_a_part_of_another_number_is_refused(tmp_path: Path) -> None:
    parts_in(tmp_path, 2)
    part_folder(tmp_path, 1, 2).rename(part_folder(tmp_path, 1, 3))
    with pytest.raises(ConfigError, match="00001-of-00003: not one of the 2 parts: move it elsewhere"):
        merge(tmp_path)


def test_missing_parts_are_named_with_the_command_that_makes_them(tmp_path: Path) -> None:
    out = tmp_path / "a folder"
    part_of(out, 2, 9)
    message = (
        rf"part 0/9, 1/9, 3/9, 4/9, 5/9 and 3 more are missing: run gcd generate '{re.escape(str(out))}' --count 23 "
        r"--seed 0 --bodies both --stage pattern --config FILE\.toml --shard 0/9"
    )
    with pytest.raises(ShardError, match=message):
        merge(out)


def test_parts_that_wait_are_identified_wherever_the_data_set_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = parts_in(tmp_path / "parts", 2)
    message = re.escape(f"{out}: made in parts: 2 of 2 parts are finished: run gcd merge {out}")
    with pytest.raises(ShardError, match=message):
        GarmentDataset(out)
    with pytest.raises(ConfigError, match=message):
        stage(out, "org/garments", tmp_path / "staged", partial=True)
    with pytest.raises(ConfigError, match=message):
        generate(out, COUNT, config=CUFFED)
    for verb in ("info", "verify", "index"):
        assert main([verb, str(out)]) == 1
        assert re.search(message, capsys.readouterr().err.strip())


def test_a_part_of_a_complete_data_set_is_stored_or_refused(tmp_path: Path, whole: dict[str, bytes]) -> None:
    out = tmp_path / "whole"
    assert part_of(out, 1, 2).made == 0
    with pytest.raises(ConfigError, match="not made in parts and lacks 1 of the 12 samples of part 1/2: continue it"):
        part_of(out, 1, 2, count=COUNT + 1)
    with pytest.raises(ConfigError, match="seed=0, asked for seed=4"):
        part_of(out, 1, 2, seed=4)
    assert contents(out) == whole


def test_a_folder_without_parts_is_reported(tmp_path: Path, whole: dict[str, bytes]) -> None:
    with pytest.raises(ShardError, match="no parts to be merged: it already holds a complete data set"):
        merge(tmp_path / "whole")
    with pytest.raises(
        ShardError, match="no parts to be merged: give a folder with parts made by gcd generate --shard"
    ):
        merge(tmp_path)


def test_shards_beside_the_parts_are_not_replaced(tmp_path: Path, whole: dict[str, bytes]) -> None:
    out = parts_in(tmp_path / "parts", 2)
    (out / "train-00000.tar").write_bytes(b"something else")
    with pytest.raises(ConfigError, match=r"holds train-00000\.tar, which belongs to none of its parts"):
        merge(out)
    (out / "train-00000.tar").unlink()
    merge(out)
    assert contents(out) == whole


@pytest.mark.parametrize("name", [".parts/parts.json", ".parts/00001-of-00002/part.json"])
@pytest.mark.parametrize(
    "content", [b"", b"{", b"[]", b'{"of": -1}', b"\xff", b'{"part": 1, "of": 2, "splits": {"train": 3}}']
)
def test_a_broken_plan_or_record_is_reported(name: str, content: bytes, tmp_path: Path) -> None:
    parts_in(tmp_path, 2)
    (tmp_path / name).write_bytes(content)
    with pytest.raises(GcdError, match=rf"{re.escape(name)}: .*(run this part again|make the parts again)"):
        merge(tmp_path)


@pytest.mark.parametrize(
    ("shard", "task", "message"),
    [
        ("5/4", None, "--shard 5/4: part 5/4: no such part: the first is 0/4, the last 3/4"),
        ("0/0", None, "--shard 0/0: .*give 1 to 100000"),
        ("a/b", None, "--shard a/b: .*write I/N"),
        ("-1/4", None, "--shard -1/4: .*write I/N"),
        ("1", None, "--shard 1: .*write I/N"),
        (f"0/{10**30}", None, "write I/N"),
        ("SLURM/4", None, "SLURM_ARRAY_TASK_ID is not set: submit it with sbatch --array=0-3, or give I/4"),
        ("SLURM/4", "4", "SLURM_ARRAY_TASK_ID is 4: submit it with sbatch --array=0-3"),
        ("SLURM/x", "0", "--shard SLURM/x: .*write I/N"),
    ],
)
def test_a_part_that_is_none_is_wrong_usage(
    shard: str,
    task: str | None,
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.delenv("SLURM_ARRAY_TASK_ID", raising=False)
    if task is not None:
        monkeypatch.setenv("SLURM_ARRAY_TASK_ID", task)
    assert main(["generate", str(tmp_path / "out"), "--count", "4", "--stage", "pattern", f"--shard={shard}"]) == 2
    [line] = capsys.readouterr().err.strip().splitlines()
    assert re.search(message, line)
    assert not (tmp_path / "out").exists()


def test_an_array_job_takes_its_part_from_slurm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLURM_ARRAY_TASK_ID", "3")
    command = ["generate", str(tmp_path), "--count", "4", "--stage", "pattern", "--quiet", "--shard", "slurm/4"]
    assert main(command) == 0
    assert (part_folder(tmp_path, 3, 4) / "part.json").exists()


def test_bodies_are_made_in_one_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["generate", str(tmp_path), "--count", "4", "--stage", "body", "--shard", "0/2"]) == 2
    assert "--shard is for garments" in capsys.readouterr().err


def test_bodies_and_published_garments_are_not_put_beside_parts(tmp_path: Path) -> None:
    part_of(tmp_path, 0, 2)
    with pytest.raises(ConfigError, match="made in parts: 1 of 2 parts are finished"):
        generate_people(tmp_path, 2)
    with pytest.raises(ConfigError, match="made in parts: 1 of 2 parts are finished"):
        convert(tmp_path / "published", tmp_path)
    assert [path.name for path in tmp_path.glob("*.tar")] == []


def test_an_unknown_engine_is_reported(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="engine='Ray'"):
        generate(tmp_path / "out", 2, config=CUFFED, engine="Ray")  # type: ignore[arg-type]
    assert not (tmp_path / "out").exists()


def test_a_damaged_part_is_made_again_though_a_stopped_merge_has_moved_others(
    tmp_path: Path, whole: dict[str, bytes]
) -> None:
    out = parts_in(tmp_path / "parts", 3)

    def stop(progress: Progress) -> None:
        if progress.made:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        merge(out, on_progress=stop)
    assert (out / "train-00000.tar").exists()
    shard = part_folder(out, 1, 3) / "train-00003.tar"
    os.truncate(shard, 5000)
    with pytest.raises(ShardError, match=r"delete it and run .*--shard 1/3"):
        merge(out)
    with pytest.raises(ConfigError, match="run gcd merge"):  # for the undamaged part 0
        part_of(out, 0, 3)
    shard.unlink()
    part_of(out, 1, 3)
    merge(out)
    assert contents(out) == whole
