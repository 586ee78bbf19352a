"""``gcd info``, ``verify``, ``index``, ``show``, ``publish`` and ``download``."""

import io
import re
import shlex
import shutil
import tarfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
from gcd_dataset.shards.contents import warn_of_others
from gcd_dataset.shards.unfinished import filling, unfinished

from gcd_dataset.cli import main
from gcd_dataset.shards import ShardWriter, read_index
from gcd_dataset.shards.layout import MEMBERS, Bytes
from tests.hub.conftest import no_long_waits  # noqa: F401 - a fixture for every test here
from tests.hub.server import Hub, running_hub
from tests.shards import people
from tests.shards.folders import fill

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
    share = read_index(data).table.size
    column = MEMBERS.index("verts.npy")
    assert f"verts {share[:, column].sum() / share.sum():6.1%}".split() in [
        line.split()[:2] for line in text.splitlines()
    ]


def test_info_names_the_stage_of_a_data_set_without_drapes(tmp_path: Path, capsys: Capture) -> None:
    assert main(["generate", str(tmp_path), "--count", "1", "--stage", "pattern", "--workers", "0", "--quiet"]) == 0
    assert main(["info", str(tmp_path)]) == 0
    text = said(capsys)
    assert "train: 1 samples in 1 shards" in text and "stage pattern, without drapes" in text
    assert "at rest" not in text


def test_other_files_are_named_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for name in (".git", "000001.tar", "notes.txt", "rejects.jsonl", "train-00000.tar.part", "x.csv", "y.csv"):
        (tmp_path / name).touch()
    warn_of_others(tmp_path)
    assert "holds other files (000001.tar, notes.txt, x.csv and 1 more)" in caplog.text
    (tmp_path / "manifest.json").touch()
    caplog.clear()
    warn_of_others(tmp_path)
    warn_of_others(tmp_path / "new")
    assert not caplog.text


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


def test_verify_finds_nothing_wrong(data: Path, capsys: Capture) -> None:
    assert main(["verify", str(data)]) == 0
    assert main(["verify", str(data), "--full"]) == 0
    assert said(capsys).count("no fault found") == 2


def test_verify_names_one_flipped_byte(data: Path, capsys: Capture) -> None:
    index, path = read_index(data), data / "train-00001.tar"
    content = bytearray(path.read_bytes())
    content[int(index.table.offset[5, MEMBERS.index("verts.npy")]) + 200] ^= 1
    path.write_bytes(content)
    assert main(["verify", str(data)]) == 0  # within a member: the headers are intact
    assert main(["verify", str(data), "--full"]) == 1
    text = said(capsys)
    assert "train-00001.tar: its hash differs from manifest.json" in text
    assert "sample gcd_000000005, member verts.npy: bytes differ" in text


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (lambda folder: (folder / "train-00001.tar").unlink(), "train-00001.tar: 0 of the"),
        (lambda folder: (folder / "train-00001.tar").write_bytes(b"short"), "train-00001.tar: 5 of the "),
        (lambda folder: (folder / "index-train.npz").unlink(), "index-train.npz: no such file: run gcd index"),
        (lambda folder: (folder / "index-train.npz").write_bytes(b"PK"), "index-train.npz: not an index"),
        (lambda folder: shutil.copy(folder / "train-00000.tar", folder / "test-00000.tar"), "test and train share 4"),
    ],
)  # fmt: skip
def test_verify_names_each_fault(data: Path, capsys: Capture, harm: object, message: str) -> None:
    harm(data)  # type: ignore[operator]
    assert main(["verify", str(data)]) == 1
    assert message in said(capsys)


def test_index_is_made_again(data: Path, capsys: Capture) -> None:
    before = (data / "index-train.npz").read_bytes()
    (data / "index-train.npz").unlink()
    assert main(["index", str(data)]) == 0
    assert (data / "index-train.npz").read_bytes() == before
    assert "train: 10 samples in 3 shards" in said(capsys)
    assert main(["index", str(data), "--split", "test"]) == 1
    assert main(["index", str(data / "nowhere")]) == 1


def test_info_lists_foreign_members_by_their_full_names(tmp_path: Path, capsys: Capture) -> None:
    with tarfile.open(tmp_path / "a.tar", "w") as archive:
        for name, size in {"s.seg.txt": 30, "s.seg.json": 10}.items():
            info = tarfile.TarInfo(name)
            info.size = size
            archive.addfile(info, io.BytesIO(b"1" * size))
    assert main(["info", str(tmp_path)]) == 0
    assert {("seg.txt", "75.0%"), ("seg.json", "25.0%")} <= {
        tuple(line.split()[:2]) for line in said(capsys).splitlines()
    }


def test_sets_of_bodies_are_served_too(tmp_path: Path, capsys: Capture) -> None:
    folder = people.fill(tmp_path / "people", range(6))
    (folder / "index-train.npz").unlink()
    for verb in ("index", "verify", "info"):
        assert main([verb, str(folder)]) == 0
    assert "no fault found" in (text := said(capsys))
    assert "straight" in text


