"""Albums of the viewer: order, filters, jumps, damaged garments, predictions beside truth."""

import argparse
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gcd_dataset.cli import main
from gcd_dataset.cli.show import _album
from gcd_dataset.errors import BodyError, ConfigError, GcdError
from gcd_dataset.generator.body import named_body
from gcd_dataset.generator.drawing import draw_pattern, jpeg_bytes
from gcd_dataset.generator.garments.overlay import Overlay
from gcd_dataset.generator.maker import make
from gcd_dataset.generator.recipe import MakeConfig
from gcd_dataset.generator.render import render_garment
from gcd_dataset.loaders import PublishedGarmentCodeData
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import Grade, Maps, Outcome
from gcd_dataset.shards import ShardReader, ShardWriter
from gcd_dataset.shards.layout import garments_layout
from gcd_dataset.spec import write_pattern
from gcd_dataset.viewer import garments
from gcd_dataset.viewer.garments import Album, Filter, PublishedAlbum, ShardAlbum, published_content, spec_album
from tests.helpers import as_draped, flip, parts, renamed
from tests.release.published import BATCH, TRAIN, publish

COUNT = 6
SHORT = Overlay.from_dict({"meta": {"upper": "none", "bottom": "PencilSkirt"}, "pencil-skirt": {"length": 0.2}})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six samples: every third of grade ``paper``, the others ``clean``; even ones are skirts, odd ones dresses.

    Number 4 slid off.
    """
    where = tmp_path_factory.mktemp("shards")
    with ShardWriter(where, seed=0, recipe={}) as writer:
        for index in range(COUNT):
            grade = Grade.PAPER if index % 3 == 0 else Grade.CLEAN
            sample = replace(fake_sample(0, index), grade=grade, tags=("skirt" if index % 2 == 0 else "dress",))
            assert sample.drape is not None
            outcome = Outcome.SLID_OFF if index == 4 else Outcome.SETTLED
            writer.write(replace(sample, drape=replace(sample.drape, outcome=outcome)))
    return where


@pytest.fixture
def album(folder: Path) -> ShardAlbum:
    return ShardAlbum(ShardReader(folder), "shards")


def test_grades_and_settled_drapes_are_known_at_once_and_kinds_once_they_are_read(album: ShardAlbum) -> None:
    facets = album.facets()
    assert facets.grades == {"paper": 2, "clean": 4}
    assert facets.outcomes == {"settled": 5, "all but settled": 1}
    assert album.known == 0 and not facets.kinds and not len(album.matches(Filter(kind="skirt")))
    assert album.matches(Filter(outcome="all but settled")).tolist() == [4]
    album.read_tags()
    assert album.known == COUNT
    assert album.facets().kinds == {"dress": 3, "skirt": 3}
    assert album.facets().outcomes == {"settled": 5, "all but settled": 1, "slid off": 1}
    assert album.matches(Filter(outcome="slid off")).tolist() == [4]


def test_filters_combine(album: ShardAlbum) -> None:
    album.read_tags()
    assert album.matches(Filter(grade="paper")).tolist() == [0, 3]
    assert album.matches(Filter(kind="dress")).tolist() == [1, 3, 5]
    assert album.matches(Filter(kind="dress", grade="clean")).tolist() == [1, 5]
    assert album.matches(Filter(kind="skirt", outcome="settled")).tolist() == [0, 2]
    assert not len(album.matches(Filter(grade="nonsense")))
    assert not len(album.matches(Filter(outcome="nonsense")))


def test_moving_goes_round_and_stays_among_the_admitted(album: ShardAlbum) -> None:
    album.read_tags()
    dress = Filter(kind="dress")
    assert [album.found(rank, dress).position for rank in (0, 1, 2, 3, -1)] == [1, 3, 5, 1, 5]
    assert [album.found(rank, dress).following for rank in (0, 2)] == [3, 1]
    assert album.nearest(2, dress).position == 3
    assert album.nearest(5, Filter(kind="skirt")).position == 4  # none follows: the last one
    assert album.found(0, Filter(grade="failed")).position == -1


@pytest.mark.parametrize("text", ["4", " gcd_000000004 ", "000000004"])
def test_a_garment_is_found_by_index_and_key(text: str, album: ShardAlbum) -> None:
    assert album.position_of(text) == 4
    assert album.key(4) == "gcd_000000004"


@pytest.mark.parametrize("text", ["6", "-1", "gcd_", "sleeve", "9" * 30])
def test_an_unknown_garment_is_refused_with_the_known_range(text: str, album: ShardAlbum) -> None:
    with pytest.raises(ConfigError, match="from 0 to 5"):
        album.position_of(text)


def test_reading_stops_when_the_album_is_closed(album: ShardAlbum) -> None:
    album.close()
    album.read_tags()
    assert album.known == 0


def test_tags_are_read_in_parts_and_a_call_before_each_sees_what_is_known(
    album: ShardAlbum, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(garments, "CHUNK", 2)
    known = list[int]()
    album.read_tags(lambda: known.append(album.known))
    assert (known, sum(album.facets().kinds.values())) == ([0, 2, 4], COUNT)


def test_a_damaged_garment_has_no_tags_and_the_others_do(folder: Path, tmp_path: Path) -> None:
    album = ShardAlbum(ShardReader(Path(shutil.copytree(folder, tmp_path / "copy"))), "shards")
    (shard,) = (tmp_path / "copy").glob("*.tar")
    flip(shard, 600, after=b"gcd_000000002.meta.json\0")
    album.read_tags()
    assert (album.known, album.facets().kinds) == (COUNT, {"dress": 3, "skirt": 2})


def test_a_picture_is_the_stored_front_or_the_drape_rendered_or_the_pattern(tmp_path: Path) -> None:
    made = make(3, 0, MakeConfig(bodies="neutral", stage="mesh", resolution=8.0, design=SHORT))
    bare = as_draped(made)
    mesh, drape = parts(bare)
    lost = replace(drape, vertices=np.full_like(drape.vertices, np.nan))
    white = jpeg_bytes(np.full((8, 8, 3), 255, np.uint8))
    with ShardWriter(tmp_path, seed=0, recipe={}) as writer:
        for index, sample in enumerate([replace(bare, front=white), bare, replace(bare, drape=lost)]):
            writer.write(replace(sample, provenance=replace(made.provenance, index=index)))
    album = ShardAlbum(ShardReader(tmp_path), "shards")
    stored, rendered, drawn = (album.picture(position, 64) for position in range(3))
    assert (stored > 250).all()
    assert np.array_equal(drawn, draw_pattern(made.pattern, size=64))
    body, _, _ = named_body("neutral")
    front, _ = render_garment(drape.vertices, mesh, body, size=64, device="cpu")
    assert np.abs(rendered.astype(int) - front).mean() < 1


@pytest.mark.long
def test_maps_colour_the_cloth_alone_and_alike_where_nothing_stretches_or_presses_it(tmp_path: Path) -> None:
    """Cloth 20 cm from the skin, as cut and without pressure: green in the picture of gaps, pale in the others."""
    made = make(3, 0, MakeConfig(bodies="neutral", stage="mesh", resolution=8.0, design=SHORT))
    mesh, drape = parts(as_draped(made))
    nothing = np.zeros(len(drape.vertices))
    maps = Maps(np.ones((len(nothing), 2)), nothing + 20.0, nothing, 1.0)
    with ShardWriter(tmp_path / "set", seed=0, recipe={}, layout=garments_layout(maps=True)) as writer:
        writer.write(replace(made, drape=drape, maps=maps, provenance=replace(made.provenance, index=0)))
    picture = ShardAlbum(ShardReader(tmp_path / "set"), "shards", maps=True).picture(0, 128).astype(int)
    stretch, gap, pressure = picture[:64, 64:], picture[64:, :64], picture[64:, 64:]
    cloth = np.abs(gap - pressure).max(axis=2) > 60
    assert 0.02 < cloth.mean() < 0.3
    assert (gap[cloth][:, 1] > 1.2 * gap[cloth][:, 0]).all()
    assert (stretch == pressure).all()
    assert np.ptp(pressure[cloth], axis=1).max() < 40
    for form, rows in (("--png", 6), ("--sheet", 1)):  # of the sheet: control pictures of both sides, then the maps
        assert main(["show", str(tmp_path / "set"), "--maps", form, str(tmp_path / "a.png")]) == 0
        with Image.open(tmp_path / "a.png") as written:
            assert written.height > rows * 512
    Image.new("RGB", (2, 2), (0, 255, 0)).save(tmp_path / "green.png")
    options = ["--texture", f"{mesh.panel_names[0]}={tmp_path / 'green.png'}", "--png"]
    assert main(["show", str(tmp_path / "set"), *options, str(tmp_path / "a.png")]) == 0
    with Image.open(tmp_path / "a.png") as written:
        red, green, blue = np.asarray(written.convert("RGB")).astype(int)[:, : 2 * 518].transpose(2, 0, 1)
        assert ((green > 2 * red) & (green > 2 * blue)).sum() > 500


def sheet_of(folder: Path, *options: str) -> tuple[int, tuple[int, int]]:
    """Exit code of ``gcd show --sheet``, and width and height of the sheet in tiles."""
    picture = folder.parent / "sheet.png"
    code = main(["show", str(folder), "--sheet", str(picture), *options])
    with Image.open(picture) as sheet:
        width, height = sheet.size
    return code, (width // 512, height // 512)


@pytest.mark.parametrize(
    ("options", "tiles"),
    [
        ([], (3, 2)),
        (["--index", "0-2,5"], (2, 2)),
        (["--where", "kind=dress", "grade=clean"], (2, 1)),
        (["--where", "outcome=slid off", "--index", "3-5"], (1, 1)),
    ],
)
def test_a_sheet_shows_the_selected_garments(options: list[str], tiles: tuple[int, int], folder: Path) -> None:
    assert sheet_of(folder, *options) == (0, tiles)


def test_a_damaged_garment_is_left_white_on_a_sheet(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "damaged"
    shutil.copytree(folder, copy)
    flip(copy / "train-00000.tar", 600, after=b"gcd_000000000.meta.json\0")
    assert sheet_of(copy, "--index", "0-3") == (1, (2, 2))
    assert "gcd show: " in capsys.readouterr().err


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
    with pytest.raises(GcdError, match="no true pattern of this name"):
        album.page(1, 1)


def test_scores_tell_what_is_missing_and_the_means(tmp_path: Path, folder: Path) -> None:
    """Predictions match by the garment's name, also those of a data set; one that cannot be read costs no other."""
    predicted = tmp_path / "predicted"
    (tmp_path / "nested" / "gcd_000000001").mkdir(parents=True)
    predicted.mkdir()
    for index, name in enumerate(("gcd_000000000_prediction", "gcd_000000001", "other")):
        write_pattern(fake_sample(0, index).pattern, predicted / f"{name}.json")
    (predicted / "gcd_000000002_predicted.json").write_text("{")
    write_pattern(fake_sample(0, 1).pattern, tmp_path / "nested" / "gcd_000000001" / "specification.json")
    lines = list(spec_album(predicted, ShardReader(folder)).scores())
    assert lines[:2] == [
        "1 without a true pattern: other",
        "3 without a prediction: gcd_000000003, gcd_000000004, gcd_000000005",
    ]
    assert lines[2].startswith("gcd_000000000: iou 1.000") and "stitch_f1 1.000" in lines[2]
    assert "gcd_000000002: no score" in lines[4] and lines[5].startswith("mean of 2: iou 1.000")
    assert "4 without" not in "".join(lines)
    nested = spec_album(predicted, tmp_path / "nested")
    assert [line.partition(":")[0] for line in nested.scores()][1:] == ["gcd_000000001", "mean of 1"]
    assert nested.links(1)["score"] == lines[3].partition(": ")[2]


