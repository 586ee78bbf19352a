"""Design files: GarmentCode's form, read and written without loss."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from gcd_dataset.errors import ConfigError, OutputError
from gcd_dataset.generator.garments.design import (
    GarmentDesign,
    design_from_dict,
    design_tree,
    read_design,
    write_design,
)
from gcd_dataset.generator.garments.space import draw, from_dict
from gcd_dataset.generator.garments.wardrobe import Upper


def leaves_in(path: Path) -> dict[str, Mapping[str, Any]]:
    """The leaves of a design file by their paths, in its order."""
    return dict(_leaves(yaml.safe_load(path.read_text())["design"], ""))


def _leaves(tree: Mapping[str, Any], above: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    for key, node in tree.items():
        if "range" in node:
            yield above + key, node
        else:
            yield from _leaves(node, f"{above}{key}.")


def test_the_default_file_equals_the_references_leaf_by_leaf(examples: Path, tmp_path: Path) -> None:
    write_design(GarmentDesign(), tmp_path / "ours.yaml")
    ours, theirs = leaves_in(tmp_path / "ours.yaml"), leaves_in(examples / "default.yaml")
    assert list(ours) == list(theirs)
    cut = "pencil-skirt.style_side_cut"  # the reference's range lacks null, which its sampler adds
    assert ours[cut] == {**theirs[cut], "range": [*theirs[cut]["range"], None]}
    for path in theirs.keys() - {cut}:
        assert ours[path] == theirs[path], path
        assert list(ours[path]) == list(theirs[path])


def test_the_references_designs_survive_a_file_to_the_last_digit(examples: Path, tmp_path: Path) -> None:
    files = sorted(examples.glob("patterns/*/*/design_params.yaml"))
    assert len(files) == 24
    for file in files:
        design = read_design(file)
        write_design(design, tmp_path / "design.yaml")
        assert read_design(tmp_path / "design.yaml") == design
        ours, theirs = leaves_in(tmp_path / "design.yaml"), leaves_in(file)
        assert {path: leaf["v"] for path, leaf in ours.items()} == {path: leaf["v"] for path, leaf in theirs.items()}


def test_any_design_survives_its_file_to_the_last_digit(tmp_path: Path) -> None:
    for seed in range(10):
        design = draw(GarmentDesign, np.random.default_rng(seed))
        write_design(design, tmp_path / "design.yaml")
        assert read_design(tmp_path / "design.yaml") == design


def test_awkward_numbers_survive_a_file(tmp_path: Path) -> None:
    for length in (0.1 + 0.2, 5e-17, -1e-5, np.nextafter(0.95, 0)):
        design = from_dict(GarmentDesign, {"skirt": {"length": length}})
        write_design(design, tmp_path / "design.yaml")
        assert read_design(tmp_path / "design.yaml").skirt.length == length


def test_omitted_parameters_keep_their_defaults_and_bare_values_are_read(tmp_path: Path) -> None:
    file = tmp_path / "design.yaml"
    file.write_text("design:\n  meta:\n    upper: {v: Shirt}\n  shirt:\n    length: 2\n")
    design = read_design(file)
    assert (design.meta.upper, design.shirt.length) == (Upper.SHIRT, 2.0)
    assert design.pants == GarmentDesign().pants


def entry(value: Any) -> dict[str, Any]:
    """A parameter as GarmentCode writes it."""
    return {"v": value, "range": [value], "type": "float", "default_prob": 0.5}


BELT: dict[str, Any] = {"meta": {"upper": entry("Shirt"), "wb": entry(None)}, "shirt": {"length": entry(2)}}
FORMS = {
    "entries.yaml": yaml.safe_dump({"design": BELT}),
    "no_level.yml": yaml.safe_dump(BELT),
    "bom.yaml": "\ufeff" + yaml.safe_dump(BELT),
    "member.txt": '{"meta": {"upper": "Shirt", "wb": null}, "shirt": {"length": 2e0}}',
    "tabs.json": '{\n\t"design": {"meta": {"upper": "Shirt"}, "shirt": {"length": 2}}}',
    "overlay.toml": '[design.meta]\nupper = "Shirt"\nwb = "none"\n[design.shirt]\nlength = 2',
    "texts.yaml": "meta: {upper: {v: Shirt}, wb: {v: None}}\nshirt: {length: {v: '2.0'}}",
}


@pytest.mark.parametrize("name", FORMS)
def test_every_form_of_a_design_file_gives_the_same_design(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(FORMS[name])
    assert read_design(tmp_path / name) == design_from_dict(BELT) == design_from_dict({"design": BELT})
    assert design_from_dict(BELT).shirt.length == 2.0


def test_a_number_that_yaml_takes_for_a_text_is_read(tmp_path: Path) -> None:
    (tmp_path / "design.yaml").write_text('{"skirt": {"bottom_cut": {"v": 1e-05}}}')  # YAML 1.1 wants 1.0e-05
    assert read_design(tmp_path / "design.yaml").skirt.bottom_cut == 1e-5


def test_all_faults_of_a_file_are_named_at_once(tmp_path: Path) -> None:
    (tmp_path / "design.yaml").write_text("{shirt: {lenght: 1, width: 9}, pant: {}, pants: {rise: low}}")
    with pytest.raises(ConfigError) as caught:
        read_design(tmp_path / "design.yaml")
    assert str(caught.value).partition("design.yaml: ")[2] == (
        "no design parameter is called shirt.lenght: did you mean shirt.length?; "
        "no design parameter is called pant: did you mean pants?; "
        "shirt.width is 9, not a number from 1 to 1.3; pants.rise is 'low', not a number from 0.5 to 1"
    )


def test_parameters_of_other_versions_that_change_nothing_are_named_in_a_warning(
    caplog: pytest.LogCaptureFixture,
) -> None:
    tree = design_tree(design_from_dict(BELT))
    others = {
        "meta": {**tree["meta"], "connected": entry(False)},  # neutral
        "pants": {**tree["pants"], "pockets": entry(2)},  # of a garment that is not worn
        "layers-skirt": {"base": entry("SkirtCircle"), "more": {"depth": entry(0.5)}},  # of one that we lack
    }
    assert design_from_dict({**tree, **others}) == design_from_dict(BELT)
    for listed in ("meta.connected = False", "pants.pockets = 2", "layers-skirt.more.depth = 0.5"):
        assert listed in caplog.text


@pytest.mark.parametrize(
    ("others", "message"),
    [
        ({"shirt": {"openfront": entry(True)}}, r"called shirt\.openfront"),
        ({"meta": {"upper": "Shirt", "connected": entry(True)}}, r"called meta\.connected"),
        ({"level-skirt": {"base": "SkirtCircle"}}, r"level-skirt: did you mean levels-skirt\?"),
        ({"shirt": {"openfront": False}}, r"called shirt\.openfront"),  # without a range it may be misspelt
    ],
)
def test_parameters_that_may_change_the_garment_are_refused(others: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        design_from_dict({"meta": {"upper": "Shirt"}, **others})


def test_names_and_values_beyond_number_end_at_once() -> None:
    level: Any = entry(0)
    for _ in range(4):
        level = dict.fromkeys(map(str, range(1000)), level)
    many = {"meta": {"upper": [level]}, "zzz": level, **dict.fromkeys("abcdefghijklmnopq", level)}
    with pytest.raises(ConfigError, match="; and more") as caught:
        design_from_dict(many)
    assert len(str(caught.value)) < 3000
    with pytest.raises(ConfigError, match="; and more"):  # the last one may change the garment
        design_from_dict({"meta": {"upper": "Shirt"}, **dict.fromkeys(map(str, range(100)), entry(0)), "zzz": 1})


BAD = {
    "design:\n  shirt:\n    lenght: {v: 1.0}": r"is called shirt\.lenght: did you mean shirt\.length\?",
    "design:\n  pant: {}": r"no design parameter is called pant: did you mean pants\?",
    "design:\n  shirt:\n    suns: {v: 1.0}": r"called shirt\.suns: did you mean flare-skirt\.suns\?",
    "design:\n  zzz: {v: 1.0}": r"called zzz: there are meta, waistband",
    "design:\n  7: {v: 1.0}": r"called 7: there are meta",
    "design:\n  shirt:\n    length: {v: wide}": r"shirt\.length is 'wide', not a number from 0\.5 to 3\.5",
    "design:\n  shirt:\n    length: {v: .nan}": r"shirt\.length is nan, not a number",
    "design:\n  shirt:\n    length: {v: true}": r"shirt\.length is True, not a number",
    "design:\n  shirt:\n    length: {v: 9}": r"shirt\.length is 9, not a number",
    "design:\n  shirt:\n    length: {range: [0, 1]}": r"shirt\.length has no value: write it as v",
    "design:\n  shirt:\n    strapless: {v: 1}": r"shirt\.strapless is 1, not one of True, False",
    "design:\n  godet-skirt:\n    num_inserts: {v: 5}": r"num_inserts is 5, not one of 4, 6, 8, 10, 12",
    "design:\n  shirt: 5": r"shirt is 5, not a table of parameters",
    "design:\n  shirt: {v: 5}": r"no design parameter is called shirt\.v",
    "design:\n  shirt: {length: [\n": r"line \d+, column \d+: .*: correct it, or give a design file",
    "design:\n\tshirt: 5": r"line 2, column 1: .*: correct it, or give a design file",
    "design: {date: 2001-02-30}": r"day is out of range.*: correct it",
    "design: \x01": r"control characters|special characters",
    "a: 1": r"holds \['a'\], no design: give GarmentCode's design_params\.yaml",
    "": r"holds None, no design: give",
    "design: 5": r"design is 5, not a table",
    "design:\n  shirt:\n    length: {v: ''}": r"shirt\.length is '', not a number",
    "[" * 100_000 + "]" * 100_000: r"nested too deep",
}


@pytest.mark.parametrize("text", BAD, ids=lambda text: text[:40])
def test_a_bad_file_gives_one_line_with_its_name(text: str, tmp_path: Path) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=BAD[text]) as caught:
        read_design(file)
    assert str(caught.value).startswith(str(file))
    assert "\n" not in str(caught.value)


def test_a_missing_or_binary_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"missing\.yaml: no such file: give the path of a design file"):
        read_design(tmp_path / "missing.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"design: \xff\xfe")
    with pytest.raises(ConfigError, match=r"binary\.yaml: .*UTF-8|binary\.yaml: .*utf-8"):
        read_design(tmp_path / "binary.yaml")
    with pytest.raises(OutputError, match="make its folder first"):
        write_design(GarmentDesign(), tmp_path / "nowhere" / "design.yaml")


LAUGHS = "a0: &a0 {x: 1}\n" + "".join(f"a{i}: &a{i} {{x: *a{i - 1}, y: *a{i - 1}}}\n" for i in range(1, 60))


@pytest.mark.parametrize("text", ["design: &all {shirt: *all}", LAUGHS + "design: {meta: {upper: {v: *a59}}}"])
def test_yaml_that_aliases_make_endless_is_refused(text: str, tmp_path: Path) -> None:
    file = tmp_path / "loop.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match="nested too deep"):
        read_design(file)
