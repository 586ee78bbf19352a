"""``gcd generate --stage body``, ``info``, ``check``, ``index``, ``show``, ``publish`` and ``download``."""

import os
import re
import shlex
import shutil
import signal
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gcd_dataset.cli import _parse, main
from gcd_dataset.generator.body import draw_shape
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.loaders import BodyDataset
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.options import given_options
from gcd_dataset.seeding import Stage, rng
from gcd_dataset.shards import encode_sample
from gcd_dataset.shards.store import FolderStore
from gcd_dataset.shards.writer import Draft
from tests.helpers import flip
from tests.hub import conftest
from tests.hub.server import Hub
from tests.shards import people
from tests.shards.folders import contents, fill
from tests.test_cli import FLAT

hub, no_long_waits = conftest.hub, conftest.no_long_waits  # fixtures

# Warnings inside ``huggingface_hub`` are not ours to fix.
pytestmark = pytest.mark.filterwarnings("ignore:Use 'content=:DeprecationWarning")

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return fill(tmp_path / "data", range(10))


def said(capsys: Capture) -> str:
    return capsys.readouterr().out


def test_info_counts_and_plots(data: Path, capsys: Capture) -> None:
    assert main(["info", str(data)]) == 0
    text = said(capsys)
    assert "train: 10 samples in 3 shards" in text
    assert "10 at rest (100.0%)" in text
    assert "panels: 2 to 2, median 2" in text
    sizes = {name: len(data) for name, data in encode_sample(fake_sample(0, 0)).items()}
    share = next(float(line.split()[1].rstrip("%")) for line in text.splitlines() if line.split()[:1] == ["verts"])
    assert share == pytest.approx(100 * sizes["verts.z"] / sum(sizes.values()), abs=3)


def test_info_names_the_stage_of_a_data_set_without_drapes(tmp_path: Path, capsys: Capture) -> None:
    assert main(["generate", str(tmp_path), "--count", "1", *FLAT]) == 0
    assert main(["info", str(tmp_path)]) == 0
    text = said(capsys)
    assert "train: 1 samples in 1 shards" in text and "stage pattern, without drapes" in text
    assert "at rest" not in text


@pytest.mark.parametrize("stage", ["body", "pattern"])
def test_generate_names_other_files_until_it_has_begun(
    stage: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "notes.txt").touch()
    command = ["generate", str(tmp_path), "--count", "1", "--stage", stage, "--workers", "0", "--quiet"]
    assert main([*command, "--log", str(tmp_path / "log.jsonl")]) == 0
    assert "holds other files (notes.txt)" in caplog.text
    caplog.clear()
    assert main(command) == 0
    assert "other files" not in caplog.text


def test_check_names_one_flipped_byte(data: Path, capsys: Capture) -> None:
    assert main(["check", str(data), "--bytes"]) == 0
    assert said(capsys).endswith("nothing harmful found\n")
    flip(data / "train-00001.tar", 600, after=b"gcd_000000005.verts.z\0")
    assert main(["check", str(data)]) == 0  # within a member: the headers are intact
    assert main(["check", str(data), "--bytes"]) == 1
    text = said(capsys)
    assert "train-00001.tar: its hash differs from manifest.json" in text
    assert "sample gcd_000000005, member verts.z: bytes differ" in text


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (lambda folder: (folder / "train-00001.tar").write_bytes(b"short"), "train-00001.tar: no tar header at byte 0"),
        (lambda folder: os.truncate(folder / "train-00001.tar", 6 * 512), "train-00001.tar: "),
        (lambda folder: (folder / "train-00001.tar").unlink(), "train-00001.tar: no such file, but manifest.json"),
        (lambda folder: (folder / "train.index").unlink(), "train.index: no such file: run gcd index"),
        (lambda folder: (folder / "manifest.json").unlink(), "manifest.json: no such file: run gcd index"),
        (lambda folder: (folder / "train.index").write_bytes(b"PK"), "train.index: not the index of these shards"),
        (lambda folder: shutil.copy(folder / "train-00000.tar", folder / "test-00000.tar"), "not listed in manifest"),
    ],
)  # fmt: skip
def test_check_names_each_fault(data: Path, capsys: Capture, harm: object, message: str) -> None:
    harm(data)  # type: ignore[operator]
    assert main(["check", str(data)]) == 1
    assert message in said(capsys)


