"""Design files: GarmentCode's form, read and written without loss."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from gcd_dataset.errors import ConfigError, OutputError
from gcd_dataset.generator.garments.design import OutfitDesign, Upper
from gcd_dataset.generator.garments.design_file import read_design, write_design
from gcd_dataset.generator.garments.space import draw, from_dict


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
    write_design(OutfitDesign(), tmp_path / "ours.yaml")
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
        design = draw(OutfitDesign, np.random.default_rng(seed))
        write_design(design, tmp_path / "design.yaml")
        assert read_design(tmp_path / "design.yaml") == design


def test_awkward_numbers_survive_a_file(tmp_path: Path) -> None:
    for length in (0.1 + 0.2, 5e-17, -1e-5, np.nextafter(0.95, 0)):
        design = from_dict(OutfitDesign, {"skirt": {"length": length}})
        write_design(design, tmp_path / "design.yaml")
        assert read_design(tmp_path / "design.yaml").skirt.length == length


def test_omitted_parameters_keep_their_defaults_and_bare_values_are_read(tmp_path: Path) -> None:
    file = tmp_path / "design.yaml"
    file.write_text("design:\n  meta:\n    upper: {v: Shirt}\n  shirt:\n    length: 2\n")
    design = read_design(file)
    assert (design.meta.upper, design.shirt.length) == (Upper.SHIRT, 2.0)
    assert design.pants == OutfitDesign().pants


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
    "design:\n  shirt: {length: [\n": r"line \d+, column \d+: .*: correct the YAML",
    "design:\n\tshirt: 5": r"line 2, column 1: .*: correct the YAML",
    "design: {date: 2001-02-30}": r"day is out of range.*: correct the YAML",
    "design: \x01": r"control characters|special characters",
    "a: 1": r"has no tree named design: give GarmentCode's design_params\.yaml",
    "": r"has no tree named design",
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
    with pytest.raises(ConfigError, match=r"missing\.yaml: cannot be read \(No such file or directory\): give"):
        read_design(tmp_path / "missing.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"design: \xff\xfe")
    with pytest.raises(ConfigError, match=r"binary\.yaml: byte 8 is not valid UTF-8"):
        read_design(tmp_path / "binary.yaml")
    with pytest.raises(OutputError, match="make its folder first"):
        write_design(OutfitDesign(), tmp_path / "nowhere" / "design.yaml")


LAUGHS = "a0: &a0 {x: 1}\n" + "".join(f"a{i}: &a{i} {{x: *a{i - 1}, y: *a{i - 1}}}\n" for i in range(1, 60))


@pytest.mark.parametrize("text", ["design: &all {shirt: *all}", LAUGHS + "design: {meta: {upper: {v: *a59}}}"])
def test_yaml_that_aliases_make_endless_is_refused(text: str, tmp_path: Path) -> None:
    file = tmp_path / "loop.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match="nested too deep"):
        read_design(file)
