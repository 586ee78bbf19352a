"""Publishing: division into splits, staging, card and upload."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import huggingface_hub
import numpy as np
import pytest
import yaml

from gcd_dataset.cli import main
from gcd_dataset.errors import ConfigError, RemoteError, ShardError
from gcd_dataset.generator.body import neutral_shape
from gcd_dataset.hub.download import download
from gcd_dataset.hub.partition import families, leaks, partition, traits_of
from gcd_dataset.hub.publish import Staged, _license, stage, upload
from gcd_dataset.hub.remote import Remote
from gcd_dataset.hub.source import Repo
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import BodyShape, Sample
from gcd_dataset.shards import ShardReader
from gcd_dataset.shards.layout import garments_layout
from gcd_dataset.shards.manifest import read_manifest
from tests.helpers import flip
from tests.hub.server import Fault, Hub, read_folder
from tests.shards.folders import fake_outfit, write_samples

# A deprecation within ``huggingface_hub``.
pytestmark = pytest.mark.filterwarnings("ignore:Use 'content=:DeprecationWarning")


def put(folder: Path, samples: Iterable[Sample], **options: Any) -> Path:
    return write_samples(folder, samples, recipe={"stage": "drape"}, shard_size=8, **options)


def fill(folder: Path, numbers: range, *, seed: int = 0) -> Path:
    return put(folder, (fake_sample(seed, number) for number in numbers))


def same(folder: Path, split: str, source: ShardReader) -> list[int]:
    """The numbers of the samples of a staged split, whose members equal those of ``source``."""
    reader = ShardReader(folder, split, verify="full")
    position_of = {source.number(position): position for position in range(len(source))}
    members = reader.layout.members
    for position in range(len(reader)):
        found = reader.read(position, members)
        expected = source.read(position_of[reader.number(position)], members)
        assert {name: bytes(data) for name, data in found.items()} == {n: bytes(d) for n, d in expected.items()}
    return [reader.number(position) for position in range(len(reader))]


def sample(index: int, *, design: int, body: int | None = None) -> Sample:
    """Garment ``index`` of a design on a body; ``None`` is the neutral body."""
    shape = neutral_shape() if body is None else BodyShape(np.full(8, float(body + 1)))
    made = fake_sample(0, index)
    named = replace(made.provenance, body_name="neutral" if body is None else f"random:0:{body}")
    return replace(made, design={"skirt": {"number": design}}, shape=shape, provenance=named)


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Forty designs, each on the neutral body and on a body of its own, as ``--bodies both`` makes them."""
    samples = (sample(i, design=i // 2, body=None if i % 2 == 0 else i) for i in range(80))
    return put(tmp_path_factory.mktemp("both"), samples)


SHARES = {"train": 0.6, "validation": 0.2, "test": 0.2}
ALL = {"train": 1.0, "validation": 0.0, "test": 0.0}


def test_no_design_is_in_two_splits(both: Path) -> None:
    parts = partition(ShardReader(both), SHARES)
    assert list(parts) == list(SHARES)
    assert sorted(position for part in parts.values() for position in part) == list(range(80))
    designs = {name: {position // 2 for position in part} for name, part in parts.items()}
    assert sum(map(len, designs.values())) == 40
    assert [len(parts[name]) for name in SHARES] == pytest.approx([48, 16, 16], abs=14)


def test_garments_that_share_a_body_or_a_pattern_stay_together(tmp_path: Path) -> None:
    worn = [(0, 0), (1, 0), (1, 1), (2, 2), (3, None), (4, None), (4, 3), (5, 3)]
    put(tmp_path / "a", [sample(i, design=design, body=body) for i, (design, body) in enumerate(worn)])
    assert families(traits_of(ShardReader(tmp_path / "a"))).tolist() == [0, 0, 0, 1, 2, 3, 3, 3]
    # Designs that differ in unused parameters only: a strapless bodice has no sleeves, whatever its design says.
    samples = [sample(i, design=i) for i in range(5)]
    samples[3] = replace(samples[3], pattern=replace(samples[1].pattern, name=samples[3].pattern.name))
    put(tmp_path / "b", [replace(made, box_mesh=None, drape=None) for made in samples])
    assert families(traits_of(ShardReader(tmp_path / "b"))).tolist() == [0, 1, 2, 1, 3]


def test_outfits_that_share_a_garment_stay_together(tmp_path: Path) -> None:
    """The second outfit's coat is worn alone in the fourth; the fifth has the design of the first's skirt."""
    outfits = [fake_outfit(index, 2) for index in range(3)]
    assert outfits[1].outfit is not None
    coat = outfits[1].outfit.garments[1]
    alone = replace(fake_sample(0, 3), pattern=coat.pattern, design=coat.design, box_mesh=None, drape=None)
    last = replace(fake_sample(0, 4), design=outfits[0].design)
    for name, samples in {"a": [*outfits, alone, last], "b": [alone, last], "c": outfits}.items():
        write_samples(tmp_path / name, samples, layout=garments_layout(garments=2))
    assert families(traits_of(ShardReader(tmp_path / "a"))).tolist() == [0, 1, 2, 1, 0]
    readers = {name: ShardReader(tmp_path / name) for name in ("b", "c")}
    assert leaks(readers) == ["b and c share 2 designs"]


def test_a_garment_keeps_its_split_when_the_data_set_grows(both: Path, tmp_path: Path) -> None:
    put(tmp_path, (sample(i, design=i // 2, body=None if i % 2 == 0 else i) for i in range(60)))
    before, after = partition(ShardReader(tmp_path), SHARES), partition(ShardReader(both), SHARES)
    for name, positions in before.items():
        assert positions == [position for position in after[name] if position < 60]


@pytest.fixture(scope="module")
def staged(both: Path, tmp_path_factory: pytest.TempPathFactory) -> Staged:
    folder = tmp_path_factory.mktemp("staged") / "up"
    return stage(both, "org/new-set", folder, shares=SHARES, license="CC-BY-4.0", endpoint="https://hub.example")


def test_staged_garments_equal_the_originals(both: Path, staged: Staged) -> None:
    source = ShardReader(both)
    seen = [number for name in SHARES for number in same(staged.folder, name, source)]
    assert sorted(seen) == list(range(80))
    assert not leaks({name: ShardReader(staged.folder, name) for name in SHARES})
    listed = {name for name in read_folder(staged.folder) if not name.endswith(".json")}
    assert staged.files.keys() == listed | {"croissant.json", "manifest.json"}
    assert all(staged.manifest.missing(name) is None for name in SHARES)
    counted = [split.rejects for split in staged.manifest.splits.values()]
    whole = source.record.rejects
    assert {rule: sum(split.get(rule, 0) for split in counted) for rule in whole} == dict(whole)


def test_licenses_are_those_of_the_hub(both: Path, tmp_path: Path) -> None:
    assert [_license(name) for name in ("ODbL-1.0", "GPL-3.0-only", "other")] == ["odbl", "gpl-3.0", "other"]
    for name, told in {"foo": "unknown to the Hub", "cc-by-4": "mean cc-by-4.0", "MIT-0": "or other"}.items():
        with pytest.raises(ConfigError, match=told):
            stage(both, "org/set", tmp_path / "up", license=name)
    assert not (tmp_path / "up").exists()


def test_the_library_of_the_hub_downloads_every_file(hub: Hub, commit: str, folder: Path, tmp_path: Path) -> None:
    found = huggingface_hub.snapshot_download(
        "org/garments", repo_type="dataset", endpoint=hub.endpoint, cache_dir=tmp_path
    )
    assert read_folder(Path(found)) == read_folder(folder)


def test_the_card_declares_tars_and_pictures(staged: Staged) -> None:
    text = (staged.folder / "README.md").read_text()
    facts = yaml.safe_load(text.split("---")[1])
    assert (facts["license"], facts["size_categories"]) == ("cc-by-4.0", ["n<1K"])
    configs = {config["config_name"]: config["data_files"] for config in facts["configs"]}
    assert list(configs) == ["default", "views"]
    for name, is_views in (("default", False), ("views", True)):
        assert [entry["split"] for entry in configs[name]] == list(SHARES)
        for entry in configs[name]:
            shards = staged.manifest.splits[entry["split"]].shards
            found = sorted(path.relative_to(staged.folder).as_posix() for path in staged.folder.glob(entry["path"]))
            assert found == [shard.name(entry["split"], views=is_views) for shard in shards]
    assert yaml.safe_load(huggingface_hub.DatasetCard(text).data.to_yaml()) == facts
    assert "80 garments" in text and "at most 0.001 cm" in text
    assert 'GarmentDataset("org/new-set"' in text


def test_only_changed_shards_are_staged_again(tmp_path: Path) -> None:
    data = fill(tmp_path / "data", range(20))
    first = stage(data, "org/new", tmp_path / "up")
    before = {path: (tmp_path / "up" / path).stat().st_ino for path in first.files}
    assert stage(data, "org/new", tmp_path / "up").manifest == first.manifest
    assert before == {path: (tmp_path / "up" / path).stat().st_ino for path in before}
    other = fill(tmp_path / "other", range(6), seed=1)
    stage(other, "org/new", tmp_path / "up", shares=ALL)
    assert same(tmp_path / "up", "train", ShardReader(other)) == list(range(6))
    assert not list((tmp_path / "up").glob("*test*.tar"))


def test_a_damaged_copy_is_staged_again_and_a_damaged_original_refused(tmp_path: Path) -> None:
    data = fill(tmp_path / "data", range(4))
    stage(data, "org/new", tmp_path / "up", shares=ALL)
    for folder in (tmp_path / "up", data):
        flip(next(folder.glob("train-*.tar")), ShardReader(data).index.end[0] - 3000)
        if folder != data:
            stage(data, "org/new", tmp_path / "up", shares=ALL)
            assert same(tmp_path / "up", "train", ShardReader(data)) == list(range(4))
    with pytest.raises(ShardError, match="gcd_000000000"):
        stage(data, "org/new", tmp_path / "up", shares=ALL)


def test_staging_overwrites_no_data_set(tmp_path: Path) -> None:
    data, other = fill(tmp_path / "data", range(20)), fill(tmp_path / "other", range(3))
    for folder in (data, other):
        before = read_folder(folder)
        with pytest.raises(ConfigError, match=r"holds .*, not files to publish: choose another folder"):
            stage(data, "org/new", folder)
        assert read_folder(folder) == before


def test_existing_splits_are_kept(tmp_path: Path) -> None:
    data = put(tmp_path / "data", (sample(i, design=i) for i in range(5)), count=9)
    with pytest.raises(ConfigError, match=r"not whole: 5 of 9 samples are made: .*, or publish it with --partial"):
        stage(data, "org/new", tmp_path / "up")
    put(data, (sample(i, design=i) for i in range(50, 54)), split="val", count=9)
    up = stage(data, "org/new", tmp_path / "up")
    assert up.manifest.counts == {"train": 5, "validation": 4}
    assert (up.folder / "train-00000.tar").read_bytes() == (data / "train-00000.tar").read_bytes()
    original, copy = data / "views" / "val-00000.tar", up.folder / "views" / "validation-00000.tar"
    content = original.read_bytes()
    copy.write_bytes(content[:-1] + b"x")
    stage(data, "org/new", up.folder)
    assert copy.read_bytes() == content
    original.write_bytes(content[:-1] + b"x")
    with pytest.raises(ShardError, match=r"views/val-00000\.tar: its hash differs from manifest\.json"):
        stage(data, "org/new", tmp_path / "other")
    original.write_bytes(content)
    put(data, [sample(60, design=3)], split="test", count=9)
    with pytest.raises(ConfigError, match="test and train share 1 design: publish it as one split"):
        stage(data, "org/new", tmp_path / "up")


def test_empty_splits_are_reported(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    put(tmp_path / "one", (sample(i, design=i, body=7) for i in range(4)))
    stage(tmp_path / "one", "org/new", tmp_path / "all", shares=ALL)
    assert not caplog.text
    assert list(stage(tmp_path / "one", "org/new", tmp_path / "up").manifest.splits) == ["train"]
    assert "no garments for validation and test: garments that share a design or a body stay in one" in caplog.text


def published(staged: Staged) -> dict[str, bytes]:
    return {name: (staged.folder / name).read_bytes() for name in staged.files}


def test_an_upload_is_downloaded_unchanged_and_replaces_stale_shards(hub: Hub, staged: Staged, tmp_path: Path) -> None:
    stale = ("train-00099.tar", "views/train-00099.tar", "old.index")
    hub.publish("org/new-set", dict.fromkeys([*stale, "notes/a.tar", "a.tar"], b"old"))
    hub.faults = [Fault("/put/", method="PUT", status=500, times=1)]  # repeated
    commit = upload(staged, "org/new-set", endpoint=hub.endpoint, token=hub.token)
    kept = {"notes/a.tar": b"old", "a.tar": b"old"}
    assert hub.repos["org/new-set"].commits[-1] == (commit, published(staged) | kept)
    download(Repo("org/new-set"), tmp_path / "data", Remote(endpoint=hub.endpoint, cache_dir=tmp_path / "ours"))
    assert read_manifest(tmp_path / "data") == staged.manifest
    assert len(same(tmp_path / "data", "test", ShardReader(staged.folder, "test"))) == staged.manifest.counts["test"]


def test_a_reader_sees_either_the_old_or_the_new_version(hub: Hub, staged: Staged, tmp_path: Path) -> None:
    before = read_folder(fill(tmp_path / "before", range(9)))
    hub.publish("org/new-set", before)
    hub.faults = [Fault("/put/", method="PUT", status=403, times=99)]
    with pytest.raises(RemoteError, match="cannot be published"):
        upload(staged, "org/new-set", endpoint=hub.endpoint, token=hub.token)
    hub.faults = []
    upload(staged, "org/new-set", endpoint=hub.endpoint, token=hub.token)
    for _, files in hub.repos["org/new-set"].commits[:-1]:  # tars are added, and none of the old files is changed
        assert {name: files[name] for name in before} == before
    assert hub.repos["org/new-set"].commits[-1][1].items() >= published(staged).items()


def test_errors_of_the_hub_are_reported(hub: Hub, staged: Staged, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RemoteError, match=r"org/new-set: cannot be published .*hf auth login"):
        upload(staged, "org/new-set", endpoint=hub.endpoint, token="hf_wrong")
    hub.stop()  # the system refuses a new connection, and resets one that is still open
    with pytest.raises(RemoteError, match=r"org/new-set: cannot be published .*(refused|reset).*HF_ENDPOINT"):
        upload(staged, "org/new-set", endpoint=hub.endpoint, token=hub.token)
    monkeypatch.setattr("huggingface_hub.__version__", "0.36.2")
    with pytest.raises(ConfigError, match=r"huggingface_hub 0\.36\.2 publishes to HF_ENDPOINT only: set it"):
        upload(staged, "org/new-set", endpoint=hub.endpoint, token=hub.token)


def test_publish_and_download(
    hub: Hub, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    data = fill(tmp_path / "data", range(10))
    monkeypatch.setenv("HF_TOKEN", hub.token)
    monkeypatch.chdir(tmp_path)
    before, here = read_folder(data), ["--endpoint", hub.endpoint]
    assert main(["publish", str(data), "me/garments", "--dry-run", *here]) == 0
    assert "would be uploaded to me/garments; nothing was sent" in capsys.readouterr().out
    assert not hub.log and (data / "published" / "README.md").exists()
    assert main(["publish", str(data), "me/garments", *here]) == 0
    commit = hub.repos["me/garments"].commits[-1][0]
    assert f"me/garments@{commit}" in capsys.readouterr().out
    assert {name: data for name, data in read_folder(data).items() if not name.startswith("published/")} == before

    assert main(["download", "me/garments", "--quiet", *here]) == 0
    assert f"train of hf://datasets/me/garments@{commit}: " in capsys.readouterr().out
    whole = [GarmentDataset("garments", path.name.removesuffix(".index")) for path in Path("garments").glob("*.index")]
    assert sum(map(len, whole)) == 10 and "front" in whole[0].fields
    assert main(["check", "garments", "--bytes"]) == 0
    some = ["download", "me/garments", "--split", "train", "--no-views", "--quiet", "--out", "some", *here]
    assert main(some) == 0
    assert main(["check", "some", "--bytes"]) == 0
    assert not {"front", "back"} & set(GarmentDataset("some").fields)
    capsys.readouterr()
    assert main(["info", "me/garments", *here]) == 0
    assert f"hf://datasets/me/garments@{commit}" in capsys.readouterr().out