def test_splits_that_share_designs_are_reported(data: Path, capsys: Capture) -> None:
    fill(data, [3], split="test")
    assert main(["check", str(data)]) == 1
    assert "test and train share 1" in said(capsys)


def test_sets_of_bodies_are_served_too(tmp_path: Path, capsys: Capture) -> None:
    folder = people.fill(tmp_path / "people", range(6))
    (folder / "train.index").unlink()
    for words in (["index"], ["check", "--strict"], ["info"]):
        assert main([*words, str(folder)]) == 0
    assert "nothing harmful found" in (text := said(capsys))
    assert "person" in text


def test_a_stopped_data_set_is_reported_as_unfinished(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    add, left = Draft.add, iter(range(3))

    def stopping(self: Draft, *arguments: Any, **options: Any) -> None:
        if next(left, None) is None:
            raise KeyboardInterrupt
        add(self, *arguments, **options)

    out, publish = tmp_path / "data", ["publish", str(tmp_path / "data"), "me/garments", "--dry-run"]
    monkeypatch.setattr(Draft, "add", stopping)
    assert main(["generate", str(out), "--count", "8", *FLAT]) == 130
    monkeypatch.undo()
    said(capsys)
    assert main(["info", str(out)]) == 0
    assert "  unfinished: 3 of 8 samples are made: gcd generate" in said(capsys)
    message = "3 of 8 samples are made"
    for verb, code in (("check", 1), ("index", 0)):
        assert main([verb, str(out)]) == code
        assert message in said(capsys)
    assert main(publish) == 2
    assert message in (error := capsys.readouterr().err)
    assert "--partial" in error
    assert not (out / "published").exists()
    assert main([*publish, "--partial"]) == 0
    (command,) = re.findall(r"(gcd generate .*) goes on", FolderStore(out).unfinished("train") or "")
    assert main([*shlex.split(command)[1:], "--quiet"]) == 0
    said(capsys)
    assert main(["info", str(out)]) == 0
    assert "unfinished" not in said(capsys)
    assert main(publish) == 0


PEOPLE = {"stage": "body", "bodies": "female", "mesh": "0" * 64}


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"maps": True, "views": 2, "poses": "walk"}, None),
        ({"stage": "mesh", "sizes": "women", "misfit": "-3:3", "arms": 5.0}, None),
        ({"stage": "pattern", "outfits": "everyday"}, None),
        (PEOPLE, None),
        ({}, "smoke-64"),
        ({}, "of-a-file"),
        ({"poses": "FILE"}, None),
    ],
)
def test_a_named_command_asks_for_the_same_set(options: dict[str, Any], named: str | None, tmp_path: Path) -> None:
    """Files are not part of a data set: where it was made with one, the command is not known."""
    (file := tmp_path / "poses.toml").write_text("[[poses]]\nforearm = [30, 0, 0]\n")
    given: dict[str, Any] = {name: str(file) if value == "FILE" else value for name, value in options.items()}
    recipe = PEOPLE if options is PEOPLE else recipe_of(MakeConfig(**given))
    store = FolderStore(fill(tmp_path / "set", range(2), seed=3, recipe=recipe, count=9))
    split = (manifest := store.manifest()).splits["train"]
    plan = replace(split.plan, named=None if named is None else (named, "0" * 64))
    (tmp_path / "set/manifest.json").write_bytes(
        replace(manifest, splits={"train": replace(split, plan=plan)}).to_bytes()
    )
    said = FolderStore(store.folder).unfinished("train") or ""
    if "FILE" in options.values() or named == "of-a-file":
        assert said == "2 of 9 samples are made: the same command goes on"
        return
    (command,) = re.findall(r"gcd (generate .*) goes on", said)
    asked = _parse(shlex.split(command))
    assert (Path(asked.out), asked.recipe) == (store.folder, named)
    if named is None:
        known = {name: value for name, value in recipe.items() if name not in ("design", "mesh")}
        assert (asked.count, asked.seed, given_options(asked, MakeConfig)) == (9, 3, known)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_while_a_verb_starts_ends_it_with_one_line(
    number: int, code: int, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """Also where a library raises an interrupt of its own, as Ray does."""

    def interrupted(**_: object) -> None:
        try:
            os.kill(os.getpid(), number)
            time.sleep(5)
        except KeyboardInterrupt:
            raise KeyboardInterrupt from None

    monkeypatch.setattr("logging.basicConfig", interrupted)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in a background process
    try:
        assert main(["info", "nowhere"]) == code
    finally:
        signal.signal(signal.SIGINT, before)
    assert capsys.readouterr().err == "gcd: stopped: finished files are kept: run it again\n"


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["download", "me/nothing"], 1, "me/nothing"),
        (["download", "one two"], 2, "neither a URL nor a repository"),
        (["show", "me/nothing", "--png", "a.png"], 1, "me/nothing"),
        (["show", "me/garments", "--png", "a.png", "--split", "half"], 1, "half"),
        (["index", "https://example.org/a"], 2, "cannot be written to: give a folder"),
        (["export", "https://example.org/a", "--hdf5", "a.h5"], 2, "run gcd download https://example.org/a first"),
    ],
)
def test_errors_are_one_line(
    hub: Hub, data: Path, capsys: Capture, arguments: list[str], code: int, message: str
) -> None:
    hub.publish("me/garments", data)
    server = ["--endpoint", hub.endpoint] if arguments[0] in ("download", "publish", "show") else []
    assert main(arguments + server) == code
    error = capsys.readouterr().err.strip()
    assert message in error
    assert len(error.splitlines()) == 1


