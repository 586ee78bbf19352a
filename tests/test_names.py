"""No name from a file or a server leads to a path outside its folder."""

import re
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gcd_dataset.cli import main
from gcd_dataset.errors import GcdError, OutputError, ShardError
from gcd_dataset.exports.published import export_published
from gcd_dataset.files import LONGEST, plain_names, require_name, safe_name
from gcd_dataset.generator import fitting
from gcd_dataset.generator.fitting import Fitting, write_fitting
from gcd_dataset.generator.maker import make
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.hub.download import download
from gcd_dataset.hub.remote import Remote
from gcd_dataset.hub.source import Url
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.records import Sample
from gcd_dataset.release.write import release_draft
from gcd_dataset.shards import ShardReader, ShardWriter
from gcd_dataset.shards.index import index_name
from gcd_dataset.shards.manifest import read_manifest
from tests.helpers import as_draped, parts
from tests.hub import conftest
from tests.hub.server import Hub, read_folder
from tests.shards.folders import RECIPE, write_samples

hub, no_long_waits = conftest.hub, conftest.no_long_waits  # fixtures

HOSTILE = {
    "parent": "..",
    "this": ".",
    "absolute": "/victim",
    "through parents": "a/../../victim",
    "up": "../victim",
    "up two": "../../victim",
    "NUL": "vic\0tim",
    "newline": "vic\ntim",
    "long": "v" * 300,
    "long in UTF-8": "ü" * 100,
    "dash": "-rf",
    "hidden": ".garments",
    "empty": "",
    "leaders": "\u2024\u2024",
    "wide dots": "\uff0e\uff0e",
    "wide slash": "a\uff0fb",
    "half a pair": "\ud800",
    "back to front": "a\u202egnp.b",
}
hostile = pytest.mark.parametrize("name", HOSTILE.values(), ids=HOSTILE.keys())
FEW = ("through parents", "NUL", "hidden")  # where each name takes a data set or a server
few_hostile = pytest.mark.parametrize("name", [HOSTILE[name] for name in FEW], ids=FEW)


@pytest.fixture
def victims(tmp_path: Path) -> Iterator[Path]:
    """A working folder; nothing outside of it may change."""
    for folder in (tmp_path, tmp_path / "near"):
        folder.mkdir(exist_ok=True)
        for name in ("victim", "victim.npz", "index-.npz", "evil.obj"):
            (folder / name).write_bytes(b"a user's own")
    inner = tmp_path / "near" / "work"
    inner.mkdir()
    before = outside(tmp_path, inner)
    yield inner
    assert outside(tmp_path, inner) == before


def outside(folder: Path, inner: Path) -> dict[str, bytes | None]:
    """Path to content of everything in ``folder`` outside ``inner``, except the cache in ``home``."""
    return {
        str(path): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
        if not path.is_relative_to(inner) and not path.is_relative_to(folder / "home")
    }


@cache
def garment() -> Sample:
    """A generated garment; its box mesh stands for its drape."""
    return as_draped(make(3, 0, MakeConfig(stage="mesh", resolution=8.0, points=16)))


