"""Published data sets of small garments, a server for every test, and how the tests read them."""

import functools
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import aiohttp  # noqa: F401 -- its import takes longer than the patience of these tests
import pytest

from gcd_dataset.hub import fetch
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.shards import ShardWriter, encode_sample
from gcd_dataset.shards.store import Store
from tests.hub.server import Hub, read_folder, running_hub


@pytest.fixture(autouse=True)
def no_long_waits(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Waits of milliseconds, and neither the user's token nor the user's cache."""
    for name, value in (("FIRST_WAIT", 0.001), ("DOUBLINGS", 0), ("PATIENCE", 0.8)):
        monkeypatch.setattr(fetch, name, value)
    monkeypatch.setattr("huggingface_hub.constants.HF_TOKEN_PATH", str(tmp_path / "no-token"))
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_DISABLE_XET", True)
    monkeypatch.setattr(Path, "home", lambda: tmp_path / "home")


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of ten samples in three shards, with pictures."""
    return write_set(tmp_path_factory.mktemp("published") / "set")


@pytest.fixture
def hub() -> Iterator[Hub]:
    with running_hub() as server:
        yield server


@pytest.fixture
def commit(hub: Hub, folder: Path) -> str:
    """Publish the data set as ``org/garments`` and below ``/files/garments``; the commit's hash."""
    hub.static |= {f"garments/{name}": data for name, data in read_folder(folder).items()}
    return hub.publish("org/garments", folder)


COUNT = 10
RECIPE = {"stage": "drape"}


def write_set(folder: Path, counts: Mapping[str, int] = {"train": COUNT}, *, views: bool = True, seed: int = 0) -> Path:
    """Write a data set of shards of 4 garments, as it is published: without notes. An existing one is replaced."""
    shutil.rmtree(folder, ignore_errors=True)
    recipe, numbers = RECIPE if views else {**RECIPE, "picture": 0}, iter(range(sum(counts.values())))
    options = {"seed": seed, "recipe": recipe, "count": sum(counts.values()), "shard_size": 4}
    for split, count in counts.items():
        with ShardWriter(folder, split=split, **options) as writer:  # type: ignore[arg-type]
            for number in [next(numbers) for _ in range(count)]:
                writer.add(number, _garment(seed, number, views))
    for path in (*folder.glob("*-?????.json"), folder / "rejects.jsonl"):
        path.unlink()
    return folder


@functools.cache
def _garment(seed: int, number: int, views: bool) -> Mapping[str, bytes]:
    made = fake_sample(seed, number)
    if not views:
        made = replace(
            made, front=None, back=None, provenance=replace(made.provenance, recipe={**RECIPE, "picture": 0})
        )
    return encode_sample(made)


def read(store: Store, number: int, *, views: bool = False) -> bytes:
    """The bytes of a sample of ``train`` in its tar, or in that of its pictures."""
    index = store.index("train")
    starts, ends = (index.views_start, index.views_end) if views else (index.start, index.end)
    shard = index.record.shards[index.shard[number]]
    return bytes(store.part("train", shard, int(starts[number]), int(ends[number]), views=views))


def ensure(store: Store, *, views: bool = False) -> None:
    """Bring all shards of ``train`` into the cache."""
    store.ensure("train", store.manifest().splits["train"].shards, views=views)
