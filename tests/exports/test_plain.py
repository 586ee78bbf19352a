"""Plain tars: what NumPy, tarfile and webdataset read without this package."""

import io
import json
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import webdataset as wds

from gcd_dataset import export
from gcd_dataset.errors import ConfigError
from gcd_dataset.exports import datasets
from gcd_dataset.shards import ShardReader, decode_fields
from gcd_dataset.shards.codec import WIDTHS
from gcd_dataset.shards.layout import fields_of
from tests.shards.folders import fill

COUNT = 5


# webdataset closes no tar.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_every_field_is_a_file_that_others_decode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(datasets, "SAMPLES", 3)
    data = fill(tmp_path / "data", range(2, 2 + COUNT))
    assert export(data, tmp_path / "out", "plain").done == COUNT
    tars = sorted((tmp_path / "out").iterdir())
    assert [path.name for path in tars] == ["train-00000.tar", "train-00001.tar"]
    reader, found = ShardReader(data), dict[str, bytes]()
    for path in tars:
        with tarfile.open(path) as tar:
            found |= {entry.name: tar.extractfile(entry).read() for entry in tar}  # type: ignore[union-attr]
    for position in range(COUNT):
        members, key = reader.read(position, reader.layout.members), reader.key(position)
        stored = [field for field in fields_of(members) if field in WIDTHS]
        for field, array in decode_fields(members, stored).items():
            read = np.load(io.BytesIO(found.pop(f"{key}.{field}.npy")), allow_pickle=False)
            assert read.dtype == array.dtype and np.array_equal(read, array)
        for member in ("meta.json", "spec.txt", "design.txt", "measures.json", "front.jpg", "back.jpg"):
            assert found.pop(f"{key}.{member}") == members[member]
    assert not found
    samples: list[Any] = list(wds.WebDataset([str(path) for path in tars], shardshuffle=False).decode("rgb8"))
    assert [sample["meta.json"]["index"] for sample in samples] == list(range(2, 2 + COUNT))
    assert samples[0]["faces.npy"].shape[1:] == (3,)
    assert samples[0]["front.jpg"].shape == (16, 16, 3)
    assert json.loads(samples[0]["design.txt"]).keys() == {"skirt"}
    for out in (data, data / "train"):
        with pytest.raises(ConfigError, match="in the folder of the data set itself: choose another folder"):
            export(data, out, "plain")