def test_an_empty_folder_and_two_files_of_one_garment_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no specification file"):
        spec_album(tmp_path)
    for name in ("a.json", "a_prediction.json"):
        write_pattern(fake_sample(0, 1).pattern, tmp_path / name)
    with pytest.raises(ConfigError, match=r"a_prediction\.json: .*a\.json is named after the same garment"):
        spec_album(tmp_path)


def test_a_specification_that_cannot_be_drawn_is_an_error_with_file_and_edge(tmp_path: Path) -> None:
    write_pattern(fake_sample(0, 1).pattern, tmp_path / "a.json")
    spec = json.loads((tmp_path / "a.json").read_text())
    name, panel = next(iter(spec["pattern"]["panels"].items()))
    panel["edges"][1]["endpoints"] = [1, 9999]
    (tmp_path / "a.json").write_text(json.dumps(spec))
    with pytest.raises(GcdError, match=rf"a\.json: panel {name}, edge 1.*vertex 9999"):
        spec_album(tmp_path).page(0)


def test_matched_panels_and_right_seams_of_a_prediction_are_linked(tmp_path: Path) -> None:
    """Panels in another order and with other names match by place and outline; a seam is linked if its edges match."""
    true = fake_sample(0, 1).pattern
    other = renamed(true, {panel.name: f"p{number}" for number, panel in enumerate(true.panels)})
    panels, seams = other.panels[::-1], other.seams[1:]
    for name, pattern in (("predicted", replace(other, panels=panels, seams=seams)), ("true", true)):
        (tmp_path / name).mkdir()
        write_pattern(pattern, tmp_path / name / "a.json")
    links = spec_album(tmp_path / "predicted", tmp_path / "true").links(0)
    last = len(panels) - 1
    assert sorted(links["panels"]) == [[i, last - i, 1.0] for i in range(len(panels))]
    assert links["seams"] == [[i, i + 1] for i in range(len(seams))]
    assert spec_album(tmp_path / "true").links(0) == {"panels": [], "seams": []}


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


def album_of(folder: Path) -> Album:
    """What ``gcd show`` opens for a folder."""
    options = argparse.Namespace(what=str(folder), split="train", truth=None, endpoint=None, index=0, maps=False)
    vars(options).update(dict.fromkeys(("body", "measurements", "segmentation", "height", "betas")))
    return _album(options)


def test_a_release_is_recognised_beside_its_split_file(root: Path) -> None:
    """The split file of a release is JSON, and no specification."""
    for folder in (root, root.parent):
        assert isinstance(album_of(folder), PublishedAlbum)


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
