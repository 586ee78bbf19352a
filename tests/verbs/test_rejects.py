"""``rejects.jsonl``: the same lines for any number of workers, parts and interruptions."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from gcd_dataset.cli import main
from gcd_dataset.generator.maker import produce
from gcd_dataset.shards import read_manifest
from gcd_dataset.verbs import JobPart, generate, making, merge, storing
from tests.verbs.real import COUNT, CUFFED, contents, killed, made_once


@pytest.fixture(autouse=True)
def small_shards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(storing, "SHARD_SIZE", 4)
    monkeypatch.setattr(making, "produce", made_once)


@pytest.fixture
def whole(tmp_path: Path) -> dict[str, bytes]:
    """The files of a data set made in a single run."""
    generate(tmp_path / "whole", COUNT, config=CUFFED)
    return contents(tmp_path / "whole")


def lines(content: bytes) -> list[dict[str, Any]]:
    return [json.loads(line) for line in content.splitlines()]


def test_each_attempt_has_a_line_with_its_figures(whole: dict[str, bytes]) -> None:
    found = lines(whole["rejects.jsonl"])
    assert len(found) > 2
    assert list(found[0]) == ["seed", "design", "attempt", "index", "rule", "reason", "figures"]
    message = [(line["design"], line["attempt"]) for line in found]
    assert message == sorted(set(message))
    for line in found:
        assert line["index"] // 2 == line["design"]
        assert line["rule"] == "tight_cuff"
        assert 0 < line["figures"]["cuff_cm"] < line["figures"]["limb_cm"]
        assert f"a cuff of {line['figures']['cuff_cm']:.1f} cm round a leg of" in line["reason"]


def test_lines_and_manifest_tell_of_the_same_attempts(tmp_path: Path, whole: dict[str, bytes]) -> None:
    manifest = read_manifest(tmp_path / "whole")
    assert manifest is not None
    designs = [line["design"] for line in lines(whole["rejects.jsonl"])]
    wearers = sum(2 if 2 * design + 1 < COUNT else 1 for design in designs)  # the manifest counts each sample
    assert manifest.splits["train"].rejects == {"tight_cuff": wearers}


def test_progress_counts_an_attempt_once_for_all_wearers(tmp_path: Path) -> None:
    done = generate(tmp_path, COUNT, config=CUFFED)
    assert done.rejects == {"tight_cuff": len(lines((tmp_path / "rejects.jsonl").read_bytes()))}


def test_workers_do_not_change_the_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: dict[str, bytes]
) -> None:
    monkeypatch.setattr(making, "produce", produce)
    generate(tmp_path / "two", 12, config=CUFFED, workers=2)
    assert whole["rejects.jsonl"].startswith((tmp_path / "two" / "rejects.jsonl").read_bytes())
    assert (tmp_path / "two" / "rejects.jsonl").stat().st_size > 0


def test_interruptions_do_not_change_the_lines(tmp_path: Path, whole: dict[str, bytes]) -> None:
    out = tmp_path / "killed"
    make = partial(generate, out, COUNT, config=CUFFED)
    for after in (1, 9):
        killed(make, after=after)
    with (out / ".rejects.jsonl.part").open("ab") as journal:
        journal.write(b'{"seed":0,"design":5,"att')  # a partial line after a kill
    make()
    assert contents(out) == whole


def test_a_kill_before_the_file_is_written_loses_nothing(tmp_path: Path, whole: dict[str, bytes]) -> None:
    out = tmp_path / "killed"
    killed(partial(generate, out, COUNT, config=CUFFED), after=COUNT)
    assert generate(out, COUNT, config=CUFFED).made == 0
    assert contents(out) == whole


def test_a_set_that_has_grown_has_the_lines_of_the_larger(tmp_path: Path, whole: dict[str, bytes]) -> None:
    out = tmp_path / "grown"
    for count in (3, 10, COUNT):
        generate(out, count, config=CUFFED)
        assert {line["design"] for line in lines((out / "rejects.jsonl").read_bytes())} <= set(range(-(-count // 2)))
    assert contents(out) == whole


def test_parts_have_the_lines_of_one_run(tmp_path: Path, whole: dict[str, bytes]) -> None:
    out = tmp_path / "parts"
    for number in (2, 0, 1):
        generate(out, COUNT, config=CUFFED, part=JobPart(number, 3))
    merge(out)
    assert (out / "rejects.jsonl").read_bytes() == whole["rejects.jsonl"]


@pytest.mark.parametrize("damage", [b"", b'{"seed":0}\n', b"\xff\n[]\n"])
def test_lost_lines_are_restored_from_the_samples(damage: bytes, tmp_path: Path, whole: dict[str, bytes]) -> None:
    """Samples hold rule and reason; the figures are lost."""
    out = tmp_path / "whole"
    (out / "rejects.jsonl").unlink()
    if damage:
        (out / ".rejects.jsonl.part").write_bytes(damage)
    generate(out, COUNT, config=CUFFED)
    found = lines((out / "rejects.jsonl").read_bytes())
    bare = [{**line, "index": 2 * line["design"], "figures": {}} for line in lines(whole["rejects.jsonl"])]
    assert found == bare
    assert contents(out).keys() == whole.keys()


def test_a_shard_that_is_made_again_has_its_lines_again(tmp_path: Path, whole: dict[str, bytes]) -> None:
    out = tmp_path / "whole"
    (out / "train-00000.tar").unlink()
    generate(out, COUNT, config=CUFFED)
    assert contents(out) == whole


def test_a_set_without_rejects_says_so_by_an_empty_file(tmp_path: Path) -> None:
    generate(tmp_path, 4, config=CUFFED)
    assert (tmp_path / "rejects.jsonl").read_bytes() == b""


def test_info_names_the_file(tmp_path: Path, whole: dict[str, bytes], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(tmp_path / "whole")]) == 0
    said = capsys.readouterr().out
    assert "tight_cuff" in said
    assert f"every rejected attempt, with its figures: {tmp_path / 'whole' / 'rejects.jsonl'}" in said
