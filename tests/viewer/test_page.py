"""The page of a garment: its arrays decode to the mesh, its parts link up, and no text of the data becomes markup."""

import base64
import hashlib
import json
import re
import zlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gcd_dataset.generator.lay_plan import lay_out
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import Closure, EdgeRef, Sample, Seam, StoredView
from gcd_dataset.viewer.content import Content, content_of
from gcd_dataset.viewer.page import _packed, page_of
from tests.helpers import far_ball, parts, renamed
from tests.shards.folders import fake_outfit
from tests.viewer.elements import Elements

HOSTILE = '</script><b onclick="x">&amp; {{data}}'


@pytest.fixture(scope="module")
def sample() -> Sample:
    return fake_sample(3, 1, fineness=3)


@pytest.fixture(scope="module")
def content(sample: Sample) -> Content:
    return content_of(sample, far_ball())


def data_of(page: str) -> Any:
    [text] = re.findall(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    return json.loads(text)


def integers(packed: dict[str, Any]) -> np.ndarray:
    """The rows of packed integers, as the page's script decodes them."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(packed["data"])), np.uint8).reshape(packed["size"], -1)
    steps = sum(plane.astype(np.int64) << 8 * place for place, plane in enumerate(planes))
    return np.asarray(steps).reshape(-1, packed["columns"]).cumsum(axis=0) % (1 << 8 * packed["size"])


def numbers(packed: dict[str, Any]) -> np.ndarray:
    return packed["low"] + packed["step"] * integers(packed)


@pytest.mark.parametrize("largest", [0, 65535, 65536, 1 << 31])
def test_integers_survive_packing(largest: int) -> None:
    values = np.array([[3, largest], [0, 0], [largest, 7], [65535, 1]])
    assert (integers(_packed(values)) == values).all()


def test_positions_are_exact_to_the_step(content: Content) -> None:
    mesh, stored = content.mesh, data_of(page_of(content))["mesh"]
    assert mesh is not None and content.draped is not None
    for name, points in (("flat", mesh.uv), ("placed", mesh.vertices), ("draped", content.draped)):
        assert np.abs(numbers(stored[name]) - points).max() <= 0.51 * stored[name]["step"]
        assert stored[name]["step"] < 0.005  # cm
    assert (integers(stored["corners"]) == mesh.corners).all()
    assert (integers(stored["vertexOf"])[:, 0] == mesh.uv_vertex).all()


def test_both_sides_of_each_seam_are_traced(content: Content) -> None:
    """The segments of a seam are as long as its two edges; those without a seam as long as all other edges."""
    mesh, pattern, stored = content.mesh, content.pattern, data_of(page_of(content))["mesh"]
    assert mesh is not None
    segments, seams = integers(stored["segments"]), integers(stored["segmentSeam"])[:, 0]
    lengths = np.linalg.norm(np.diff(mesh.uv[segments], axis=1)[:, 0], axis=1)
    edge = {panel.name: panel.edge_lengths() for panel in pattern.panels}
    for number, seam in enumerate(pattern.seams):
        expected = sum(edge[side.panel][side.edge] for side in (seam.left, seam.right))
        assert lengths[seams == number].sum() == pytest.approx(expected, rel=1e-4)
    sewn = {side for seam in pattern.seams for side in (seam.left, seam.right)}
    free = sum(n for name, own in edge.items() for i, n in enumerate(own) if EdgeRef(name, i) not in sewn)
    assert lengths[seams == len(pattern.seams)].sum() == pytest.approx(free, rel=1e-4)


def test_panels_of_the_drawing_and_of_the_data_have_one_order(content: Content) -> None:
    page = page_of(content)
    drawn = [own["data-panel"] for _, own in Elements(page).found if "data-panel" in own]
    assert drawn == [panel["text"].split(" · ")[0] for panel in data_of(page)["panels"]]
    assert drawn == [piece.panel.name for piece in lay_out(content.pattern).panels]


def test_a_page_needs_no_other_file(content: Content) -> None:
    page = page_of(content)
    elements = Elements(page)
    assert not any(name in own for _, own in elements.found for name in ("src", "href", "srcset", "action"))
    assert "url(" not in page and "import(" not in page and "fetch(" not in page
    assert set(re.findall(r"https?://[^\s\"'<]+", page)) == {"http://www.w3.org/2000/svg"}


def test_the_policy_allows_the_page_s_own_script_alone(content: Content) -> None:
    page = page_of(content)
    [script] = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = Elements(page).attributes("meta", **{"http-equiv": "Content-Security-Policy"})["content"]
    assert policy is not None
    assert f"default-src 'none'; script-src 'sha256-{digest}'" in policy


def test_texts_of_the_data_are_escaped(sample: Sample) -> None:
    mesh, _ = parts(sample)
    pattern = replace(renamed(sample.pattern, {mesh.panel_names[0]: HOSTILE}), name=HOSTILE)
    first, *rest = pattern.panels
    pattern = replace(pattern, panels=(replace(first, label=HOSTILE), *rest))
    mesh = replace(mesh, panel_names=(HOSTILE, *mesh.panel_names[1:]))
    hostile = replace(
        sample, key=HOSTILE, pattern=pattern, box_mesh=mesh, caption=HOSTILE, tags=(HOSTILE,), design={HOSTILE: HOSTILE}
    )
    page = page_of(content_of(hostile))
    elements = Elements(page)
    assert (elements.count("script"), elements.count("b")) == (2, 0)
    assert not any(name.startswith("on") for _, own in elements.found for name in own)
    assert elements.texts.count(HOSTILE) >= 5  # title, heading, caption, tag, panel, design
    assert data_of(page)["panels"][0]["text"].startswith(HOSTILE)


def test_stored_views_are_pictures_of_the_page(sample: Sample, content: Content) -> None:
    assert sample.front
    views = content_of(replace(sample, views=(StoredView(sample.front), StoredView(sample.front)))).views
    assert Elements(page_of(replace(content, views=views))).count("img") == 2
    assert Elements(page_of(content)).count("img") == 0


def test_a_pattern_without_mesh_has_a_page_without_the_view(sample: Sample) -> None:
    page = page_of(content_of(replace(sample, box_mesh=None, drape=None, shape=None)))
    assert Elements(page).count("canvas") == 0
    assert data_of(page)["mesh"] is None


def test_a_seam_to_a_missing_edge_is_told_as_such(sample: Sample) -> None:
    first = sample.pattern.panels[0].name
    odd = Seam(EdgeRef(first, 77), EdgeRef("sleeve", 0))
    seams = data_of(page_of(Content("odd", replace(sample.pattern, seams=(odd,)))))["seams"]
    assert seams[0]["text"] == f"seam 0 · {first}, no such edge to sleeve, no such edge"
    assert seams[0]["panels"] == [0, -1]


def test_the_closure_of_a_seam_is_told(sample: Sample) -> None:
    seam = sample.pattern.seams[0]
    told = []
    for closure, closed in ((Closure.SEWN, (0.0, 1.0)), (Closure.OPEN, (0.0, 1.0)), (Closure.ZIP, (0.25, 1.0))):
        pattern = replace(sample.pattern, seams=(replace(seam, closure=closure, closed=closed),))
        told.append(data_of(page_of(Content("a", pattern)))["seams"][0]["text"])
    assert told[1:] == [f"{told[0]} · open", f"{told[0]} · zip from 25% to 100%"]


def test_stages_and_switches_are_those_of_the_content(content: Content) -> None:
    def offered(content: Content) -> tuple[list[str | None], bool, bool]:
        elements = Elements(page_of(content))
        stages = [own["data-stage"] for _, own in elements.found if "data-stage" in own]
        has_body = any(own.get("id") == "body" for _, own in elements.found)
        return stages, has_body, any(own.get("value") == "stretch" for _, own in elements.found)

    assert offered(content) == (["0", "1", "2"], True, True)
    placed = replace(content, draped=None, values={}, crossed=None, body=None)
    assert offered(placed) == (["0", "1"], False, False)
    assert data_of(page_of(placed, maps=True))["colours"] == "panels"


def test_the_layers_of_an_outfit_have_a_slider_and_their_panels(content: Content) -> None:
    page = page_of(content_of(fake_outfit(1, 3), far_ball()))
    elements = Elements(page)
    [slider] = [own for _, own in elements.found if own.get("id") == "layers"]
    assert (slider["min"], slider["max"], slider["value"]) == ("1", "3", "3")
    assert [own["data-layer"] for _, own in elements.found if "data-layer" in own] == ["1", "2", "3"]
    data = data_of(page)
    assert (data["layers"], len(data["panels"])) == ([2, 4, 6], 6)
    panels = integers(data["mesh"]["panelOf"])[integers(data["mesh"]["corners"])[:, 0], 0]
    assert (np.diff(panels // 2) >= 0).all()  # faces of outer garments come last
    assert data_of(page_of(content))["layers"] == [] and 'id="layers"' not in page_of(content)


def test_a_value_has_its_choice_its_legend_with_unit_and_range_and_its_colours(content: Content) -> None:
    assert content.mesh is not None
    height = np.linspace(0.0, 40.0, len(content.mesh.vertices))
    page = page_of(replace(content, values={"stretch": 1.0 + 0.01 * height, "gap": height}), maps=True)
    elements = Elements(page)
    assert all(elements.attributes("input", value=name) for name in ("stretch", "gap"))
    legends = re.findall(r'data-legend="(\w+)".*?<span class="ends">(.*?)</div>', page)
    marks = {name: re.findall("<span>(.*?)</span>", text) for name, text in legends}
    assert (marks["stretch"], marks["gap"]) == (["-20 %", "as cut", "+20 %"], ["0", "20 cm"])
    data = data_of(page)
    gap = data["mesh"]["values"]["gap"]
    assert (data["colours"], gap["low"], gap["high"]) == ("stretch", 0.0, 20.0)
    assert numbers(gap["of"])[:, 0] == pytest.approx(height, abs=1e-3)
    colours = integers(gap["colours"])
    assert (np.diff(colours.sum(axis=1)) <= 0).all()  # darker away from the skin


def test_the_same_content_gives_the_same_page(content: Content) -> None:
    assert page_of(content) == page_of(content)
