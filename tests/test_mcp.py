"""The tools of ``gcd-mcp``, called without a server: files, refusals, limits."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from gcd_dataset.errors import ConfigError, GcdError, OutputError
from gcd_dataset.generator.garments import GarmentDesign, read_design
from gcd_dataset.generator.garments.space import leaves
from gcd_dataset.mcp import server
from gcd_dataset.mcp.tools import MOST_GARMENTS, Answer, Refused, Tools

SKIRT = {"meta": {"bottom": "SkirtCircle"}, "flare-skirt": {"length": 0.4}}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Tools:
    """Tools on a folder with a skirt, ``skirt/``, beside a folder of other things, ``out/``."""
    folder = tmp_path_factory.mktemp("place").resolve()
    (folder / "root").mkdir()
    (folder / "out").mkdir()
    (folder / "out" / "secret.json").write_text("{}")
    tools = Tools(folder / "root")
    tools.draw("skirt", design=SKIRT)
    (tools.root / "link").symlink_to("../out")
    return tools


SPEC = "skirt/skirt_specification.json"


def test_parameters_of_a_garment_have_range_default_and_meaning(made: Tools) -> None:
    answer = made.parameters(bottom="Pants")
    lines = answer.text.splitlines()
    paths = [leaf.path for leaf in leaves(GarmentDesign) if leaf.path.startswith(("meta.", "pants."))]
    assert [line.partition(":")[0] for line in lines] == paths
    line = "pants.rise: a number from 0.5 to 1; default 1.0 with probability 0.3. Where the top sits: 0 at the hips, "
    assert f"{line}1 at the waist." in lines
    assert answer.picture is not None


def test_a_drawn_design_is_checked_scored_against_itself_and_exported(made: Tools) -> None:
    assert read_design(made.root / "skirt" / "skirt_design_params.yaml").flare_skirt.length == 0.4
    made.draw("again", design="skirt/skirt_design_params.yaml")
    same = [(made.root / spec).read_bytes() for spec in (SPEC, "again/again_specification.json")]
    assert same[0] == same[1]
    assert made.check(SPEC).text == "1 pattern: no fault found"
    assert "score.iou 1 share" in made.score(SPEC, "again/again_specification.json").text
    made.export(SPEC, "skirt.dxf")
    assert (made.root / "skirt.dxf").read_bytes().startswith(b"  0\nSECTION")


def test_a_seed_draws_the_same_garment_again(made: Tools) -> None:
    made.draw("a/first", seed=5, body="male:2")
    made.draw("b/first", seed=5, body="male:2")
    first, second = ((made.root / name / "first" / "first_specification.json").read_bytes() for name in "ab")
    assert first == second


@pytest.mark.parametrize(
    "path", ["../out/secret.json", "link/secret.json", "/etc/secret.json", "skirt/../../out/secret.json"]
)
def test_paths_out_of_the_root_are_refused_for_reading_and_writing(made: Tools, path: str) -> None:
    calls: tuple[Callable[[], Answer], ...] = (
        lambda: made.check(path),
        lambda: made.drape([path], "draped"),
        lambda: made.score(SPEC, path),
        lambda: made.score(path, SPEC),
        lambda: made.measure(path),
        lambda: made.draw("new", design=path),
        lambda: made.draw("new", design=SKIRT, body=path),
        lambda: made.draw(path, design=SKIRT, overwrite=True),
        lambda: made.export(SPEC, f"{path}.dxf", overwrite=True),
    )
    for call in calls:
        with pytest.raises(ConfigError, match="leads out of the root folder"):
            call()


@pytest.mark.parametrize("path", ["~/secret.json", "s3://bucket/a.json", "org/garments", "--out=x", "a\0b"])
def test_no_path_is_a_home_a_server_or_an_option(made: Tools, path: str) -> None:
    with pytest.raises(GcdError, match=r"no such file|names no file"):
        made.check(path)
    with pytest.raises(GcdError, match=r"no such file|names no file"):
        made.export(path, "new.glb")


def test_an_output_is_overwritten_only_if_asked(made: Tools) -> None:
    (made.root / "mine.mtl").write_text("mine")
    calls: tuple[Callable[[], Answer], ...] = (
        lambda: made.draw("skirt", design=SKIRT),
        lambda: made.drape([SPEC], "skirt"),
        lambda: made.export(SPEC, SPEC.replace(".json", ".svg").replace("specification", "pattern")),
        lambda: made.export(SPEC, "mine.obj"),
    )
    for call in calls:
        with pytest.raises(OutputError, match="is there already: give another name, or overwrite=true"):
            call()


def test_overwriting_replaces_a_link_and_not_its_target(made: Tools) -> None:
    folder, target = made.root / "linked", made.root.parent / "out" / "secret.json"
    folder.mkdir()
    (folder / "linked_specification.json").symlink_to(target)
    made.draw("linked", design=SKIRT, overwrite=True)
    assert target.read_text() == "{}"
    assert not (folder / "linked_specification.json").is_symlink()


def test_limits_and_contradictions_are_refused(made: Tools) -> None:
    with pytest.raises(ConfigError, match="9 specifications: give 1 to 8"):
        made.drape([SPEC] * (MOST_GARMENTS + 1), "draped")
    with pytest.raises(ConfigError, match=r"resolution 0\.5: give 1 to 10 centimetres"):
        made.drape([SPEC], "draped", resolution=0.5)
    with pytest.raises(ConfigError, match="give a seed of 0 or more, or a design"):
        made.draw("new")
    with pytest.raises(ConfigError, match="give a seed of 0 or more, or a design"):
        made.draw("new", seed=-1)
    with pytest.raises(ConfigError, match=r"end the name in \.dxf"):
        made.export(SPEC, "skirt.exe")
    with pytest.raises(Refused, match=r"^gcd drape: unknown fabric 'silk': choose one of default, "):
        made.drape([SPEC], "draped", fabric="silk")
    assert not (made.root / "draped").exists()


def test_a_call_answers_in_json_and_runs_no_module_of_its_folder(tmp_path: Path) -> None:
    (tmp_path / "base64.py").write_text("raise SystemExit('ran')")
    command = [sys.executable, "-P", "-m", "gcd_dataset.mcp.tools", str(tmp_path), "check"]
    given = json.dumps({"spec": "no.json"})
    done = subprocess.run(command, input=given, cwd=tmp_path, capture_output=True, text=True, check=True)
    answer = {"text": "no.json: no such file: give the path of a specification JSON", "picture": None, "refused": True}
    assert json.loads(done.stdout) == answer


def test_a_missing_folder_or_library_is_one_line_and_exit_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "mcp.server", None)
    for folder, message in ((tmp_path / "none", "no such folder: create it"), (tmp_path, "'gcd-dataset[mcp]'")):
        with pytest.raises(SystemExit, match="2"):
            server.main([str(folder)])
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1