BODIES = ["--stage", "body", "--quiet"]


@pytest.mark.parametrize(("stage", "things"), [("body", "bodies in two poses"), ("pattern", "garments")])
def test_a_stopped_run_resumes_to_the_same_bytes(stage: str, things: str, tmp_path: Path, capsys: Capture) -> None:
    out, at_once = tmp_path / "data", tmp_path / "at_once"
    options = ["--count", "3", "--seed", "3", "--workers", "0", "--stage", stage, "--quiet"]
    for folder, more in ((out, ["--job", "1/3"]), (out, []), (at_once, []), (at_once, [])):
        assert main(["generate", str(folder), *options, *more]) == 0
    assert re.findall(r": (.* of them made now)", said(capsys)) == [
        f"job 1/3: 1 {things}, 1 of them made now",
        *(f"3 {things}, {made} of them made now" for made in (2, 3, 0)),
    ]
    assert contents(out) == contents(at_once)


@pytest.mark.parametrize("group", ["female", "male", "pooled"])
def test_people_of_a_group(tmp_path: Path, capsys: Capture, group: str) -> None:
    assert main(["generate", str(tmp_path), "--count", "2", "--bodies", group, *BODIES]) == 0
    people = list(BodyDataset(tmp_path, fields=["name", "shape"]))
    assert [person["name"] for person in people] == [f"{group}:0:0", f"{group}:0:1"]
    drawn = draw_shape(rng(0, 1, Stage.BODY), group=group)
    assert people[1]["shape"].numpy() == pytest.approx(drawn.weights, rel=1e-6)
    assert main(["generate", str(tmp_path), "--count", "3", *BODIES]) == 2
    assert "bodies" in capsys.readouterr().err
