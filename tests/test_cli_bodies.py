"""``gcd generate --stage body``."""

from pathlib import Path

import pytest

from gcd_dataset.cli import main
from gcd_dataset.generator.body import draw_shape
from gcd_dataset.loaders import BodyDataset
from gcd_dataset.seeding import Stage, rng
from tests.shards.folders import contents

BODIES = ["--stage", "body", "--quiet"]


def test_a_stopped_run_resumes_to_the_same_bytes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, at_once = tmp_path / "data", tmp_path / "at_once"
    for folder, count, workers in ((out, "1", "0"), (out, "3", "2"), (at_once, "3", "0"), (at_once, "3", "0")):
        options = ["--count", count, "--seed", "3", "--workers", workers]
        assert main(["generate", str(folder), *options, *BODIES]) == 0
    assert [line.partition(": ")[2] for line in capsys.readouterr().out.splitlines()] == [
        "1 bodies in two poses, 1 of them made now",
        "3 bodies in two poses, 2 of them made now",
        "3 bodies in two poses, 3 of them made now",
        "3 bodies in two poses, 0 of them made now",
    ]
    assert contents(out) == contents(at_once)
    kinds, indices = zip(*(item["name"].split(":3:") for item in BodyDataset(out, fields=["name"])), strict=True)
    assert indices == tuple("012")
    assert set(kinds) <= {"female", "male"}


@pytest.mark.parametrize("group", ["female", "male", "pooled"])
def test_people_of_a_group(tmp_path: Path, capsys: pytest.CaptureFixture[str], group: str) -> None:
    assert main(["generate", str(tmp_path), "--count", "2", "--bodies", group, *BODIES]) == 0
    people = list(BodyDataset(tmp_path, fields=["name", "shape"]))
    assert [person["name"] for person in people] == [f"{group}:0:0", f"{group}:0:1"]
    drawn = draw_shape(rng(0, 1, Stage.BODY), group=group)
    assert people[1]["shape"].numpy() == pytest.approx(drawn.weights, rel=1e-6)
    assert main(["generate", str(tmp_path), "--count", "3", *BODIES]) == 2
    assert "bodies" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--resolution", "2"], "resolution is for garments"),
        (["--on-fail", "keep"], "on-fail is for garments"),
        (["--bodies", "neutral"], "bodies is 'neutral': a body set is drawn from random, female, male, pooled"),
        (["--count", "0"], "count is 0"),
    ],
)
def test_options_for_garments_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    assert main(["generate", str(tmp_path / "out"), "--count", "1", *options, *BODIES]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_garments_are_not_put_among_bodies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["generate", str(tmp_path), "--count", "1", *BODIES]) == 0
    before = contents(tmp_path)
    assert main(["generate", str(tmp_path), "--count", "1", "--stage", "pattern", "--quiet"]) == 2
    assert "made with kind='bodies', asked for kind='garments'" in capsys.readouterr().err
    assert contents(tmp_path) == before
