"""``gcd_dataset.decode`` serves webdataset and Hugging Face ``datasets`` with equal arrays."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import webdataset as wds

import gcd_dataset
from gcd_dataset.errors import ShardError
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import View
from gcd_dataset.shards import decode_fields, encode_sample
from tests.shards.people import fake_person
from tests.shards.tars import fake_shard, write_shard, write_tar

# webdataset closes no tar.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")

COUNT = 3
ARRAYS = {
    "panels", "edges", "stitches", "body", "faces", "uv", "panel_id", "labels", "seams", "corners", "uv_vertex", "box",
    "verts", "points",
}  # fmt: skip


@pytest.fixture(scope="module")
def tars(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A shard, and the tar of its pictures."""
    return fake_shard(tmp_path_factory.mktemp("tars"), COUNT)


def true_arrays(index: int) -> dict[str, np.ndarray]:
    return decode_fields(encode_sample(fake_sample(0, index)), ARRAYS)


def assert_arrays(found: Mapping[str, Any], index: int) -> None:
    for name, array in true_arrays(index).items():
        assert np.array_equal(found[name], array), name


def test_webdataset_decodes_each_member(tars: tuple[Path, Path]) -> None:
    samples = list(wds.WebDataset(str(tars[0]), shardshuffle=False).decode(gcd_dataset.decode))
    assert [sample["__key__"] for sample in samples] == [f"gcd_{index:09d}" for index in range(COUNT)]
    for index, sample in enumerate(samples):
        found = {name: array for member in sample if member.endswith(".z") for name, array in sample[member].items()}
        assert found.keys() == ARRAYS - {"box"}
        assert_arrays({**found, "box": true_arrays(index)["box"]}, index)
        assert sample["meta.json"]["index"] == index
        assert sample["design.txt"] == fake_sample(0, index).design
        assert sample["measures.json"] == fake_sample(0, index).measurements.to_file_values()


def test_webdataset_maps_whole_samples(tars: tuple[Path, Path]) -> None:
    for index, sample in enumerate(wds.WebDataset(str(tars[0]), shardshuffle=False).map(gcd_dataset.decode)):
        assert sample.keys() == ARRAYS | {"meta", "spec", "design", "measures", "__key__"}
        assert_arrays(sample, index)
    both = wds.WebDataset(str(tars[0]), shardshuffle=False).decode(gcd_dataset.decode).map(gcd_dataset.decode)
    assert next(iter(both)).keys() == sample.keys() - {"box"}


def test_pictures_are_left_to_webdataset(tmp_path: Path) -> None:
    sample = fake_sample(0, 0)
    view = View(sample.front or b"", {"camera": {"size": [16, 16]}})
    tars = write_shard(tmp_path, [replace(sample, caption="a skirt", views=(view,))])
    (pictures,) = wds.WebDataset(str(tars[1]), shardshuffle=False).decode(gcd_dataset.decode, "rgb8")
    assert pictures["front.jpg"].shape == pictures["view_0.jpg"].shape == (16, 16, 3)
    assert pictures["view_0.json"] == view.facts
    (item,) = wds.WebDataset(str(tars[0]), shardshuffle=False).map(gcd_dataset.decode)
    assert item["caption"] == "a skirt"
    assert gcd_dataset.decode(".front.jpg", sample.front or b"") is None
    assert gcd_dataset.decode({"front.jpg": sample.front}) == {}


@pytest.mark.parametrize("streaming", [True, False])
def test_datasets_maps_whole_samples(tars: tuple[Path, Path], tmp_path: Path, streaming: bool) -> None:
    import datasets

    def rows(path: Path) -> Any:
        given = {"data_files": str(path), "streaming": streaming, "cache_dir": str(tmp_path), "split": "train"}
        return datasets.load_dataset("webdataset", **given)

    items = rows(tars[0]).map(gcd_dataset.decode, remove_columns=rows(tars[0]).column_names)
    for index, item in enumerate(items):
        assert item.keys() == ARRAYS | {"meta", "spec", "design", "measures"}
        assert_arrays(item, index)
        assert item["meta"]["index"] == index
        assert json.loads(item["design"]) == fake_sample(0, index).design  # a text: its keys differ between samples
    pictures = next(iter(rows(tars[1]).map(gcd_dataset.decode)))
    assert pictures["front.jpg"].size == (16, 16)


def test_people_are_decoded(tmp_path: Path) -> None:
    from gcd_dataset.shards.body_set import encode_person

    origin = {"index": 3, "seed": 0, "recipe": {}, "versions": {}}
    tar = write_tar(tmp_path / "people.tar", {"gcd_000000003": encode_person(fake_person(3), origin)})
    (person,) = wds.WebDataset(str(tar), shardshuffle=False).map(gcd_dataset.decode)
    assert person["meta"]["name"] == "fake:3"
    assert np.abs(person["apart"] - fake_person(3).apart).max() < 1e-3


def test_a_damaged_member_is_named() -> None:
    members = encode_sample(fake_sample(0, 0))
    damaged = bytearray(members["verts.z"])
    damaged[-1] ^= 1
    with pytest.raises(ShardError, match=r"member verts\.z: not a whole frame"):
        gcd_dataset.decode(".verts.z", bytes(damaged))
    with pytest.raises(ShardError, match=r"member verts\.z"):
        gcd_dataset.decode({**members, "verts.z": bytes(damaged)})
    with pytest.raises(ShardError, match=r"member future\.z: not a whole frame"):
        gcd_dataset.decode(".future.z", b"abc")


def test_the_face_imports_neither_torch_nor_warp() -> None:
    code = "import sys, gcd_dataset; gcd_dataset.decode; sys.exit(any(n in sys.modules for n in ('torch', 'warp')))"
    assert subprocess.run([sys.executable, "-c", code], env=os.environ, check=False).returncode == 0


def test_the_examples_of_the_documentation_run(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "format.md").read_text()
    for number in range(20):
        write_shard(tmp_path / "garments", [fake_sample(0, number)], number)
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    assert len(blocks) == 2
    for block in blocks:
        done = subprocess.run(
            [sys.executable, "-c", block], cwd=tmp_path, env=os.environ, capture_output=True, text=True, check=False
        )
        assert done.stdout.count("gcd_0000000") == 20, done.stderr
