"""Data sets beyond the quick tests: an S3 store by moto; types that ``datasets`` infers; whole programs."""

import contextlib
import functools
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import datasets
import fsspec
import numpy as np
import pytest

from gcd_dataset.errors import MissingError, RefusedError, RemoteError
from gcd_dataset.hub import fetch
from gcd_dataset.hub.download import download
from gcd_dataset.hub.remote import Remote, RemoteStore
from gcd_dataset.hub.source import Url
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.making.recipes import LOCK
from gcd_dataset.records import Grade, NamedFabric, Sample
from gcd_dataset.shards import encode_sample
from gcd_dataset.shards.access import locked
from gcd_dataset.shards.sections import unpack
from gcd_dataset.shards.store import DOWNLOAD_FILE, FolderStore
from gcd_dataset.spec import spec_from_pattern
from gcd_dataset.tensors import encode_pattern
from tests.hub import conftest
from tests.hub.conftest import ensure, read
from tests.hub.server import Fault, Hub, Server, read_folder
from tests.making import conftest as recipes
from tests.shards.folders import patterns, write_shard, write_tar

folder, no_long_waits, hub, commit = conftest.folder, conftest.no_long_waits, conftest.hub, conftest.commit
toml = recipes.toml
KEYS = {"AWS_ACCESS_KEY_ID": "key", "AWS_SECRET_ACCESS_KEY": "secret", "AWS_DEFAULT_REGION": "us-east-1"}


