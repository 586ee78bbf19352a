"""Wrong usage and missing files give one line with a remedy, and the same exit codes for every verb."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from gcd_dataset.cli import _parser, main
from gcd_dataset.cli.common import EXAMPLES
from gcd_dataset.generator.maker import make
from gcd_dataset.records import Sample
from gcd_dataset.spec import write_pattern
from tests.test_cli import FLAT, SKIRT, exit_code, one_line

VERBS = tuple(EXAMPLES)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a data set of patterns, a specification file and files of other kinds."""
    folder = tmp_path_factory.mktemp("place")
    assert main(["generate", str(folder / "shards"), "--count", "2", *FLAT]) == 0
    write_pattern(make(1, 0, SKIRT).pattern, folder / "spec.json")
    (folder / "none").mkdir()
    (folder / "broken.json").touch()
    (folder / "body.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (folder / "walk.bvh").write_text("HIERARCHY")
    (folder / "text.txt").write_text("neither\n")
    (folder / "empty.yaml").write_text("meta: {}\n")
    (folder / "crossed.yaml").write_text(
        "meta: {upper: FittedShirt}\ncollar: {f_collar: SquareNeckHalf, fc_depth: 2.0, width: 1.0}\n"
    )
    (folder / "skirt.yaml").write_text("meta: {bottom: SkirtCircle}\n")
    return folder


WRONG_USAGE = [
    ("", "the following arguments are required: VERB"),
    ("drapee spec.json", "no drapee: .*did you mean drape?"),
    *((verb, "the following arguments are required|give ") for verb in VERBS),
    *((f"{example} --qiuet", "no option --qiuet") for verb in VERBS for example in [EXAMPLES[verb][0][4:]]),
    ("generate out --count 1 --stage drap", "no drap: choose from body, pattern, mesh, drape: did you mean drape?"),
    ("generate out --count 1 --resolutoin 2", "no option --resolutoin: did you mean --resolution?"),
    ("generate out --count 0", "count is 0: give 1 to 10000000"),
    *(
        (f"generate out --count {10**12} --stage {stage}", "count is 1000000000000: give 1 to 10000000")
        for stage in ("pattern", "body")
    ),
    *(
        (f"generate out --count 1 --stage body {options}", message)
        for options, message in (
            ("--resolution 2", "resolution is for garments"),
            ("--on-fail keep", "on-fail is for garments"),
            ("--bodies neutral", "bodies is 'neutral': a body set is drawn from random, female, male, pooled"),
            ("--count 0", "count is 0"),
        )
    ),
    ("generate out --count -1", "-1 is not a whole number"),
    ("generate out --count 1 --resolution 99", "give a length from 0.2 to 10.0"),
    ("generate out --count 1 --device gpu", "device='gpu': give auto, cpu"),
    *(
        (f"generate out --recipe smoke-64 {given}", f"{given.split()[0]} is fixed by the recipe: leave it out")
        for given in ("--count 5", "--seed 0", "--resolution 2", "--stage body")
    ),
    ("generate out", "Give --count N, or --recipe NAME"),
    ("generate out --count 1 --fabric denin", "unknown fabric 'denin': choose one of"),
    ("generate shards --count 1 --seed 9 --stage pattern", "made with seed=0, asked for seed=9"),
    ("drape spec.json --out out --body neutrl", "no body named neutrl: .*did you mean neutral?"),
    ("drape spec.json --out out --body rnadom:7", "no body named rnadom:7: .*did you mean random?"),
    ("drape spec.json --out out --body random:x", "the seed is x: give a whole number of 0 or more"),
    ("drape spec.json --out out --fabric denin", "unknown fabric 'denin': choose one of"),
    ("drape spec.json --out out --device cuda:99", "unknown device 'cuda:99': choose one of"),
    ("drape spec.json --out out --pose t-pose --outfit", "--outfit is for a body in the A-pose"),
    ("drape spec.json --out out --motion walk --fps 0.5", "0.5 poses a second"),
    ("drape spec.json --out out --motion walk --pose t-pose", "leave --pose out"),
    ("drape spec.json --out out --motion walk --maps", "leave out --motion"),
    ("drape spec.json --out out --fps 25", "give --motion"),
    ("drape skirt.yaml --out out --sizes men", "--sizes needs the size to cut: give --cut-for SIZE"),
    ("grade skirt.yaml --chart woman --out out", "no chart woman: there are women, men"),
    ("measure --shape femael", "did you mean female?"),
    ("measure a.obj b.obj", "unexpected argument b.obj"),
    ("measure --shape neutral --landmarks x.json", "are for a mesh file"),
    ("show shards --png a.jpg", "end the name in .png"),
    ("show shards --truth shards --png a.png", "leave out --png"),
    ("show shards --port 70000", "70000 is above 65535"),
    ("show shards --sheet a.gif", "end its name in .jpg or .jpeg or .png"),
    ("show shards --sheet a.jpg --index 1-0", "1-0 is not a whole number of 0 or more, nor a list such as"),
    ("show shards --sheet a.jpg --where clean", "--where clean: write kind="),
    (
        "show shards --sheet a.jpg --where kind=toga",
        "0 garments selected: select 1 to 400 by --index and --where: kinds ",
    ),
    ("show shards --png a.png --index 0-1", "are for --sheet: give one index"),
    *(
        (f"show shards --maps {to}", "holds no maps of stretch, gap and pressure: gcd generate --maps stores them$")
        for to in ("", "--html a.html", "--sheet a.png")
    ),
    ("show spec.json --truth none", "--truth none: no specification file"),
    ("show shards --body male", "are for the panels of a SPEC: leave them out"),
    ("verify https://example.org/a --full", "run gcd download https://example.org/a first"),
    ("download shards", "a local folder"),
    ("publish shards nobody --dry-run --out out", "neither a URL nor a repository"),
    ("publish shards me/garments --dry-run --out out --shares 1,2", "give per cent"),
    ("check shards shards", "2 inputs: give one data set, or specification files"),
    ("check spec.json --quick", "--quick is for data sets"),
    ("export shards", "one of them"),
    ("export shards --layout published out --split test", "--layout takes train, validation and test"),
    ("export shards --layout publishd out", "unknown layout: give published"),
    ("export shards --glb a.glb --pdf a.pdf", "--glb, --obj, --ply, --usd, --dxf, --pdf: one of them"),
    ("export shards --hdf5 a.h5 --index 1", "--index is for --glb, --obj, --ply, --usd, --dxf, --pdf: leave"),
    ("export shards --ply a.ply --no-body", "--no-body is for --glb, --obj, --usd: leave it out"),
    ("export spec.json spec.json --glb a.glb", "--glb a.glb: 2 files are exported: give a folder"),
    ("export spec.json --pdf a.pdf --index 0", "--index is for a data set, and"),
]

BAD_INPUT = [
    ("generate text.txt --count 1 --stage pattern --quiet", "text.txt: cannot be written"),
    ("drape spec.json --out out --body missing.obj", "missing.obj: no such file"),
    ("drape spec.json --out out --body body.obj", "body.obj: 1 triangles with an area"),
    ("drape spec.json --out out --height 170", "neutral: a named body has known parts and height"),
    ("drape spec.json --out out --pose lotus", "no pose named lotus"),
    ("drape spec.json --out out --motion lotus", "no motion named lotus: there are walk"),
    ("drape spec.json --out out --motion walk.bvh", "walk.bvh: no HIERARCHY and MOTION"),
    ("drape text.txt --out reports --quiet", "text.txt: "),
    ("fit text.txt --out out", "text.txt: holds 'neither', no design: give GarmentCode's"),
    ("fit empty.yaml --out out", "empty.yaml: a garment without upper and bottom: choose meta.upper or meta.bottom"),
    (
        "fit crossed.yaml --out out",
        "crossed.yaml: cannot be sewn for this body: .*narrow_strap: panel right_ftorso: 0.8 cm",
    ),
    ("fit skirt.yaml --out out --body missing.obj", "missing.obj: no such file"),
    ("measure text.txt", "text.txt: not a readable mesh format"),
    ("validate text.txt", "text.txt: "),
    ("show missing --png a.png", "missing: no such folder"),
    ("show missing.json --png a.png", "missing.json: no such file"),
    ("show shards --png a.png --index 2", "garment 2 of 2: give one from 0 to 1"),
    ("show shards --index 2", "shards: garment 2 of 2: give one from 0 to 1"),
    ("show spec.json --index 3", "spec.json: garment 3 of 1: leave --index out"),
    ("show spec.json --index 3 --svg a.svg", "spec.json: garment 3 of 1: leave --index out"),
    ("show broken.json", "broken.json: empty, not a specification JSON"),
    (f"show {'long' * 100} --html a.html", "cannot be read .File name too long."),
    ("show shards --sheet a.jpg --index 0,1-2", "garment 2 of 2: give 0 to 1"),
    ("show spec.json --html a.html --body missing.obj", "missing.obj: no such file"),
    ("show shards --png a.png --split trian", "no samples of split trian: choose from train: did you mean train?"),
    ("info missing", "missing: no such folder"),
    ("info text.txt", "text.txt: a file, not a folder of shards"),
    ("verify missing", "missing: no such folder"),
    ("verify text.txt", "text.txt: "),
    ("index missing", "missing: no such folder"),
    ("publish missing me/garments --dry-run", "missing: no such folder"),
    ("convert missing out", "missing: no such folder"),
    ("convert shards out", "no folder such as garments_5000_0"),
    ("export missing --hdf5 a.h5", "missing: no such folder"),
    ("export shards --hdf5 a.h5 --split trian", "no samples of split trian: choose from train: did you mean train?"),
    ("export shards --layout published late --quiet", "is not draped"),
    ("export shards --index 2 --pdf a.pdf", "garment 2 of 2: give one from 0 to 1"),
    ("export spec.json --pdf no/such/a.pdf", "no/such/a.pdf: cannot be written"),
]


@pytest.mark.parametrize(
    ("code", "line", "message"), [(2, *case) for case in WRONG_USAGE] + [(1, *case) for case in BAD_INPUT]
)
def test_exit_codes_are_the_same_for_every_verb(
    code: int, line: str, message: str, place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """2 for wrong usage, 1 for bad input; always one line with the known names or a remedy. No viewer opens."""
    monkeypatch.setattr("gcd_dataset.viewer.server.serve", lambda site, **options: site.close())
    monkeypatch.chdir(place)
    before = {*place.iterdir()}
    assert exit_code(shlex.split(line)) == code
    said = one_line(capsys.readouterr().err)
    assert re.search(message.replace("?", r"\?"), said), said
    assert said.startswith("gcd")
    assert {*place.iterdir()} - before <= {place / "reports", place / "late"}


@pytest.mark.parametrize("verb", VERBS)
def test_the_help_of_every_verb_has_examples_that_parse(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    parser, verbs = _parser()
    assert set(verbs) == {*EXAMPLES, "doctor", "validate", "verify"}  # three older names of check
    assert exit_code([verb, "--help"]) == 0
    text = capsys.readouterr().out
    for example in EXAMPLES[verb]:
        assert f"\n  {example}\n" in text
        assert parser.parse_args(shlex.split(example)[1:]).verb == verb


def test_generate_prints_an_estimate_before_it_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    said_before: list[str] = []

    def made(*_: object, **__: object) -> Iterator[Sample]:
        said_before.append(caplog.text)
        yield from ()
        raise KeyboardInterrupt

    monkeypatch.setattr("gcd_dataset.making.garments.produce", made)
    command = ["generate", str(tmp_path), "--device", "cpu", "--quiet"]
    assert main([*command, "--count", "500"]) == 130
    assert "draping 500 garments at 1 cm on this CPU takes about " in said_before[0]
    caplog.clear()
    monkeypatch.undo()
    assert main([*command, "--count", "2", "--stage", "pattern"]) == 0
    assert main([*command, "--count", "2"]) == 2  # the data set has another recipe
    assert "takes about" not in caplog.text
