"""Data sets generated into an object store, and read from it."""

import pickle
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from torch.utils.data import DataLoader

from gcd_dataset.cli import main
from gcd_dataset.errors import ConfigError, MissingError, OutputError, RefusedError, RemoteError, ShardError
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.hub import objects, site
from gcd_dataset.hub.download import download
from gcd_dataset.hub.source import Url, parse_source
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.shards import ShardReader
from gcd_dataset.verbs import Progress, generate
from tests.hub.store import Fault, Store, hashes, running_store
from tests.loaders.test_shards import assert_all_same
from tests.shards.test_writer import full_disk

CONFIG = MakeConfig(stage="pattern")
COUNT, SHARD = 6, 4


@pytest.fixture(scope="module")
def running() -> Iterator[Store]:
    with running_store() as store:
        yield store


@pytest.fixture
def s3(running: Store) -> Store:
    running.log.clear()
    running.faults.clear()
    return running


@pytest.fixture(autouse=True)
def small_shards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gcd_dataset.verbs.storing.SHARD_SIZE", SHARD)


def make(out: Path | str, count: int = COUNT, **options: Any) -> int:
    """Generate a data set; return the number of samples made in this run."""
    return generate(out, count, config=CONFIG, workers=0, **options).made


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same data set generated into a folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gcd_dataset.verbs.storing.SHARD_SIZE", SHARD)
        folder = tmp_path_factory.mktemp("here")
        make(folder)
    return folder


def files_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture
def published(s3: Store, here: Path, request: pytest.FixtureRequest) -> str:
    """URL of a copy of the data set in the store."""
    url = s3.put(f"s3://bucket/{request.node.name}/set", here)
    s3.log.clear()
    return url


class Stopped(Exception):  # noqa: N818 - an interruption, not an error
    """Raised to stop a run."""


def stopping(at: int) -> Any:
    """A progress callback that raises ``Stopped`` after ``at`` samples."""

    def report(progress: Progress) -> None:
        if progress.made == at:
            raise Stopped

    return report


# ------------------------------------------------------------------------------------------------------------- reading


def test_a_store_yields_the_items_of_its_folder(published: str, here: Path, tmp_path: Path) -> None:
    ds, expected = GarmentDataset(published, cache_dir=tmp_path), GarmentDataset(here)
    assert_all_same(ds, expected)
    assert ds.recipe(3) == {**expected.recipe(3), "source": f"{published}@{ds.revision}"}
    ds.verify(3)
    assert_all_same(GarmentDataset(published, streaming=True, cache_dir=tmp_path), expected)


def test_members_are_requested_by_range(s3: Store, published: str, here: Path, tmp_path: Path) -> None:
    ds = GarmentDataset(published, fields=["panels"], cache_dir=tmp_path)
    assert not s3.asked(r"\.tar")
    ds[1]
    _, _, span = s3.asked(r"\.tar")[0].partition("bytes=")
    first, last = map(int, span.split("-"))
    member = GarmentDataset(here)._parts[0].reader.index.table.size[1].tolist()
    assert last - first + 1 in member
    assert len(s3.asked(r"\.tar")) == 1


def test_cached_members_are_read_without_the_store(s3: Store, published: str, tmp_path: Path) -> None:
    items = list(GarmentDataset(published, cache_dir=tmp_path))
    s3.faults.append(Fault("."))
    assert_all_same(GarmentDataset(published, cache_dir=tmp_path), items)
    s3.log.clear()
    assert_all_same(GarmentDataset(published, cache_dir=tmp_path, download=False), items)
    assert not s3.log


def test_workers_read_from_the_store(published: str, here: Path, tmp_path: Path) -> None:
    ds, expected = (
        GarmentDataset(published, fields=["panels"], cache_dir=tmp_path),
        GarmentDataset(here, fields=["panels"]),
    )
    assert_all_same([ds[0]], [expected[0]])  # opens a connection in the parent
    loader = DataLoader(ds, batch_size=None, num_workers=1, multiprocessing_context="fork")
    assert_all_same(list(loader), expected)
    assert_all_same(pickle.loads(pickle.dumps(ds)), expected)


