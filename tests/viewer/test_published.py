"""Published data in the viewer: recognised by its folders, filtered by body folder, shown on the published bodies."""

import argparse
from pathlib import Path

import numpy as np
import pytest

from gcd_dataset.cli import main
from gcd_dataset.cli.show import _album
from gcd_dataset.errors import BodyError
from gcd_dataset.generator.body import named_body
from gcd_dataset.loaders import PublishedGarmentCodeData
from gcd_dataset.viewer.garments import Filter, PublishedAlbum, published_content
from tests.release.published import BATCH, TRAIN, publish

PEOPLE = "5000_body_shapes_and_measures"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two designs, each on the neutral body, which is there, and on a random one, of which only the first is there."""
    root = publish(tmp_path_factory.mktemp("published"))
    body, _, _ = named_body("neutral")
    lines = [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in 0.01 * body.vertices + [0.0, 0.3, 0.0]]  # m, lifted
    lines += [f"f {a} {b} {c}" for a, b, c in body.faces + 1]
    for path in (root / "neutral_body" / "mean_all.obj", root / PEOPLE / "meshes" / "00000_straight.obj"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(lines) + "\n")
    return root


def test_a_release_is_recognised_beside_its_split_file(root: Path) -> None:
    """The split file of a release is JSON, and no specification."""
    for folder in (root, root.parent):
        options = argparse.Namespace(what=str(folder), split="train", truth=None, endpoint=None, index=0)
        assert isinstance(_album(options), PublishedAlbum)


def test_garments_are_filtered_by_the_folder_of_their_body_and_found_by_name(root: Path) -> None:
    album = PublishedAlbum(PublishedGarmentCodeData(root), "release")
    assert album.facets().kinds == {"default body": 2, "random body": 2}
    assert album.matches(Filter(kind="random body")).tolist() == [1, 3]
    assert not len(album.matches(Filter(kind="random body", grade="clean")))
    assert album.position_of(f"{BATCH}/random_body/{TRAIN[1]}") == 3
    assert album.position_of(TRAIN[1]) == 2
    assert TRAIN[0] in album.page(0)


def test_a_garment_is_shown_on_its_body_with_soles_on_the_floor(root: Path) -> None:
    content = published_content(PublishedGarmentCodeData(root), 0)
    assert content.body is not None and content.body.name == "mean_all"
    assert content.body.vertices[:, 1].min() == 0
    assert np.ptp(content.body.vertices[:, 1]) == pytest.approx(np.ptp(named_body("neutral")[0].vertices[:, 1]), 1e-4)
    assert content.title == TRAIN[0]
    assert "body mesh" not in dict(content.tables["Recipe"])
    assert content.tables["Design"] == (("skirt.width", "1.5"),)  # the file also has range and type


def test_a_missing_body_is_named_with_the_archive_that_has_it(root: Path) -> None:
    published = PublishedGarmentCodeData(root)
    assert published.body(1).name == "00000_straight"
    with pytest.raises(BodyError, match=rf"00001_straight\.obj: missing.*extract {PEOPLE}\.tar\.gz"):
        published.body(3)
    content = published_content(published, 3)
    assert content.body is None and content.draped is not None
    assert PEOPLE in dict(content.tables["Recipe"])["body mesh"]


def test_show_writes_the_page_the_picture_and_the_pattern_of_a_published_garment(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [f"--{ending}={tmp_path / f'garment.{ending}'}" for ending in ("html", "png", "svg")]
    assert main(["show", str(root), "--index", "3", *files]) == 0
    assert PEOPLE in capsys.readouterr().err
    assert TRAIN[1] in (tmp_path / "garment.html").read_text("utf-8")
    assert (tmp_path / "garment.png").read_bytes().startswith(b"\x89PNG")
    assert "<svg" in (tmp_path / "garment.svg").read_text("utf-8")
    assert main(["show", str(root), "--index", "4", *files]) == 1
    assert "garment 4 of 4: give one from 0 to 3" in capsys.readouterr().err


def test_a_name_outside_the_release_is_no_path(root: Path) -> None:
    from gcd_dataset.release.bodies import published_body

    for name in ("../secret", "00000_naked", "mean_all/../../x", ""):
        with pytest.raises(BodyError, match="no body of the release"):
            published_body(root, name)
