"""Albums of the viewer: order, filters, jumps, damaged garments, predictions beside truth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gcd_dataset.errors import ConfigError, GcdError
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import Grade
from gcd_dataset.shards import ShardReader, ShardWriter
from gcd_dataset.spec import write_pattern
from gcd_dataset.viewer.album import ShardAlbum, spec_album

COUNT = 6


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Samples 0 to 5: every third of grade ``paper``, the others ``clean``; even ones are skirts, odd ones dresses."""
    where = tmp_path_factory.mktemp("shards")
    with ShardWriter(where, seed=0, recipe={}) as writer:
        for index in range(COUNT):
            grade = Grade.PAPER if index % 3 == 0 else Grade.CLEAN
            writer.write(replace(fake_sample(0, index), grade=grade, tags=("skirt" if index % 2 == 0 else "dress",)))
    return where


@pytest.fixture
def album(folder: Path) -> ShardAlbum:
    return ShardAlbum(ShardReader(folder), "shards")


def test_grades_are_known_at_once_and_tags_once_they_are_read(album: ShardAlbum) -> None:
    assert album.grades() == {"paper": 2, "clean": 4}
    assert album.read == 0 and not album.tags() and not len(album.matches(tag="skirt"))
    album.read_tags()
    assert album.read == COUNT
    assert album.tags()["skirt"] == album.tags()["dress"] == 3


def test_a_filter_admits_garments_of_its_grade_and_tag(album: ShardAlbum) -> None:
    album.read_tags()
    assert album.matches(grade="paper").tolist() == [0, 3]
    assert album.matches(tag="dress").tolist() == [1, 3, 5]
    assert album.matches(grade="clean", tag="dress").tolist() == [1, 5]
    assert not len(album.matches(grade="nonsense"))


def test_moving_goes_round_and_stays_among_the_admitted(album: ShardAlbum) -> None:
    album.read_tags()
    assert [album.found(rank, tag="dress").position for rank in (0, 1, 2, 3, -1)] == [1, 3, 5, 1, 5]
    assert album.nearest(2, tag="dress").position == 3
    assert album.nearest(5, tag="skirt").position == 4  # none follows: the last one
    assert album.found(0, grade="failed").position == -1


@pytest.mark.parametrize("text", ["4", " gcd_000000004 ", "000000004"])
def test_a_garment_is_found_by_index_and_key(text: str, album: ShardAlbum) -> None:
    assert album.position_of(text) == 4
    assert album.key(4) == "gcd_000000004"


@pytest.mark.parametrize("text", ["6", "-1", "gcd_", "sleeve", "9" * 30])
def test_an_unknown_garment_is_refused_with_the_known_range(text: str, album: ShardAlbum) -> None:
    with pytest.raises(ConfigError, match="from 0 to 5"):
        album.position_of(text)


def test_a_garment_has_its_page(album: ShardAlbum) -> None:
    assert "gcd_000000002" in album.page(2)


def test_reading_stops_when_the_album_is_closed(album: ShardAlbum) -> None:
    album.close()
    album.read_tags()
    assert album.read == 0


def test_predictions_stand_beside_the_truth_of_the_same_name(tmp_path: Path) -> None:
    predicted, true = tmp_path / "predicted", tmp_path / "true"
    for where, size in ((predicted, 1.0), (true, 2.0)):
        where.mkdir()
        pattern = fake_sample(0, 1).pattern
        panels = tuple(replace(panel, vertices=np.asarray(panel.vertices) * size) for panel in pattern.panels)
        write_pattern(replace(pattern, panels=panels, name="a"), where / "a.json")
    write_pattern(replace(fake_sample(0, 2).pattern, name="b"), predicted / "b_specification.json")
    album = spec_album(predicted, true)
    assert album.beside == ("predicted", "true")
    assert [album.key(position) for position in range(len(album))] == ["a", "b"]
    assert album.position_of("b") == album.position_of("b_specification.json") == 1
    assert album.page(0, 0) != album.page(0, 1)
    with pytest.raises(GcdError, match="no file of this name"):
        album.page(1, 1)


def test_a_folder_without_specifications_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no specification file"):
        spec_album(tmp_path)