def test_a_busy_store_is_retried(s3: Store, published: str, here: Path, tmp_path: Path) -> None:
    s3.faults += [Fault(r"GET .*\.tar", 2, "InternalError", "500 Error"), Fault(r"GET .*\.tar", 2)]
    ds = GarmentDataset(published, fields=["panels"], cache_dir=tmp_path, patience=1.0)
    assert_all_same(ds, GarmentDataset(here, fields=["panels"]))


def test_changed_bytes_are_reported(s3: Store, published: str, here: Path, tmp_path: Path) -> None:
    content = bytearray((here / "train-00000.tar").read_bytes())
    place = int(GarmentDataset(here)._parts[0].reader.index.table.offset[0, 3])
    content[place] ^= 1
    s3.put(published, {"train-00000.tar": bytes(content)})
    with pytest.raises(RemoteError, match=r"gcd_000000000, member .*received bytes do not match the published"):
        GarmentDataset(published, cache_dir=tmp_path)[0]
    s3.put(published, {"train-00000.tar": bytes(content[:5000])})
    with pytest.raises(RemoteError, match=r"train-00000\.tar: .*(shorter|rejects the request)"):
        GarmentDataset(published, cache_dir=tmp_path)[3]


def test_an_object_over_the_limit_is_refused_unread(
    s3: Store, published: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(site, "LARGEST_MANIFEST", 100)
    with pytest.raises(RemoteError, match=r"manifest\.json: has \d+ bytes, over the limit of 100 "):
        GarmentDataset(published, cache_dir=tmp_path)
    assert not s3.asked("^GET")


def test_a_manifest_cannot_point_outside(s3: Store, published: str, here: Path, tmp_path: Path) -> None:
    evil = (here / "manifest.json").read_bytes().replace(b"train-00000.tar", b"../train-00000.tar")
    s3.put(published, {"manifest.json": evil})
    with pytest.raises(ShardError, match=r"cannot be a file's name"):
        GarmentDataset(published, cache_dir=tmp_path)


@pytest.mark.parametrize(
    ("fault", "error", "told"),
    [
        (Fault(".", code="AccessDenied"), RefusedError, "ask for the rights to read, write and list there"),
        (Fault(".", code="SlowDown", status="503 Slow Down"), RemoteError, "try again later, or with more patience"),
        (Fault("."), RemoteError, "try again later, or with more patience"),
    ],
)
def test_errors_of_a_failing_store_are_one_line(
    s3: Store, published: str, tmp_path: Path, fault: Fault, error: type[Exception], told: str
) -> None:
    s3.faults.append(fault)
    with pytest.raises(error, match=told) as caught:
        GarmentDataset(published, cache_dir=tmp_path, patience=0.0)
    assert "\n" not in str(caught.value)
    assert published in str(caught.value)


def test_a_missing_data_set_is_reported(s3: Store, tmp_path: Path) -> None:
    for url in ("s3://bucket/none", "s3://no-bucket/set"):
        with pytest.raises(MissingError, match=f"{url}/manifest.json: not found"):
            GarmentDataset(url, cache_dir=tmp_path)
    with pytest.raises(RemoteError, match="rejects the request"):
        GarmentDataset("s3://No_Bucket!/set", cache_dir=tmp_path)


def test_missing_credentials_are_reported(published: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.setattr(objects, "_store", objects._store.__wrapped__)
    with pytest.raises(RefusedError, match=r"no credentials .*: set AWS_ACCESS_KEY_ID and .* public bucket FSSPEC_S3="):
        GarmentDataset(published, cache_dir=tmp_path)
    with pytest.raises(RefusedError, match="no credentials"):
        make(published, spool=tmp_path)


@pytest.mark.parametrize(
    ("url", "package"), [("s3://bucket/set", r"pip install 'gcd-dataset\[s3\]'"), ("gs://bucket/set", "gcsfs")]
)
def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, url: str, package: str) -> None:
    monkeypatch.setattr(objects, "_store", objects._store.__wrapped__)
    monkeypatch.delitem(sys.modules["fsspec.registry"]._registry, "s3", raising=False)
    for name in ("s3fs", "gcsfs"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ConfigError, match=package):
        GarmentDataset(url, cache_dir=tmp_path)
    with pytest.raises(ConfigError, match=package):
        make(url, spool=tmp_path)


@pytest.mark.parametrize("url", ["nope://bucket/set", "s3://", "s3:///set", "simplecache::s3://bucket/set", "s3://a\n"])
def test_other_urls_are_refused(url: str) -> None:
    with pytest.raises(ConfigError, match="neither a URL nor a repository"):
        parse_source(url)


@pytest.mark.parametrize("options", [{"endpoint": "http://localhost"}, {"token": "secret"}, {"revision": "main"}])
def test_options_of_the_hub_are_refused(tmp_path: Path, options: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=f"{next(iter(options))}.* is for") as caught:
        GarmentDataset("s3://bucket/set", cache_dir=tmp_path, **options)
    assert "secret" not in str(caught.value)


def test_commands_accept_the_url(
    published: str, here: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["info", published]) == 0
    assert f"{COUNT} samples in 2 shards" in capsys.readouterr().out
    assert main(["show", published, "--index", "5", "--svg", "five.svg"]) == 0
    assert main(["download", published, "--out", "all", "--quiet"]) == 0
    expected = {name: content for name, content in files_of(here).items() if name != "rejects.jsonl"}
    assert {name: (tmp_path / "all" / name).read_bytes() for name in expected} == expected
    assert main(["verify", "all", "--full"]) == 0
    assert main(["verify", published]) == 2
    assert "run gcd download" in capsys.readouterr().err


# -------------------------------------------------------------------------------------------------------------- making


def test_objects_equal_the_files_of_a_folder(s3: Store, here: Path, tmp_path: Path) -> None:
    url = "s3://bucket/made"
    assert make(url, spool=tmp_path) == COUNT
    assert hashes(s3.objects(url)) == hashes(files_of(here))
    assert not list(tmp_path.iterdir())
    puts = [request.rpartition("/")[2] for request in s3.asked("^PUT .*/made/[^.]")]
    assert puts == ["train-00000.tar", "train-00001.tar", "index-train.npz", "rejects.jsonl", "manifest.json"]
    s3.log.clear()
    assert make(url, spool=tmp_path) == 0
    assert not s3.asked("^(PUT|DELETE|POST)")


def test_a_run_continues_from_store_and_spool(s3: Store, here: Path, tmp_path: Path) -> None:
    url = "s3://bucket/stopped"
    with pytest.raises(Stopped):
        make(url, spool=tmp_path, on_progress=stopping(5))
    assert set(s3.objects(url)) == {
        "train-00000.tar",
        ".unfinished/manifest.json",
        ".unfinished/00000/manifest.json",
        ".unfinished/00000/index-train.npz",
        ".unfinished/00000/rejects.jsonl",
    }
    with pytest.raises(MissingError, match="a data set becomes visible when its upload is complete"):
        GarmentDataset(url, cache_dir=tmp_path / "cache")
    assert make(url, spool=tmp_path) == 1
    assert hashes(s3.objects(url)) == hashes(files_of(here))


def test_a_run_continues_from_the_store_without_its_spool(s3: Store, here: Path, tmp_path: Path) -> None:
    url = "s3://bucket/elsewhere"
    with pytest.raises(Stopped):
        make(url, spool=tmp_path / "one", on_progress=stopping(5))
    assert make(url, spool=tmp_path / "other") == COUNT - SHARD
    assert hashes(s3.objects(url)) == hashes(files_of(here))


def test_removed_objects_are_written_again(s3: Store, here: Path, tmp_path: Path) -> None:
    url = "s3://bucket/gone"
    with pytest.raises(Stopped):
        make(url, spool=tmp_path, on_progress=stopping(5))
    s3.remove(f"{url}/train-00000.tar")
    assert make(url, spool=tmp_path / "other") == COUNT
    s3.put(url, {"train-00001.tar": b"other"})
    assert make(url, spool=tmp_path / "other") == COUNT - SHARD
    assert hashes(s3.objects(url)) == hashes(files_of(here))


def test_a_finished_data_set_is_extended(s3: Store, here: Path, tmp_path: Path) -> None:
    url = s3.put("s3://bucket/grows", here)
    assert make(url, COUNT + 5, spool=tmp_path) == 5
    make(tmp_path / "folder", COUNT + 5)
    assert hashes(s3.objects(url)) == hashes(files_of(tmp_path / "folder"))


KILLED = """
import os, signal, sys
import gcd_dataset.verbs.storing
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.verbs import generate
gcd_dataset.verbs.storing.SHARD_SIZE = {shard}
def report(progress):
    if progress.made == 5:
        os.kill(os.getpid(), signal.SIGKILL)
generate({url!r}, {count}, config=MakeConfig(stage="pattern"), workers=0, spool={spool!r}, on_progress=report)
"""


def test_a_killed_run_continues(s3: Store, here: Path, tmp_path: Path) -> None:
    url = "s3://bucket/killed"
    code = KILLED.format(shard=SHARD, url=url, count=COUNT, spool=str(tmp_path / "spool"))
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -signal.SIGKILL
    with pytest.raises(OutputError, match=r"another run \(process \d+ on .*remove .*/\.writing\.json and start"):
        make(url, spool=tmp_path / "other")
    assert make(url, spool=tmp_path / "spool") <= COUNT - 4
    assert hashes(s3.objects(url)) == hashes(files_of(here))


def test_a_second_writer_is_refused(s3: Store, here: Path, tmp_path: Path) -> None:
    url = "s3://bucket/writers"

    def second(progress: Progress) -> None:
        if progress.made == 1:
            for spool, told in (
                ("other", "another run .* is writing there: wait for it"),
                ("one", "another process"),
            ):
                with pytest.raises(OutputError, match=told):
                    make(url, spool=tmp_path / spool)

    make(url, spool=tmp_path / "one", on_progress=second)
    assert hashes(s3.objects(url)) == hashes(files_of(here))


def test_of_two_simultaneous_writers_one_gets_the_lease(
    s3: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = s3.put("s3://bucket/at-once", {".writing.json": b'{"run": "1", "host": "node7", "process": 12}'})
    monkeypatch.setattr("gcd_dataset.hub.uploading.require_free", lambda *_: None)  # the lease appears after this check
    with pytest.raises(OutputError, match=r"process 12 on node7"):
        make(url, spool=tmp_path)
    assert set(s3.objects(url)) == {".writing.json"}


def test_another_recipe_is_refused(s3: Store, here: Path, tmp_path: Path) -> None:
    url = s3.put("s3://bucket/recipe", here)
    with pytest.raises(ConfigError, match=rf"{url}/manifest\.json: made with seed=0, asked for seed=1"):
        make(url, spool=tmp_path, seed=1)
    begun = "s3://bucket/begun"
    with pytest.raises(Stopped):
        make(begun, spool=tmp_path, on_progress=stopping(1))
    with pytest.raises(ConfigError, match=r"made with seed=0, asked for seed=1"):
        make(begun, spool=tmp_path / "other", seed=1)


@pytest.mark.parametrize(
    ("name", "fault", "told"),
    [
        (
            "refusing",
            Fault(r"PUT .*\.tar", code="AccessDenied"),
            "refused .*: ask for the rights to read, write and list",
        ),
        (
            "cut-off",
            Fault(r"PUT .*\.tar"),
            "no answer .* with more patience .--patience, patience=.; received data are",
        ),
        ("no-index", Fault(r"PUT .*\d\.index|PUT .*index-train.npz", code="AccessDenied"), "refused"),
        ("no-manifest", Fault(r"PUT /bucket/no-manifest/manifest.json", code="AccessDenied"), "refused"),
    ],
)
def test_a_failing_store_costs_no_sample(
    s3: Store, here: Path, tmp_path: Path, name: str, fault: Fault, told: str
) -> None:
    url = f"s3://bucket/{name}"
    s3.faults.append(fault)
    with pytest.raises(RemoteError, match=told) as caught:
        make(url, spool=tmp_path)
    assert url in str(caught.value)
    assert "manifest.json" not in s3.objects(url)
    s3.faults.clear()
    made = make(url, spool=tmp_path)
    assert made < COUNT - 2
    assert hashes(s3.objects(url)) == hashes(files_of(here))


def test_a_store_without_deletion_is_filled(
    s3: Store, here: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    url = "s3://bucket/for-ever"
    s3.faults.append(Fault("^(DELETE|POST)", code="AccessDenied"))
    assert make(url, spool=tmp_path) == COUNT
    assert "only this machine can continue" in caplog.text
    assert make(url, COUNT + 1, spool=tmp_path) == 1
    assert len(GarmentDataset(url, cache_dir=tmp_path / "cache")) == COUNT + 1
    with pytest.raises(OutputError, match=r"remove s3://bucket/for-ever/\.writing\.json"):
        make(url, COUNT + 2, spool=tmp_path / "other")


def test_an_unreleased_lease_lets_this_machine_continue(s3: Store, here: Path, tmp_path: Path) -> None:
    url = "s3://bucket/gone-for-good"

    def cut(progress: Progress) -> None:
        if progress.made == 4:
            s3.faults.append(Fault("."))

    with pytest.raises(RemoteError, match="no answer"):
        make(url, spool=tmp_path, on_progress=cut)
    s3.faults.clear()
    assert make(url, spool=tmp_path) <= COUNT - 4
    assert hashes(s3.objects(url)) == hashes(files_of(here))


@pytest.mark.parametrize(
    ("url", "error", "told"),
    [
        ("s3://no-bucket/set", MissingError, "not found .*: check bucket and name"),
        ("http://localhost/set", ConfigError, "cannot be written to: give a folder, or a URL such as s3://"),
        ("nope://bucket/set", ConfigError, "cannot be written to"),
    ],
)
def test_an_unwritable_store_is_reported(
    s3: Store, tmp_path: Path, url: str, error: type[Exception], told: str
) -> None:
    with pytest.raises(error, match=told):
        make(url)


def test_options_that_need_a_folder_are_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["generate", "s3://bucket/people", "--count=1", "--stage=body"]) == 2
    assert "bodies are made in a folder" in capsys.readouterr().err
    assert main(["generate", "s3://bucket/named", "--recipe=smoke-64-draft"]) == 2
    assert "data sets of recipes are made in a folder" in capsys.readouterr().err
    assert main(["generate", "s3://bucket/parts", "--count=8", "--stage=pattern", "--shard=0/2"]) == 2
    assert "parts are made in a folder" in capsys.readouterr().err
    with pytest.raises(OutputError, match="URLs expect them as str"):
        make(Path("s3://bucket/set"))
    assert not list(tmp_path.iterdir())


def test_a_full_spool_costs_no_garment(s3: Store, here: Path, tmp_path: Path) -> None:
    url = "s3://bucket/full"
    with pytest.MonkeyPatch.context() as patch:
        full_disk(patch, room=(here / "train-00000.tar").stat().st_size)
        with pytest.raises(OutputError, match=r"train-00001.tar.part: cannot be written .*make room there"):
            make(url, spool=tmp_path)
    assert make(url, spool=tmp_path) < COUNT
    assert hashes(s3.objects(url)) == hashes(files_of(here))


def test_spool_and_patience_with_a_folder_are_errors(tmp_path: Path) -> None:
    for option in ({"spool": tmp_path}, {"patience": 3.0}):
        with pytest.raises(ConfigError, match=r"is for URLs, and .* is a folder"):
            make(tmp_path / "set", **option)
    make((tmp_path / "set").as_uri(), 1)
    assert len(GarmentDataset(tmp_path / "set")) == 1


def test_the_command_generates_and_reports(s3: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--count=2", "--stage=pattern", "--workers=0", "--quiet", f"--spool={tmp_path}"]
    assert main(["generate", "s3://bucket/command", *words]) == 0
    assert "s3://bucket/command: 2 garments, 2 of them made now" in capsys.readouterr().out
    assert len(GarmentDataset("s3://bucket/command", cache_dir=tmp_path / "cache")) == 2
    assert main(["generate", "s3://no-bucket/set", *words]) == 1
    told = capsys.readouterr().err
    assert told.startswith("gcd generate: s3://no-bucket/set")
    assert told.count("\n") == 1


def test_the_memory_file_system_is_a_store(here: Path, tmp_path: Path) -> None:
    import fsspec

    url, store = "memory://bucket/set", fsspec.filesystem("memory")
    with pytest.raises(Stopped):
        make(url, spool=tmp_path, on_progress=stopping(5))
    assert make(url, spool=tmp_path) == 1
    there = {name.rpartition("/")[2]: store.cat_file(name) for name in store.find("/bucket/set")}
    assert hashes(there) == hashes(files_of(here))
    assert_all_same(GarmentDataset(url, cache_dir=tmp_path / "cache"), GarmentDataset(here))
    note = download(Url(url), tmp_path / "down")
    assert note.source.startswith(url)
    assert len(ShardReader(tmp_path / "down", "train")) == COUNT
