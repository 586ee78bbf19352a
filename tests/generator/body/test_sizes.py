"""Size charts: borders of sizes, steps, bodies; charts of users and their faults."""

import contextlib
import re
import tomllib
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from gcd_dataset.errors import BodyError, ConfigError
from gcd_dataset.generator import SizeChart, make_person, read_chart
from gcd_dataset.generator.body.sizes import CHARTS
from gcd_dataset.measurements import MEASURES
from tools.body_model.sizes import chart_text

DECIDING = ("bust", "waist", "hips")
BUST_ONLY = """
[sizes.S]
fits = {{ bust = {small} }}
body = {{ {body}bust = 84 }}
[sizes.M]
fits = {{ bust = {large} }}
body = {{ {body}bust = 88 }}
"""


@pytest.fixture(params=CHARTS)
def chart(request: pytest.FixtureRequest) -> SizeChart:
    return read_chart(request.param)


def test_sizes_are_four_centimetres_apart_and_their_bodies_belong_to_them(chart: SizeChart) -> None:
    for size, body in chart.bodies.items():
        assert chart.size_of(body) == size
    for small, large in pairwise(chart.bodies.values()):
        assert all(getattr(large, name) - getattr(small, name) == 4.0 for name in DECIDING)
        assert not any(np.isnan(getattr(small, name)) for name in MEASURES)


def test_a_measure_at_a_border_belongs_to_the_larger_size(chart: SizeChart) -> None:
    for name in DECIDING:
        for (small, large), border in zip(pairwise(chart.bodies), chart.limits[name][1:-1], strict=True):
            body = chart.body(small)
            assert chart.size_of(replace(body, **{name: np.nextafter(border, 0.0)})) == small
            assert chart.size_of(replace(body, **{name: border})) == large


def test_the_largest_measure_decides(chart: SizeChart) -> None:
    small, *_, large = chart.bodies
    for name in DECIDING:
        wide = replace(chart.body(small), **{name: getattr(chart.body(large), name)})
        assert chart.size_of(wide) == large
        assert chart.size_of(replace(chart.body(large), **{name: 1.0})) == large


def test_most_adults_find_a_size_whose_girths_are_at_least_theirs() -> None:
    found = 0
    for sex, name in (("female", "women"), ("male", "men")):
        chart = read_chart(name)
        for index in range(20):
            person = make_person(5, index, bodies=sex).measurements
            with contextlib.suppress(BodyError):
                body = chart.body(chart.size_of(person))
                assert all(getattr(person, girth) < getattr(body, girth) + 2.0 for girth in DECIDING)
                found += 1
    assert found >= 38


def test_misfits_move_along_the_chart(chart: SizeChart) -> None:
    sizes = list(chart.bodies)
    assert [chart.moved(sizes[3], steps) for steps in range(-3, 4)] == sizes[:7]
    with pytest.raises(ConfigError, match=rf"size {sizes[1]} -2: the chart ends at {sizes[0]}: give -1 to 10"):
        chart.moved(sizes[1], -2)
    with pytest.raises(ConfigError, match=rf"size {sizes[-1]} \+1: the chart ends at {sizes[-1]}: give -11 to 0"):
        chart.moved(sizes[-1], 1)


def test_a_body_beyond_the_chart_and_an_unknown_size_are_named(chart: SizeChart) -> None:
    small, *_, large = chart.bodies
    tiny = replace(chart.body(small), bust=40.0, waist=40.0, hips=40.0)
    with pytest.raises(BodyError, match=rf"toml: a body with bust 40\.0 cm, .* is smaller than size {small}: add a"):
        chart.size_of(tiny)
    with pytest.raises(BodyError, match=rf"is larger than size {large}: add a size"):
        chart.size_of(replace(tiny, hips=chart.limits["hips"][-1]))
    with pytest.raises(BodyError, match="measures waist are missing"):
        chart.size_of(replace(tiny, waist=np.nan))
    with pytest.raises(ConfigError, match=rf"toml: no size 3XL: choose from {small}, "):
        chart.body("3XL")
    with pytest.raises(ConfigError, match="no size 3XL"):
        chart.moved("3XL", 0)