class Store(Server):
    """An S3 store with the bucket ``bucket``."""

    def application(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        return _moto()(environ, start_response)


def s3_fault(pattern: str, code: str, status: int, times: int = 999) -> Fault:
    """A fault with an error code of S3."""
    body = f"<?xml version='1.0'?><Error><Code>{code}</Code><Message>{code} by this test</Message></Error>"
    return Fault(pattern, times, status=status, body=body.encode(), headers={"Content-Type": "application/xml"})


@contextlib.contextmanager
def running_store() -> Iterator[Store]:
    """A store; within the block, environment variables point to it."""
    with Store() as store, pytest.MonkeyPatch.context() as patch:
        for name, value in {**KEYS, "AWS_ENDPOINT_URL": store.endpoint, "AWS_EC2_METADATA_DISABLED": "true"}.items():
            patch.setenv(name, value)
        for name in ("AWS_CONFIG_FILE", "AWS_SHARED_CREDENTIALS_FILE"):
            patch.setenv(name, "/nonexistent")
        with contextlib.suppress(FileExistsError):
            fsspec.filesystem("s3").mkdir("bucket")
        yield store


@functools.cache
def _moto() -> Any:
    from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app

    return DomainDispatcherApplication(create_backend_app)


@pytest.fixture(scope="module")
def running() -> Iterator[Store]:
    with running_store() as store:
        yield store


@pytest.fixture
def s3(running: Store) -> Store:
    running.log.clear()
    running.faults.clear()
    return running


def put(url: str, files: Mapping[str, bytes]) -> None:
    """Store objects below a URL."""
    store, path = fsspec.core.url_to_fs(url)
    for name, content in files.items():
        store.pipe_file(f"{path}/{name}", content)


@pytest.fixture
def published(s3: Store, folder: Path, request: pytest.FixtureRequest) -> str:
    """URL of a copy of the data set in the store."""
    url = f"s3://bucket/{request.node.name}/set"
    put(url, read_folder(folder))
    s3.log.clear()
    return url


def opened(url: str, tmp_path: Path, **options: float | bool) -> RemoteStore:
    return RemoteStore(Url(url), Remote(cache_dir=tmp_path / "cache", **options))  # type: ignore[arg-type]


def test_a_store_is_read_by_ranges_and_whole_shards(s3: Store, published: str, folder: Path, tmp_path: Path) -> None:
    store = opened(published, tmp_path)
    assert read(store, 7) == read(FolderStore(folder), 7)
    assert [request.method for request in s3.log] == ["GET", "GET", "GET"]
    ensure(store)
    ensure(store, views=True)
    assert len(s3.asked(r"\.tar")) == 1 + 6
    s3.faults.append(Fault(".", 999, drop=True))
    assert read(opened(published, tmp_path, allowed=False), 9, views=True) == read(FolderStore(folder), 9, views=True)
    s3.faults.clear()
    download(Url(published), tmp_path / "data", Remote(cache_dir=tmp_path / "cache"))
    there = read_folder(tmp_path / "data")
    assert {name: data for name, data in there.items() if name != DOWNLOAD_FILE} == read_folder(folder)


def test_a_busy_store_is_retried(s3: Store, published: str, folder: Path, tmp_path: Path) -> None:
    s3.faults += [s3_fault(r"\.tar", "InternalError", 500, 2), Fault(r"\.tar", 2, drop=True)]
    assert read(opened(published, tmp_path, patience=20.0), 3) == read(FolderStore(folder), 3)


def test_changed_or_long_objects_are_refused(published: str, folder: Path, tmp_path: Path) -> None:
    content = (folder / "train-00000.tar").read_bytes()
    put(published, {"train-00000.tar": bytes([content[0] ^ 1]) + content[1:]})
    with pytest.raises(RemoteError, match=r"train-00000\.tar: received bytes do not match the published hash"):
        ensure(opened(published, tmp_path))
    put(published, {"train-00000.tar": content[:5000]})
    with pytest.raises(RemoteError, match=r"train-00000\.tar: (shorter|the store rejects the request)"):
        read(opened(published, tmp_path), 3)
    with pytest.raises(RemoteError, match=r"train-00000\.tar: has more than 100 bytes, over the limit of 100 "):
        fetch.Files(published).read("train-00000.tar", limit=100)


@pytest.mark.parametrize(
    ("fault", "error", "told"),
    [
        (s3_fault(".", "AccessDenied", 403), RefusedError, "ask for the rights to read and list there"),
        (s3_fault(".", "SlowDown", 503), RemoteError, "try again later, or with more patience"),
        (Fault(".", 999, drop=True), RemoteError, "try again later, or with more patience"),
    ],
)
def test_errors_of_a_failing_store_are_one_line(
    s3: Store, published: str, tmp_path: Path, fault: Fault, error: type[Exception], told: str
) -> None:
    s3.faults.append(fault)
    with pytest.raises(error, match=told) as caught:
        opened(published, tmp_path, patience=0.0)
    assert "\n" not in str(caught.value) and published in str(caught.value)


def test_missing_data_sets_and_credentials_are_reported(
    s3: Store, published: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for url in ("s3://bucket/none", "s3://no-bucket/set"):
        with pytest.raises(MissingError, match=f"{url}/manifest.json: not found"):
            opened(url, tmp_path)
    with pytest.raises(RemoteError, match="rejects the request"):
        opened("s3://No_Bucket!/set", tmp_path)
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.setattr(fetch, "_store", fetch._store.__wrapped__)
    with pytest.raises(RefusedError, match=r"no credentials .* set AWS_ACCESS_KEY_ID and .* public bucket FSSPEC_S3="):
        opened(published, tmp_path)


def barest_first() -> list[Sample]:
    """Real garments: the first five with as many missing values as possible, the others with all values."""
    bare = sorted(patterns(16), key=lambda sample: len(sample.pattern.panels))
    rich = [
        replace(
            sample,
            provenance=replace(
                sample.provenance,
                attempts=3,
                rejects=("self_crossing: sleeve", "drape: not_settled"),
                turned_down=(),
                redraws={"too_long": 2, "narrow": 1},
                recipe={**sample.provenance.recipe, "design": {"meta": {"bottom": ["Pants", None, 1.5]}}},
                source="GarmentCodeData_v2/garments_5000_0/default_body/rand_0",
            ),
            measurements=replace(sample.measurements, bust=np.nan),
            grade=Grade.CLEAN,
            fabric=NamedFabric("denim", {"density": 0.4, "tensile": [90.0, 80.0, 30.0]}),
            gathers=tuple(1.5 for _ in sample.pattern.seams),
            tags=("dress", "long"),
        )
        for sample in bare[8:]
    ]
    return [replace(sample, gathers=(), tags=()) for sample in bare[:5]] + rich


@pytest.mark.parametrize("streaming", [False, True])
def test_datasets_reads_real_garments_of_every_kind(tmp_path: Path, streaming: bool) -> None:
    """``datasets`` infers types from the first five samples."""
    samples = barest_first()
    tar = write_tar(tmp_path / "train-00000.tar", {sample.key: encode_sample(sample) for sample in samples})
    options: Any = {"data_files": {"train": str(tar)}, "split": "train", "cache_dir": str(tmp_path / "cache")}
    rows: list[Any] = list(datasets.load_dataset("webdataset", streaming=streaming, **options))
    assert [row["__key__"] for row in rows] == [sample.key for sample in samples]
    for row, sample in zip(rows, samples, strict=True):
        assert isinstance(row["spec.txt"], str)
        assert json.loads(row["spec.txt"]) == json.loads(json.dumps(spec_from_pattern(sample.pattern)))
        assert json.loads(row["design.txt"]) == dict(sample.design)
        assert row["meta.json"]["index"] == sample.provenance.index
        assert json.loads(row["meta.json"]["recipe"]) == dict(sample.provenance.recipe)
        rejects = [f"{entry['rule']}: {entry['reason']}" for entry in row["meta.json"]["rejects"] if entry["rule"]]
        assert rejects == list(sample.provenance.rejects)
        assert row["measures.json"]["waist"] == sample.measurements.to_file_values()["waist"]
        assert np.array_equal(unpack(row["pattern.z"])["panels"], encode_pattern(sample.pattern).panels)
    assert rows[-1]["meta.json"]["grade"] == "clean"
    assert rows[-1]["meta.json"]["redraws"] == [{"rule": "too_long", "count": 2}, {"rule": "narrow", "count": 1}]
    assert (rows[-1]["measures.json"]["bust"], rows[0]["meta.json"]["tags"]) == (-1.0, [""])


def test_a_program_exits_without_warnings(hub: Hub, commit: str, tmp_path: Path) -> None:
    program = f"""
import json
from gcd_dataset.hub.remote import Remote, RemoteStore
from gcd_dataset.hub.source import Url
store = RemoteStore(Url("{hub.endpoint}/files/garments"), Remote(cache_dir={str(tmp_path)!r}))
shard = store.index("train").record.shards[0]
store.part("train", shard, 0, 1000)
json.kept = store  # freed after the modules that are imported later
"""
    command = [sys.executable, "-W", "error", "-c", program]
    done = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True, check=True)
    assert done.stderr == ""


SCRIPT = """
import sys
import gcd_dataset.making.garments as garments
garments.STARTUP = 0.1  # s: start workers for few samples, too
from gcd_dataset.loaders import GarmentDataset
print(len(GarmentDataset("recipe:" + sys.argv[1], "test", root=sys.argv[2], fields=["panels"])), flush=True)
"""


def test_programs_wait_for_each_other_and_need_no_guard(toml: Path, tmp_path: Path) -> None:
    """Two programs request the data set at the same time; its workers do not import the programs again."""
    program, folder = tmp_path / "train.py", tmp_path / "tiny"
    program.write_text(SCRIPT)
    folder.mkdir()
    command = [sys.executable, str(program), str(toml), str(tmp_path)]
    with locked(folder / LOCK, "making tiny"):
        both = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(2)]
        for process in both:
            assert process.stderr is not None
            assert "another process is making tiny there: waiting for it" in process.stderr.readline()
    ended = [process.communicate(timeout=120) for process in both]
    assert [out for out, _ in ended] == ["6\n", "6\n"], ended
    assert sum(": making " in err for _, err in ended) == 1


def test_the_examples_of_the_documentation_run(tmp_path: Path) -> None:
    def run(code: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-c", code], cwd=tmp_path, env=os.environ, capture_output=True, text=True, check=False
        )

    code = "import sys, gcd_dataset; gcd_dataset.decode; sys.exit(any(n in sys.modules for n in ('torch', 'warp')))"
    assert run(code).returncode == 0
    page = (Path(__file__).parents[2] / "docs" / "format.md").read_text()
    for number in range(20):
        write_shard(tmp_path / "garments", [fake_sample(0, number)], number)
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    assert len(blocks) == 2
    for block in blocks:
        done = run(block)
        assert done.stdout.count("gcd_0000000") == 20, done.stderr
