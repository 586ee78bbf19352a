"""The viewer benchmark: its set, its requests, and the times that it takes."""

import argparse
import os
from pathlib import Path

import pytest

from benchmarks.cases import imports, viewer
from benchmarks.run import main
from benchmarks.viewing.server import shown
from benchmarks.viewing.workload import FULL, KIND, OUTCOME, full_range, write_set
from gcd_dataset.shards import ShardReader
from gcd_dataset.viewer.garments import Filter, ShardAlbum

COUNT = 4 * FULL


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_set(tmp_path_factory.mktemp("set"), COUNT)


def test_the_set_holds_small_garments_of_all_kinds_and_full_ones_in_its_middle(folder: Path) -> None:
    reader = ShardReader(folder, verify="full")
    album = ShardAlbum(reader, "set")
    album.read_tags()
    assert len(album) == album.known == COUNT
    assert len(album.facets().kinds) == 8
    assert 0 < len(album.matches(Filter(kind=KIND, outcome=OUTCOME))) < COUNT / 5
    full = full_range(COUNT)
    sizes = [len(mesh.vertices) for position in range(COUNT) if (mesh := reader.sample(position).box_mesh) is not None]
    assert min(sizes[position] for position in full) > 20 * max(sizes[: full.start])
    assert reader.sample(full.start).shape is not None


def test_no_garment_that_is_jumped_to_is_made_ahead() -> None:
    jumps, full = list(viewer._jumps(COUNT)), full_range(COUNT)
    shown_before = set(range(full.start, full.start + viewer.NEXT + 2))
    assert len(jumps) == viewer.JUMPS and set(jumps) <= set(full)
    assert not set(jumps) & (shown_before | {jump + 1 for jump in jumps})


def test_the_viewer_is_started_and_asked(folder: Path, tmp_path: Path) -> None:
    with shown(folder, full_range(COUNT).start, {**os.environ, "GCD_CACHE": str(tmp_path)}) as site:
        assert site.cpu_since_start > 0 and site.since_start > 0
        assert site.wait_for_tags() > 0
        for cost in (site.timed_next(), site.timed_jump(0)):
            assert 0 < cost.wall < 60
        assert site.timed_filter(0) > 0
        assert site.peak_memory > 20
    assert list((tmp_path / "tags").glob("*.z"))  # tags for the next start


def test_figures_are_named_with_units_and_leave_out_what_was_not_measured() -> None:
    times = dict.fromkeys(
        ("first_page", "first_page_cpu", "first_page_again", "tags", "tags_again", "next", "next_reading", "jump"), 0.5
    ) | {"jump_reading": 0.25, "jump_cpu": 0.125, "filter": 0.002, "peak_memory": 300.0, "load": 1.5}
    figures = {figure.metric: figure.value for figure in viewer._figures(times, 100)}
    assert figures["first_page_s"] == 0.5 and figures["filter_ms"] == 2.0 and figures["jump_reading_ms"] == 250.0
    assert "first_picture_s" not in figures


def test_a_count_too_small_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["viewer", "--count", "10"]) == 1
    assert "--count 10: give" in capsys.readouterr().err


def test_imports_are_figures_of_cpu_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(imports, "COMMANDS", {"torch": ("-c", "pass"), "loaders": ("-c", "pass")})
    figures = imports.run(argparse.Namespace(rounds=1)).figures
    assert [figure.metric for figure in figures] == ["torch_cpu_s", "loaders_cpu_s", "loaders_beside_torch_cpu_s"]
    assert all(figure.value > 0 for figure in figures[:2])
