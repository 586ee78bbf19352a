"""Cases: selection, fresh garments in a training loop, and the recorded FreeSewing patterns."""

import argparse
import json
import tarfile
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

import benchmarks.run
from benchmarks import run
from benchmarks.cases import CaseResult, Figure, generated, jpeg_file, loaders
from benchmarks.cases.design_space import UNUSED, shift
from benchmarks.cases.loaders import _opening, _passes, _ratios, cpu_ms_of
from benchmarks.cases.remote import _Counting
from benchmarks.loading import CONFIGS, installed_loaders, large_sample, write_shards
from gcd_dataset.errors import ConfigError
from gcd_dataset.faults import require_valid
from gcd_dataset.generator.garments.parameter import Choice, Real
from gcd_dataset.generator.garments.space import Leaf
from gcd_dataset.loaders import GeneratedGarments
from gcd_dataset.spec import pattern_from_spec

LENGTH = Leaf("skirt.length", Real(0.0, 0.4, 0.0, 1.0))
CUT = Leaf("skirt.cut", Choice("plain", None, ("plain", "flared")))


def test_a_limit_moves_the_share_above_it() -> None:
    values = [0.01 + 0.98 * k / 999 for k in range(1000)]
    within = [value if value < 0.75 else value - 0.75 for value in values]
    found = shift(LENGTH, values, within, paired=True)
    assert found.moved == pytest.approx(0.25, abs=0.02)
    assert found.rare == ("0.75 to 1",)


def test_options_are_compared_by_share() -> None:
    found = shift(CUT, ["plain", "flared"] * 100, ["plain"] * 100, paired=False)
    assert found.moved == pytest.approx(0.5)
    assert found.rare == ("flared",)


def test_designs_without_the_parameter_do_not_count() -> None:
    found = shift(CUT, ["plain", UNUSED, "flared"], ["plain", "plain", "flared"], paired=True)
    assert found.moved == pytest.approx(1 / 6)