@pytest.fixture(scope="module")
def shards(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of one generated garment."""
    return write_samples(tmp_path_factory.mktemp("shards"), [garment()], seed=3)


@hostile
def test_a_hostile_name_is_refused_or_made_one_component(name: str) -> None:
    with pytest.raises(ShardError, match=r"manifest: split: .* cannot be a file's name: use letters") as caught:
        require_name(name, "manifest: split")
    assert str(caught.value).isprintable()
    safe = safe_name(name)
    assert require_name(safe, "here") == safe == safe_name(name) == safe_name(safe)
    assert len(safe.encode()) <= LONGEST


def test_harmless_names_stay_as_they_are() -> None:
    for name in ("train", "train-00000.tar", "rand_K3V9QX7T1B", "Ärmel links (2)", "a+b", "x" * LONGEST):
        assert require_name(name, "here") == safe_name(name) == name


def test_names_that_look_the_same_stay_different() -> None:
    assert len({safe_name(name) for name in [*HOSTILE.values(), "a/b", "a\\b", "a:b", "a_b"]}) == len(HOSTILE) + 4


@pytest.mark.parametrize("name", [None, 3, ["train"], {}])
def test_a_name_must_be_text(name: Any) -> None:
    with pytest.raises(ShardError, match="cannot be a file's name"):
        require_name(name, "here")


@few_hostile
def test_a_split_of_a_data_set(victims: Path, shards: Path, name: str) -> None:
    with pytest.raises(ShardError, match=r"split: .* cannot be a file's name"):
        index_name(name)
    with pytest.raises(GcdError):
        ShardWriter(victims, split=name, seed=0, recipe=RECIPE)
    with pytest.raises(GcdError):
        GarmentDataset(shards, split=name)
    assert main(["export", str(shards), "--hdf5", str(victims / "o.h5"), f"--split={name}"]) == 1


def manifest_with(shards: Path, name: str) -> bytes:
    """The manifest with one more split, of that name; its digest is right."""
    manifest = read_manifest(shards)
    assert manifest is not None
    record = manifest.splits["train"]
    return replace(manifest, splits={"train": record, name: replace(record, shards=())}).to_bytes()


@few_hostile
def test_a_manifest_of_a_server(
    hub: Hub, victims: Path, shards: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(victims)
    files = read_folder(shards) | {"manifest.json": manifest_with(shards, name)}
    hub.static = {f"evil/{path}": data for path, data in files.items()}
    url = f"{hub.endpoint}/files/evil"
    for out in ([], ["--out", "out"]):
        assert main(["download", url, "--quiet", *out]) == 1
    with pytest.raises(ShardError, match=r"manifest\.json: .*split"):
        download(Url(url), victims / "direct", Remote(cache_dir=victims / "cache"), splits=["train"])
    assert not list(victims.glob("*/*.tar"))


@few_hostile
def test_a_hash_that_a_server_gives_its_shard(hub: Hub, victims: Path, shards: Path, name: str) -> None:
    manifest = read_manifest(shards)
    assert manifest is not None
    record = manifest.splits["train"]
    evil = replace(record, shards=(replace(record.shards[0], sha256=name),))
    hub.static = {f"evil/{path}": data for path, data in read_folder(shards).items()}
    hub.static["evil/manifest.json"] = replace(manifest, splits={"train": evil}).to_bytes()
    with pytest.raises(ShardError, match="a hash is not 64 hexadecimal digits"):
        GarmentDataset(f"{hub.endpoint}/files/evil", cache_dir=victims / "cache", fields=["body"])


@pytest.mark.parametrize("revision", [HOSTILE[name] for name in ("through parents", "NUL", "half a pair")])
def test_a_revision(hub: Hub, victims: Path, shards: Path, revision: str) -> None:
    hub.publish("org/garments", shards)
    with pytest.raises(GcdError):
        GarmentDataset("org/garments", endpoint=hub.endpoint, cache_dir=victims / "cache", revision=revision)


@few_hostile
def test_the_folder_that_a_download_makes(
    hub: Hub, victims: Path, shards: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(victims)
    hub.static = {f"{name}/{path}": data for path, data in read_folder(shards).items()}
    assert main(["download", f"{hub.endpoint}/files/{name}", "--quiet"]) in (0, 1, 2)


def test_where_a_garment_came_from(victims: Path) -> None:
    source = ["GarmentCodeData_v2", "..", "default_body", "rand_ABCDEFGHIJ"]
    sample = replace(garment(), provenance=replace(garment().provenance, source="/".join(source)))
    write_samples(victims / "data", [sample], seed=3, recipe=recipe_of(MakeConfig(stage="mesh")))
    for _ in export_published({"train": ShardReader(victims / "data")}, victims / "out"):
        pass
    specs = list((victims / "out").rglob("*_specification.json"))
    assert len(specs) == 1
    assert len(specs[0].relative_to(victims / "out").parts) == 5
    assert specs[0].name.removesuffix("_specification.json") == specs[0].parent.name


def test_a_source_without_a_place_in_a_release_is_reported(victims: Path) -> None:
    sample = replace(garment(), provenance=replace(garment().provenance, source="nowhere"))
    write_samples(victims / "data", [sample], seed=3)
    with pytest.raises(ShardError, match=r"gcd_000000000: its meta\.json has source nowhere: give RELEASE/BATCH/"):
        list(export_published({"train": ShardReader(victims / "data")}, victims / "out"))


@hostile
def test_a_place_in_a_release(victims: Path, name: str) -> None:
    parts = Path(name).parts
    if all(safe_name(part) == part for part in parts):
        return
    refused = pytest.raises(ShardError, match=r"a garment's path: .* cannot be a file's name")
    with refused, release_draft(victims / "out", "some") as draft:
        draft.holds(Path("batch", "data", *parts))


def test_file_names_of_gcd_drape_are_safe(victims: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sample, name = garment(), HOSTILE["through parents"]
    shown = SimpleNamespace(lend_rgb=lambda: 3 * (np.zeros((8, 8, 3), np.uint8),))
    monkeypatch.setattr(fitting, "garment_scene", lambda *_: None)
    monkeypatch.setattr(fitting, "start_plain", lambda *_, **__: shown)
    monkeypatch.setattr(fitting, "draw_pattern", lambda _: np.zeros((8, 8, 3), np.uint8))
    made = Fitting(replace(sample.pattern, name=name), None, (), *parts(sample), {}, 0.0, 0.0)  # type: ignore[arg-type]
    write_fitting(made, victims / "out")
    files = [path for path in (victims / "out").iterdir() if path.is_file()]
    assert len(files) == len(list((victims / "out").rglob("*"))) == 7  # OBJ, MTL, PLY, four pictures


PIECES = ["piece_1", "piece_2", "前", "后", "", "👗", "A", "a", "á", "a_9", "a 9", "x" * 20, "x" * 21]


@pytest.mark.parametrize("seed", range(3))
def test_plain_names_are_ascii_and_different_in_any_order(seed: int) -> None:
    """Also where a name is the number that another one would get."""
    names = np.random.default_rng(seed).permutation(PIECES).tolist()
    plain = plain_names(names, longest=12)
    assert len({re.sub("[^A-Z0-9]", "_", name.upper()) for name in plain}) == len(PIECES)
    assert all(name.isascii() and 0 < len(name) <= 12 for name in plain)
    assert all(plain[names.index(name)] == name for name in ("piece_1", "piece_2"))


def test_a_link_in_the_place_of_a_draft_is_not_followed(hub: Hub, victims: Path, shards: Path) -> None:
    hub.static = {f"garments/{path}": data for path, data in read_folder(shards).items()}
    (victims / "down").mkdir()
    (victims / "down" / ".train-00000.tar.part").symlink_to(victims.parent / "victim")
    with pytest.raises(OutputError, match=r"train-00000\.tar\.part: cannot be written \(.*\): remove this link"):
        download(Url(f"{hub.endpoint}/files/garments"), victims / "down", Remote(cache_dir=victims / "cache"))
