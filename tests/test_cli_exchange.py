"""``gcd convert`` and ``gcd export``."""

import contextlib
import errno
import io
import itertools
import os
import shutil
import signal
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch

from gcd_dataset import convert
from gcd_dataset.exports.published import export_published, exported_splits, garment_type
from gcd_dataset.generator.maker import make
from gcd_dataset.generator.recipe import MakeConfig, recipe_of
from gcd_dataset.loaders import GarmentDataset, Hdf5Garments, PublishedGarmentCodeData
from gcd_dataset.records import Outcome
from gcd_dataset.release.published_names import ENDINGS
from gcd_dataset.shards import ShardReader
from gcd_dataset.shards.hdf5 import write_hdf5
from tests.helpers import as_draped, parts
from tests.making.conftest import stopped
from tests.release.published import BATCH, BODIES, TRAIN, file_of, pack, publish
from tests.shards.folders import contents, fill, write_samples
from tests.test_cli import run


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return publish(tmp_path_factory.mktemp("published"))


@pytest.fixture(scope="module")
def converted(published: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The published garments as shards."""
    out = tmp_path_factory.mktemp("converted")
    with contextlib.redirect_stdout(io.StringIO()) as said:
        assert run("convert", published, out, "--quiet") == 0
    assert "6 garments, 6 of them converted now" in said.getvalue()
    assert "train 4, test 2" in said.getvalue()
    return out


@pytest.fixture(scope="module")
def exported(converted: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shards in the published layout."""
    out = tmp_path_factory.mktemp("exported")
    assert run("export", converted, "--layout", "published", out, "--quiet") == 0
    return out


def test_converted_shards_equal_the_published_files(published: Path, converted: Path) -> None:
    for split in ("train", "test"):
        before, after = PublishedGarmentCodeData(published, split), GarmentDataset(converted, split)
        assert len(before) == len(after)
        for item, stored in zip(map(dict[str, Any], before), map(dict[str, Any], after), strict=True):
            assert stored["meta"].pop("crc32")
            # The file also has derived numbers; the 26 stored measures went through radians.
            taken = {name: item["measures"][name] for name in stored["measures"]}
            assert taken == pytest.approx(stored["measures"], rel=1e-12)
            item["measures"] = stored["measures"]
            for field, value in item.items():
                same = torch.equal(value, stored[field]) if isinstance(value, torch.Tensor) else value == stored[field]
                assert same, field
        after.verify(0)
        assert after.recipe(0) == before.recipe(0)


def test_a_stopped_conversion_goes_on_to_the_same_bytes(published: Path, converted: Path, tmp_path: Path) -> None:
    stopped(partial(convert, published, tmp_path / "pieces"), after=3)
    assert run("convert", published, tmp_path / "pieces", "--quiet") == 0
    assert contents(tmp_path / "pieces") == contents(converted)


def test_a_conversion_of_more_garments_of_other_bodies_or_beside_another_data_set_needs_another_folder(
    published: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("convert", published, tmp_path / "out", "--quiet", "--bodies", "random") == 0
    assert [item["meta"]["index"] for item in GarmentDataset(tmp_path / "out", fields="meta")] == [1, 3]
    assert run("convert", published, tmp_path / "out", "--quiet") == 2
    assert capsys.readouterr().err.endswith("asked for 6: choose another folder\n")
    assert run("convert", published, tmp_path / "out", "--quiet", "--bodies", "default") == 2
    assert "not a shard of this data set" in capsys.readouterr().err
    assert run("convert", published, fill(tmp_path / "other", range(2)), "--quiet") == 2
    assert "use the same or another folder" in capsys.readouterr().err


def test_a_broken_garment_is_left_out_and_reported(
    published: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = pack(Path(shutil.copytree(published, tmp_path / "whole")))
    broken = Path(shutil.copytree(published, tmp_path / "broken"))
    path = file_of(broken, TRAIN[1], "box")
    path.unlink()
    assert run("convert", broken, tmp_path / "out", "--quiet") == 1
    error = capsys.readouterr().err
    assert f"left out: {BATCH}/{BODIES[0]}/{TRAIN[1]}: {path}: missing" in error
    assert "1 garments were skipped; the same command tries them again" in error
    assert run("convert", root, tmp_path / "out", "--quiet") == 0  # downloaded again, as it is packed
    assert len(GarmentDataset(tmp_path / "out")) == 4


def test_shards_to_the_published_layout_and_back(published: Path, exported: Path) -> None:
    # Not byte for byte: pictures are encoded again, coordinates were stored as float32.
    near = ("render_front.png", "render_back.png", "_sim.ply", "_boxmesh.ply", "_orig_lens.pickle")
    for path in published.rglob("[!.]*"):
        if path.is_file() and not path.name.endswith(near):
            assert path.read_bytes() == (exported / path.relative_to(published)).read_bytes(), path
    before, after = (PublishedGarmentCodeData(root) for root in (published, exported))
    for item, other in zip(before, after, strict=True):
        for field in ("verts", "box", "faces", "labels", "seams", "panels", "edges", "stitches"):
            assert torch.equal(item[field], other[field]), field
        assert (item["uv"] - other["uv"]).abs().max() < 2e-3  # cm: rounded in the shards, and by the published layout


@pytest.mark.long
def test_generated_garments_are_published_under_names_of_their_own(tmp_path: Path) -> None:
    config = MakeConfig(bodies="both", stage="mesh", resolution=8.0, points=16)
    outcomes = (Outcome.SETTLED, Outcome.SETTLED, Outcome.THROUGH_BODY, Outcome.SETTLED)
    samples = [as_draped(make(3, index, config), outcome) for index, outcome in enumerate(outcomes)]
    write_samples(tmp_path / "shards", samples, seed=3, recipe=recipe_of(config))
    assert run("export", tmp_path / "shards", "--layout", "published", tmp_path / "out", "--quiet") == 0
    published = PublishedGarmentCodeData(tmp_path / "out")
    assert [published.number(index) for index in range(3)] == [0, 1, 3]  # the third did not settle
    places = [name.split("/") for name in published.names]
    assert places[0][2] == places[1][2] != places[2][2]  # one design on two bodies
    assert [place[1] for place in places] == [BODIES[0], BODIES[1], BODIES[1]]
    for item, sample in zip(published, (samples[0], samples[1], samples[3]), strict=True):
        mesh, _ = parts(sample)
        assert torch.equal(item["faces"], torch.tensor(mesh.faces))
        assert sorted(item["seams"].tolist()) == sorted(mesh.seams.tolist())
        taken = sample.measurements.to_file_values()
        assert {name: item["measures"][name] for name in taken} == pytest.approx(taken, rel=1e-9)
        assert item["meta"]["panel_names"] == list(mesh.panel_names)
        flat = item["uv"][item["corners"]]
        assert torch.allclose(flat, torch.tensor(mesh.uv[mesh.corners]).float(), atol=1e-3)
        design = item["design"]["meta"]["upper"]
        assert design["v"] == sample.design["meta"]["upper"]
        assert "range" in design


def tree(folder: Path) -> dict[str, bytes]:
    """Path to content of all files, hidden ones included; without what readers keep beside them."""
    files = [path for path in folder.rglob("*") if path.is_file() and not path.name.endswith(".gcd.json")]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def test_a_stopped_export_goes_on_to_the_same_bytes(
    converted: Path, exported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    export = ["export", converted, "--layout", "published", tmp_path / "pieces", "--quiet"]
    with monkeypatch.context() as full:
        files = itertools.count()
        sync = os.fsync

        def no_room(file: int) -> None:
            if next(files) > 20:  # in the second garment
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            sync(file)

        full.setattr(os, "fsync", no_room)
        assert run(*export) == 1
    assert "No space left" in capsys.readouterr().err
    [garment] = [path for path in (tmp_path / "pieces").glob("*/*/data/*") if path.is_dir()]
    assert {path.name for path in garment.iterdir()} == {TRAIN[0] + ending for ending in ENDINGS.values()}
    written = garment.stat().st_mtime_ns
    assert run(*export) == 0
    assert garment.stat().st_mtime_ns == written
    assert tree(tmp_path / "pieces") == tree(exported)
    assert run(*export) == 2  # the export is complete
    assert "not empty: choose another folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("form", "message"),
    [
        (["--layout", "published", "out"], "stopped at 1 of 6 of train, test: the same command continues from there"),
        (["--hdf5", "out.h5"], "stopped at 0 of 4: out.h5 was not written: run it again"),
    ],
)
def test_ctrl_c_reports_the_progress(
    form: list[str],
    message: str,
    converted: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    capsys.readouterr()
    read = ShardReader.read

    def interrupted(reader: ShardReader, position: int, members: tuple[str, ...]) -> object:
        if position == 1:
            raise KeyboardInterrupt
        return read(reader, position, members)

    monkeypatch.setattr(ShardReader, "read", interrupted)
    assert run("export", converted, *form, "--quiet") == 130
    assert capsys.readouterr().err == f"gcd export: {message}\n"
    assert not Path("out.h5").exists()


def test_a_stopped_export_does_not_go_on_with_other_garments(
    published: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shards, out = tmp_path / "shards", tmp_path / "out"
    assert run("convert", published, shards, "--bodies", "random", "--quiet") == 0
    stopped = export_published(exported_splits(shards), out)
    next(stopped)
    assert run("export", shards, "--layout", "published", out) == 1
    assert "another process is exporting" in capsys.readouterr().err
    stopped.close()
    before = tree(out)
    assert run("convert", published, tmp_path / "more", "--quiet") == 0
    assert run("export", tmp_path / "more", "--layout", "published", out) == 2
    assert f"{out}: begun with other garments" in capsys.readouterr().err
    assert tree(out) == before


def test_splits_that_the_published_layout_does_not_know_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    for split in ("train", "holdout"):
        fill(tmp_path / "shards", [0], split=split)
    assert list(exported_splits(tmp_path / "shards")) == ["train"]
    assert "holdout" in caplog.text
    for path in (tmp_path / "shards").glob("*train*"):
        path.unlink()
    (tmp_path / "shards" / "manifest.json").unlink()
    assert run("export", tmp_path / "shards", "--layout", "published", tmp_path / "out") == 1
    assert "the published layout has no name for its splits (holdout)" in capsys.readouterr().err


def test_one_file_of_hdf5_or_plain_tars(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fill(tmp_path / "shards", range(3))
    assert run("export", tmp_path / "shards", "--hdf5", tmp_path / "all.h5", "--quiet") == 0
    assert "3 garments of train" in capsys.readouterr().out
    assert len(Hdf5Garments(tmp_path / "all.h5")) == 3
    assert run("export", tmp_path / "shards", "--plain", tmp_path / "plain", "--quiet") == 0
    assert "plain: 3 garments of train" in capsys.readouterr().out
    assert [path.name for path in (tmp_path / "plain").iterdir()] == ["train-00000.tar"]


def test_a_killed_export_to_hdf5_leaves_nothing_for_long(tmp_path: Path) -> None:
    data = fill(tmp_path / "data", range(3))
    for _ in range(2):
        if (child := os.fork()) == 0:
            writing = write_hdf5(ShardReader(data), tmp_path / "a.h5")
            next(writing)
            os.kill(os.getpid(), signal.SIGKILL)
        os.waitpid(child, 0)
        assert len([path for path in tmp_path.iterdir() if path.name != "data"]) == 1
    assert run("export", data, "--hdf5", tmp_path / "a.h5", "--quiet") == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.h5", "data"]


def test_an_export_does_not_replace_its_source(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = contents(fill(tmp_path, range(2)))
    for name in ("train-00000.tar", "manifest.json", "train-00009.tar", "train.index"):
        assert run("export", tmp_path, "--hdf5", tmp_path / name, "--quiet") == 2
        assert (
            f"{tmp_path / name}: in the folder of the data set itself: end its name in .h5" in capsys.readouterr().err
        )
        assert contents(tmp_path) == before
    assert run("export", tmp_path, "--hdf5", tmp_path / "all.h5", "--quiet") == 0


@pytest.mark.parametrize(
    ("design", "main", "styles"),
    [
        ({"meta": {"upper": None, "bottom": "Pants"}, "pants": {"length": 0.9}}, "pants", ["maxi"]),
        ({"meta": {"bottom": "PencilSkirt"}, "pencil-skirt": {"length": {"v": 0.4}}}, "skirt", ["knee_len"]),
        ({"meta": {"upper": "FittedShirt"}, "sleeve": {"sleeveless": True}}, "upper_garment", ["sleeveless"]),
        (
            {"meta": {"upper": "FittedShirt", "bottom": "Pants"}, "sleeve": {"length": 0.3}, "pants": {"length": 0.2}},
            "jumpsuit",
            ["with_sleeves", "short_sleeve", "mini"],
        ),
        (
            {"meta": {"upper": "Shirt", "bottom": "Skirt2"}, "shirt": {"length": 1.2}, "skirt": {"length": 0.6},
             "left": {"enable_asym": True, "sleeve": {"length": 0.8}}, "sleeve": {"sleeveless": True}},
            "dress",
            ["asymmetric_top", "with_sleeves", "long_sleeve", "midi"],
        ),
    ],
)  # fmt: skip
def test_types_follow_the_rules_of_the_authors_sampler(design: dict[str, object], main: str, styles: list[str]) -> None:
    assert garment_type(design) == {"main": main, "styles": styles}