def options(*given: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    generated.add_arguments(parser)
    return parser.parse_args(given)


def test_the_rate_of_patterns_is_measured() -> None:
    asked = options("--stage", "pattern", "--workers", "1", "--seconds", "0.2", "--warm", "2", "--batch", "2")
    figures = {figure.metric: figure.value for figure in generated.run(asked).figures}
    assert figures["per_second"] > 0


def test_a_duration_of_zero_is_refused() -> None:
    with pytest.raises(ConfigError, match="--seconds"):
        generated.run(options("--seconds", "0"))


def test_the_networks_waiting_times_are_measured() -> None:
    asked = options("--workers", "0", "--seconds", "0.1", "--warm", "2", "--batch", "2")
    garments = GeneratedGarments(99, stage="mesh", resolution=8.0, points=256, fields=generated.FIELDS["mesh"])
    figures = {figure.metric: figure.value for figure in generated._trained(garments, asked, "cpu")}
    assert figures["small_steps_per_second"] > 0
    assert 0 <= figures["small_waits"] < 1


RECORDED = Path(benchmarks.run.__file__).parent / "data" / "freesewing.tar.xz"


def test_ten_valid_patterns_of_each_design_are_sewn() -> None:
    """The free edges are hems, necklines and waists alone. One pattern of each design is validated."""
    designs: Counter[str] = Counter()
    with tarfile.open(RECORDED) as tar:
        for member in sorted((entry for entry in tar if entry.isfile()), key=lambda entry: entry.name):
            file, name = tar.extractfile(member), Path(member.name).name
            assert file is not None
            pattern = pattern_from_spec(json.loads(file.read()), name)
            if designs[name.split("_")[0]] == 0:
                require_valid(pattern, source=name)
            designs[name.split("_")[0]] += 1
            assert 2 * len(pattern.seams) / sum(len(panel.edges) for panel in pattern.panels) > 0.6
    assert set(designs.values()) == {10}
    assert len(designs) == 9


@pytest.fixture(autouse=True)
def tape(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """``tape`` is the only case; reports of the tree go to a temporary folder."""

    def add_arguments(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--length", type=float)

    def measure(options: argparse.Namespace) -> CaseResult:
        return CaseResult([Figure("girth", 2 * options.length, "cm")], [{"body": "doll", "cm": options.length}])

    case = SimpleNamespace(__doc__="A case.", add_arguments=add_arguments, run=measure)
    monkeypatch.setattr(run, "CASES", {"tape": "tape"})
    monkeypatch.setattr(run, "load_case", lambda name: case)
    monkeypatch.setattr(run, "REPORTS", tmp_path / "reports")


def test_figures_are_printed_and_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "tape.md"
    assert run.main(["tape", "--length", "3", "--report", str(path)]) == 0
    assert capsys.readouterr().out == "tape.girth 6 cm\n"
    text = path.read_text()
    assert "`python -m benchmarks.run tape --length 3 --report" in text
    assert "| tape.girth | 6 | cm |" in text
    assert "| doll | 3 |" in text
    assert "commit: " in text


def test_a_report_in_the_tree_is_replaced_only_on_request(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = tmp_path / "reports" / "tape.md"
    kept.parent.mkdir()
    kept.write_text("of a full run")
    assert run.main(["tape", "--length", "3"]) == 0
    assert kept.read_text() == "of a full run"
    told = capsys.readouterr()
    assert told.out == "tape.girth 6 cm\n"
    assert f"no report is written: --keep writes {kept}" in told.err
    assert run.main(["tape", "--length", "3", "--keep"]) == 0
    assert "| tape.girth | 6 | cm |" in kept.read_text()


def test_a_jpeg_has_no_other_ending() -> None:
    assert jpeg_file("drapes.JPG") == Path("drapes.JPG")
    with pytest.raises(argparse.ArgumentTypeError, match=r"drapes.png: the picture is a JPEG"):
        jpeg_file("drapes.png")


COUNT = 32


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_shards(tmp_path_factory.mktemp("data"), COUNT)


def test_garments_have_the_size_of_a_dress() -> None:
    garments = [large_sample(index) for index in range(12)]
    counts = [len(garment.box_mesh.vertices) for garment in garments if garment.box_mesh is not None]
    assert 12_000 < sum(counts) / len(counts) < 17_000
    assert {len(garment.pattern.panels) for garment in garments} == {11}
    assert {len(garment.pattern.seams) for garment in garments} == {28}


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("config", CONFIGS)
def test_all_loaders_yield_the_same_batches(folder: Path, config: str) -> None:
    """``webdataset`` leaves files open, hence the filters; it reads in order, as the indices here are."""
    fields, indices = CONFIGS[config], range(16)
    installed = installed_loaders(folder, fields)
    del installed["GarmentLoader"]  # in an order of its own
    expected = installed["memmap"](indices)
    for name, load in installed.items():
        batch = load(indices)
        for field in fields:
            rows = batch[field].reshape(expected[field].shape)  # points are stacked, or one after the other
            assert torch.equal(rows, expected[field]), (name, field)
            if field != "points":
                assert torch.equal(batch[f"{field}_ptr"], expected[f"{field}_ptr"]), (name, field)
    assert len(installed) >= 4


def test_a_figure_is_the_median_over_pairs_of_epochs() -> None:
    slow = [2.0, 2.0, 9.0]
    spent = {"geometry": {"ours": slow, "memmap": [1.0, 1.0, 1.0], "memmap as ndarray": [0.5, 1.0, 4.5], "arrow": slow}}
    figures = {figure.metric: figure.value for figure in _ratios(spent)}
    assert figures["geometry_over_memmap"] == 2.0
    assert figures["geometry_cpu_ms"] == 2.0
    counted: dict[str, list[int]] = {"a": [], "b": []}

    def counting(name: str) -> Callable[[Sequence[int]], None]:
        return lambda indices: counted[name].append(len(indices))

    times = cpu_ms_of({name: counting(name) for name in counted}, 5, 2, seconds=0)
    assert {name: sum(sizes) for name, sizes in counted.items()} == {"a": 10, "b": 10}  # one epoch before the clock
    assert np.min(times["a"]) >= 0


def test_first_passes_and_waits_are_measured(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loaders, "TIMES", 1)
    figures = {figure.metric: figure.value for figure in _passes(folder)}
    assert figures["stream_over_random"] > 0
    assert 0 < figures["wait_percent"] < 100


def test_a_store_counts_requests_and_the_bytes_of_their_answers() -> None:
    def answer(request: dict[str, Any], start: Callable[..., Any]) -> list[bytes]:
        start("200 OK", [("Content-Length", "7")])
        return [b"content"]

    server, begun = _Counting(answer), []
    for method, path in (("GET", "/a"), ("HEAD", "/a"), ("GET", "/a")):
        server({"REQUEST_METHOD": method, "PATH_INFO": path}, lambda *begin: begun.append(begin))
    counts = [json.loads(b"".join(server({"PATH_INFO": "/counted"}, lambda *begin: None))) for _ in range(2)]
    assert counts == [[3, 14], [0, 0]]
    assert len(begun) == 3


def test_a_large_index_is_opened_and_filtered(tmp_path: Path) -> None:
    figures = {figure.metric: figure.value for figure in _opening(tmp_path / "large", 3000)}
    assert 0 < figures["index_bytes"] < 8