def test_the_charts_are_made_by_regression_on_the_girths() -> None:
    """People whose measures are linear in bust, waist and hips get a chart on the same lines."""
    rng = np.random.default_rng(0)
    bust = rng.normal(97.0, 8.0, 200)
    girths = np.stack([bust, 0.5 * bust + 33.2 + rng.normal(0, 2, 200), bust + 7.4 + rng.normal(0, 2, 200)], axis=1)
    people = np.stack([girths @ np.full(3, 0.1 * place) + 1 for place in range(1, len(MEASURES) + 1)], axis=1)
    people[:, [MEASURES.index(name) for name in DECIDING]] = girths
    middle = tomllib.loads(chart_text(people))["sizes"]["96"]["body"]
    assert [middle[name] for name in DECIDING] == pytest.approx([96.0, 81.0, 103.0], abs=1.0)
    assert middle["height"] == pytest.approx(0.1 * sum(middle[name] for name in DECIDING) + 1, abs=0.051)


def written(folder: Path, *, small: str = "[82, 86]", large: str = "[86, 90]", body: str | None = None) -> Path:
    values = read_chart("women").body("84").to_file_values()
    del values["bust"]
    given = "".join(f"{name} = {value}, " for name, value in values.items()) if body is None else body
    path = folder / "own.toml"
    path.write_text(BUST_ONLY.format(small=small, large=large, body=given))
    return path


def test_a_chart_of_a_user_may_decide_by_one_measure(tmp_path: Path) -> None:
    chart = read_chart(written(tmp_path))
    assert chart.limits == {"bust": (82.0, 86.0, 90.0)}
    assert chart.size_of(replace(chart.body("S"), bust=86.0, waist=200.0)) == "M"


def test_a_size_without_a_name_is_a_size(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_text(path.read_text().replace("[sizes.M]", '[sizes.""]'))
    chart = read_chart(path)
    assert chart.size_of(chart.body("")) == ""


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"large": "[87, 90]"}, "size M: fits.bust begins at 87 cm, size S ends at 86 cm: a hole: begin at 86"),
        ({"large": "[85, 90]"}, "size M: fits.bust begins at 85 cm, size S ends at 86 cm: an overlap: begin at 86"),
        ({"large": "[90, 86]"}, "size M: fits.bust is [90, 86]: give two lengths in cm, the smaller first"),
        ({"large": "[86, inf]"}, "size M: fits.bust is [86, inf]: give two lengths in cm"),
        ({"large": "86"}, "size M: fits.bust is 86: give two lengths in cm"),
        ({"large": "[86, 90], waist = [66, 70]"}, "size M: fits has waist, unlike size S: give all sizes the same"),
        ({"small": "[82, 86], hips = [80, 99]"}, "size M: fits lacks hips, unlike size S: give all sizes the same"),
        ({"small": "[70, 84]", "large": "[84, 90]"}, "size S: body.bust is 84, but it fits 70 to 84 cm: correct one"),
        ({"small": "[82, 86], bus = [1, 2]"}, "size S: fits has bus, no measure in cm: did you mean bust?"),
        ({"body": "height = 160, "}, "size S: body lacks head_l, neck_w"),
        ({"body": "height = -1, "}, "size S: body.height is -1: give a positive number of centimetres"),
    ],
)
def test_faults_name_file_and_size(changes: dict[str, str], message: str, tmp_path: Path) -> None:
    path = written(tmp_path, **changes)
    with pytest.raises(ConfigError, match=re.escape(f"{path}: {message}")):
        read_chart(path)


@pytest.mark.parametrize(
    ("measure", "given", "message"),
    [
        ("waist_back_width", 95.5, "waist_back_width is 95.5 cm, and waist is 70.0 cm"),
        ("leg_circ", 91.0, "leg_circ is 91.0 cm, and hips is 91.0 cm"),
        ("hips_line", 118.0, "head_l + waist_line + hips_line + crotch_hip_diff is "),
    ],
)
def test_a_body_whose_parts_exceed_the_whole_is_named(measure: str, given: float, message: str, tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_text(re.sub(rf"\b{measure} = [\d.]+, ", f"{measure} = {given}, ", path.read_text(), count=1))
    with pytest.raises(ConfigError, match=re.escape(f"{path}: size S: body: {message}")):
        read_chart(path)


def test_a_size_has_all_measures_and_a_chart_has_sizes(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_text(re.sub(r"vert_bust_line = [\d.]+, ", "", path.read_text(), count=1))
    with pytest.raises(ConfigError, match="size S: body lacks vert_bust_line: a size has all measures: add them"):
        read_chart(path)
    for text, message in (
        ("", "own.toml: no sizes: give each a table"),
        ("[sizes.S]\nfits = 3", "own.toml: size S: give it two tables, fits and body"),
        ("[sizes", "own.toml: "),
    ):
        path.write_text(text)
        with pytest.raises(ConfigError, match=re.escape(message)):
            read_chart(path)
    with pytest.raises(ConfigError, match="no chart woman: there are women, men, or a TOML file: did you mean women"):
        read_chart("woman")
