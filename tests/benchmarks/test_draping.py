"""The drape benchmark: variants, figures, pictures of failures."""

import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import run
from benchmarks.draping.failures import write_failures
from benchmarks.draping.modes import measure_memory, measure_sewn, variants
from benchmarks.draping.workload import Worn, pass_paper, quality
from benchmarks.peers.newton import require_newton, unmirrored
from gcd_dataset.errors import ConfigError
from gcd_dataset.generator.drape import DrapeConfig, DrapeJob, drape_batch
from gcd_dataset.records import Drape, Outcome
from gcd_dataset.spec import write_pattern
from tests.generator.dressing import test_dressing as openings
from tests.helpers import SIZE, far_ball, joined, patch


def drape(outcome: Outcome, *, crossings: int = 0) -> Drape:
    return Drape(np.zeros((3, 3), np.float32), outcome, 10, crossings, 0, 1.0, 1.0)


def worn(index: int) -> Worn:
    return Worn(index, "neutral", "Shirt", "", "", DrapeJob(patch(4, 4), far_ball(), SIZE))


def test_crossings_after_sewing_are_those_of_crossing_sheets_only() -> None:
    """One sheet crosses nothing; of two sheets that cross at right angles, edges still cross when sewing ends."""
    flat = patch(9, 9, place=np.eye(3)[:, :2], origin=(0.0, 100.0, 4.5))
    upright = patch(9, 9, place=np.eye(3)[:, [1, 2]], origin=(4.5, 100.1, 0.03))
    crossing = replace(worn(1), job=DrapeJob(joined(flat, upright), far_ball(), SIZE))
    measured = measure_sewn([replace(worn(0), job=DrapeJob(flat, far_ball(), SIZE)), crossing], device="cpu", batch=2)
    figures = {figure.metric: figure.value for figure in measured.figures}
    assert figures["sewn_clean"] == 0.5
    assert figures["sewn_body_p99"] == figures["sewn_through_p99"] == 0
    [row] = measured.rows
    assert row["index"] == 1 and row["self"] > 0


def test_each_switch_is_varied_alone_in_one_variant() -> None:
    switches = {entry.name for entry in fields(DrapeConfig) if isinstance(entry.default, bool)}
    alone = [name for variant in variants() if len(variant.switched) == 1 for name in variant.switched]
    numbers = {"untangling_steps", "most_drapes"}  # 0 steps switch untangling off, 1 drape the repetition
    assert sorted(alone) == sorted([*switches, *numbers])
    for variant in variants():
        changed = {name for name in switches if getattr(variant.config(), name) != getattr(DrapeConfig(), name)}
        assert changed == set(variant.switched) - numbers


def test_layer_friction_is_switched_in_the_fabric() -> None:
    [slippery] = [variant for variant in variants() if not variant.layers_rub]
    job = slippery.job(worn(0).job)
    assert job.fabric == replace(worn(0).job.fabric, layer_friction=0.0)


def test_the_papers_checks_ignore_stretch() -> None:
    assert pass_paper(drape(Outcome.OVERSTRETCHED))
    assert [outcome for outcome in Outcome if pass_paper(drape(outcome))] == [Outcome.SETTLED, Outcome.OVERSTRETCHED]


def test_the_papers_checks_count_edges_of_the_cloth_only() -> None:
    failed = drape(Outcome.THROUGH_BODY)
    assert pass_paper(replace(failed, body_crossings=30, body_through=6))
    assert not pass_paper(replace(failed, body_crossings=36, body_through=6))
    assert not pass_paper(replace(failed, body_crossings=30, body_through=6, self_crossings=301))


def test_shares_and_percentiles() -> None:
    drapes = [drape(Outcome.SETTLED), drape(Outcome.OVERSTRETCHED), drape(Outcome.THROUGH_ITSELF, crossings=400)]
    figures = {figure.metric: figure.value for figure in quality(drapes)}
    assert figures["passed"] == pytest.approx(1 / 3)
    assert figures["passed_paper"] == pytest.approx(2 / 3)
    assert [figures["self_p50"], figures["self_p80"], figures["body_p95"]] == pytest.approx([0.0, 240.0, 0.0])


def test_memory_needs_more_drapes_than_the_warm_up() -> None:
    with pytest.raises(ConfigError, match="99 drapes: give 100 or more"):
        measure_memory([worn(0)], 99, device="cpu", batch=1)


def test_each_failure_has_its_picture(tmp_path: Path) -> None:
    """A picture also of a garment with NaN positions, none of a settled garment."""
    garments = [worn(0), worn(1), worn(2)]
    [falling] = drape_batch([garments[0].job], DrapeConfig(max_frames=1), device="cpu")
    assert falling.outcome is Outcome.NOT_SETTLED
    lost = replace(falling, vertices=np.full_like(falling.vertices, np.nan), outcome=Outcome.DIVERGED)
    write_failures(tmp_path, garments, [falling, replace(falling, outcome=Outcome.SETTLED), lost], device="cpu")
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["0_NOT_SETTLED.jpg", "2_DIVERGED.jpg", "kinds.jpg"]


def test_the_error_without_newton_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "newton", None)
    with pytest.raises(ConfigError, match=r"pip install 'gcd-dataset\[bench\]'"):
        require_newton()


def test_mirrored_panels_keep_area_and_edge_lengths() -> None:
    mesh = patch(3, 2)
    mirrored = replace(mesh, uv=mesh.uv * [-1.0, 1.0])
    corners = unmirrored(mirrored)
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    np.testing.assert_allclose(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0], 1.0)
    np.testing.assert_allclose(np.abs(corners), np.abs(mirrored.uv[mirrored.corners]))
    np.testing.assert_array_equal(unmirrored(mesh), mesh.uv[mesh.corners])


def test_a_pattern_that_cannot_be_read_is_named_and_the_others_are_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good, bad, report = tmp_path / "good.json", tmp_path / "bad.json", tmp_path / "report.md"
    write_pattern(openings.tube(50.0, 30.0, y=80.0), good)
    bad.write_text("{")
    options = ["--device", "cpu", "--resolution", "6", "--report", str(report)]
    assert run.main(["drape", str(bad), str(good), *options]) == 1
    printed = capsys.readouterr()
    assert "drape.s_per_garment" in printed.out
    assert f"bad: REFUSED: {bad}: line 1" in printed.err
    assert "| bad |  | REFUSED |" in report.read_text()