@pytest.fixture
def hub() -> Iterator[Hub]:
    with running_hub() as server:
        yield server


def small(out: Path, count: int) -> list[str]:
    return ["generate", str(out), f"--count={count}", "--stage=pattern", "--quiet"]


def test_a_stopped_data_set_is_reported_as_unfinished(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    add, left = ShardWriter.add, iter(range(3))

    def stopping(self: ShardWriter, index: int, members: Mapping[str, Bytes]) -> None:
        if next(left, None) is None:
            raise KeyboardInterrupt
        add(self, index, members)

    out, publish = tmp_path / "data", ["publish", str(tmp_path / "data"), "me/garments", "--dry-run"]
    monkeypatch.setattr(ShardWriter, "add", stopping)
    assert main(small(out, 8)) == 130
    monkeypatch.undo()
    said(capsys)
    assert main(["info", str(out)]) == 0
    assert "  not whole: 3 of 8 samples: its run was stopped, or is still running: run the same command again" in said(
        capsys
    )
    assert main(["verify", str(out)]) == 1
    assert "split train is not whole: 3 of 8 samples" in said(capsys)
    assert main(publish) == 2
    assert "split train is not whole: 3 of 8 samples" in (message := capsys.readouterr().err)
    assert "publish it with --partial" in message
    assert not (out / "published").exists()
    assert main([*publish, "--partial"]) == 0
    (command,) = re.findall(r"the same command again: (gcd generate .*)", unfinished(out, "train") or "")
    assert main([*shlex.split(command)[1:], "--quiet"]) == 0
    said(capsys)
    assert main(["info", str(out)]) == 0
    assert "not whole" not in said(capsys)
    assert main(publish) == 0
    assert not list(out.glob(".unfinished*"))


def test_a_smaller_count_finishes_an_unfinished_data_set(tmp_path: Path) -> None:
    with pytest.raises(StopIteration), filling(tmp_path, 100):
        raise StopIteration
    assert main(small(tmp_path, 2)) == 0
    assert unfinished(tmp_path, "train") is None


def test_a_shard_that_was_being_written_is_not_whole(data: Path) -> None:
    assert unfinished(data, "train") is None
    (data / "train-00003.tar.part").touch()
    message = "10 samples in whole shards: its run was stopped, or is still running: run the same command again"
    assert unfinished(data, "train") == message
    assert unfinished(data, "test") is None


@pytest.mark.parametrize("note", [b"", b"[" * 100_000, b'{"count": "x"}', b"{}", b"[]", b"\xff"])
def test_a_damaged_mark_still_reports_an_unfinished_data_set(data: Path, note: bytes) -> None:
    (data / ".unfinished-train.json").write_bytes(note)
    assert (unfinished(data, "train") or "").startswith("10 samples in whole shards: its run was stopped")


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["download", "me/nothing"], 1, "me/nothing"),
        (["download", "."], 2, "a local folder"),
        (["download", "one two"], 2, "neither a URL nor a repository"),
        (["publish", "DATA", "nobody"], 2, "neither a URL nor a repository"),
        (["publish", "DATA", "me/garments", "--shares", "90,5"], 2, "give per cent"),
        (["publish", "nowhere", "me/garments"], 1, "nowhere: no such folder"),
        (["verify", "nowhere"], 1, "nowhere: no such folder"),
        (["verify", "me/garments"], 1, "me/garments: no such folder: give a folder of shards; for a repository"),
        (["verify", "https://example.org/a"], 2, "run gcd download https://example.org/a first"),
        (["verify", "hf://me/garments"], 2, "run gcd download hf://me/garments first"),
        (["show", "me/nothing", "--png", "a.png"], 1, "me/nothing"),
        (["show", "me/garments", "--png", "a.png", "--split", "half"], 1, "half"),
        (["show", "nowhere", "--png", "a.png"], 1, "nowhere: no such folder"),
        (["show", "sewn/nowhere.json", "--png", "a.png"], 1, "sewn/nowhere.json: no such file"),
        (["index", "https://example.org/a"], 2, "run gcd download https://example.org/a first"),
        (["export", "https://example.org/a", "--hdf5", "a.h5"], 2, "run gcd download https://example.org/a first"),
    ],
)
def test_errors_are_one_line(
    hub: Hub, data: Path, capsys: Capture, arguments: list[str], code: int, message: str
) -> None:
    hub.publish("me/garments", data)
    server = ["--endpoint", hub.endpoint] if arguments[0] in ("download", "publish", "show") else []
    assert main([str(data) if word == "DATA" else word for word in arguments] + server) == code
    error = capsys.readouterr().err.strip()
    assert message in error
    assert len(error.splitlines()) == 1
