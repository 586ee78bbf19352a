"""The page of a garment in headless Chromium: both views light up together, the slider moves the mesh, keys work."""

import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest
from PIL import Image

from gcd_dataset.exports.meshes import smooth_normals
from gcd_dataset.generator.body import named_body, walk
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.meshedges import mesh_edges
from gcd_dataset.records import GarmentMotion, Panel, Pattern
from gcd_dataset.viewer.content import Content, content_of
from gcd_dataset.viewer.page import page_of
from tests.shards.folders import fake_outfit

READY = "body[data-ready]"
DRAWN = "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
"""Resolves after the picture that the page has scheduled for its next frame."""
SEAM_POINT = """(seam) => {
  const { picture } = gcdPage;
  const { ends, segmentSeam } = picture.garment;
  const { view } = picture.camera();
  const box = picture.canvas.getBoundingClientRect();
  const found = [];
  segmentSeam.forEach((own, i) => {
    if (own !== seam) return;
    const [x, y, z] = [0, 1, 2].map((k) => 0.5 * (ends[6 * i + k] + ends[6 * i + 3 + k]));
    const at = [0, 1, 3].map((r) => view[r] * x + view[4 + r] * y + view[8 + r] * z + view[12 + r]);
    found.push([box.left + (at[0] / at[2] + 1) * 0.5 * box.width, box.top + (1 - at[1] / at[2]) * 0.5 * box.height]);
  });
  return found;
}"""


@pytest.fixture(scope="module")
def content() -> Content:
    """A skirt of two panels and two seams, on a body that is thin enough for it."""
    body, _, _ = named_body("neutral")
    body = replace(body, vertices=body.vertices * [0.4, 1.0, 0.4])
    sample = fake_sample(3, 1, fineness=3)
    assert sample.box_mesh is not None
    content, gap = content_of(sample, body), np.linspace(0.0, 20.0, len(sample.box_mesh.vertices))
    values = {**content.values, "gap": gap}
    return replace(content, values=values, crossed=np.arange(12), tags=("skirt",), caption="A skirt.")


class Opened:
    """A page open in the browser, with the faults that the browser reported."""

    def __init__(self, browser: Any, content: Content, folder: Path, view: str = "", **options: Any) -> None:
        self.file = folder / "garment.html"
        self.file.write_bytes(page_of(content).encode())
        options = {"viewport": {"width": 1280, "height": 800}, "reduced_motion": "reduce", **options}
        self.page = browser.new_context(**options).new_page()
        self.faults: list[str] = []
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.on("dialog", lambda dialog: self.faults.append(dialog.message))
        self.page.on("console", lambda note: self.faults.append(note.text) if note.type == "error" else None)
        own = self.file.as_uri()
        self.page.on("request", lambda request: None if request.url.split("#")[0] == own else self.note(request.url))
        self.page.goto(f"{own}#{quote(view)}" if view else own)

    def note(self, url: str) -> None:
        if not url.startswith("blob:"):
            self.faults.append(f"request of {url}")

    def ready(self) -> "Opened":
        self.page.wait_for_selector(READY)
        return self

    @property
    def lit(self) -> str:
        return str(self.page.evaluate("document.body.dataset.lit || ''"))

    @property
    def lit_panels(self) -> list[str]:
        return list(self.page.eval_on_selector_all("[data-panel].lit", "all => all.map(g => g.dataset.panel)"))

    @property
    def lit_edges(self) -> int:
        return int(self.page.locator(".edge.lit").count())

    @property
    def positions(self) -> np.ndarray:
        return np.array(self.page.evaluate("[...gcdPage.picture.garment.positions]")).reshape(-1, 3)

    def view(self) -> np.ndarray:
        """The pixels of the 3-D view."""
        self.page.evaluate(DRAWN)
        return np.asarray(Image.open(BytesIO(self.page.locator(".stage").screenshot())).convert("RGB"), float)

    def middle(self) -> tuple[float, float]:
        box = self.page.locator("#view").bounding_box()
        return box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]


@pytest.fixture
def opening(browser: Any, tmp_path: Path) -> Iterator[Callable[..., Opened]]:
    """Opens contents in the browser, which must report no fault of any of them."""
    pages: list[Opened] = []

    def opening(content: Content, view: str = "", **options: Any) -> Opened:
        pages.append(Opened(browser, content, tmp_path, view, **options))
        return pages[-1]

    yield opening
    for opened in pages:
        opened.page.context.close()
        assert opened.faults == []


@pytest.fixture
def opened(opening: Callable[..., Opened], content: Content) -> Opened:
    return opening(content).ready()


def test_hovering_a_panel_of_the_drawing_lights_it_in_both_views(opened: Opened) -> None:
    before = opened.view()
    opened.page.locator("[data-panel=back] .cloth").hover()
    assert (opened.lit, opened.lit_panels) == ("panel:1", ["back"])
    assert opened.page.locator("#readout").inner_text().startswith("back · leg")
    after = opened.view()
    assert np.abs(after - before).max() > 40  # the front is dimmed
    opened.page.locator("h1").hover()
    assert (opened.lit, opened.lit_panels) == ("", [])
    assert np.abs(opened.view() - before).max() < 8


def test_the_paper_between_the_panels_lights_nothing(opened: Opened) -> None:
    opened.page.locator("[data-panel=back] .cloth").hover()
    box = opened.page.locator("#pattern svg").bounding_box()
    opened.page.mouse.move(box["x"] + 2, box["y"] + 2)
    assert (opened.lit, opened.lit_panels) == ("", [])


def test_hovering_a_panel_of_the_mesh_lights_it_in_the_drawing(opened: Opened) -> None:
    opened.page.mouse.move(*opened.middle())
    assert (opened.lit, opened.lit_panels) == ("panel:0", ["front"])
    opened.page.locator("h1").hover()
    assert opened.lit_panels == []


def test_hovering_a_seam_of_the_drawing_lights_both_its_edges_and_the_mesh(opened: Opened) -> None:
    box = opened.page.locator("[data-panel=front] .edge[data-seam='0']").bounding_box()
    opened.page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    assert (opened.lit, opened.lit_edges, opened.lit_panels) == ("seam:0", 2, ["front", "back"])
    accent = np.array([214, 36, 110])
    assert (np.abs(opened.view() - accent).max(axis=2) < 12).sum() > 100


@pytest.mark.parametrize("seam", [0, 1])
def test_hovering_a_seam_of_the_mesh_lights_it_in_the_drawing(opened: Opened, seam: int) -> None:
    opened.page.evaluate("yaw => { gcdPage.state.yaw = yaw; }", [1.3, -1.9][seam])  # that side to the front
    points = opened.page.evaluate(SEAM_POINT, seam)
    opened.page.mouse.move(*points[len(points) // 2])
    assert (opened.lit, opened.lit_edges) == (f"seam:{seam}", 2)


def test_the_slider_moves_the_mesh_from_flat_to_placed_to_draped(opened: Opened, content: Content) -> None:
    mesh = content.mesh
    assert mesh is not None and content.draped is not None
    assert np.abs(opened.positions - content.draped[mesh.uv_vertex]).max() < 0.01
    slider = opened.page.locator("#stage")
    slider.focus()
    slider.press("Home")
    flat = opened.positions
    assert np.ptp(flat[:, 2]) == 0.0
    for panel in (0, 1):  # shifted, neither turned nor scaled
        own = np.unique(mesh.corners[mesh.panel_id == panel])
        shift = flat[own, :2] - mesh.uv[own]
        assert np.abs(shift - shift[0]).max() < 0.01
    assert slider.get_attribute("aria-valuetext") == "laid flat"
    opened.page.get_by_role("button", name="Placed").click()
    assert np.abs(opened.positions - mesh.vertices[mesh.uv_vertex]).max() < 0.01
    slider.fill("1.5")
    between = 0.5 * (mesh.vertices + content.draped)[mesh.uv_vertex]
    assert np.abs(opened.positions - between).max() < 0.01
    assert slider.get_attribute("aria-valuetext") == "placed to draped"


def test_panels_keep_their_shape_on_the_way_to_the_body(opened: Opened, content: Content) -> None:
    """A panel turned by 180°, as the back of a skirt, must not be squashed halfway."""
    mesh = content.mesh
    assert mesh is not None
    opened.page.locator("#stage").fill("0.5")
    triangles = opened.positions[mesh.corners]
    sides = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
    flat = mesh.uv[mesh.corners]
    inside = ~np.isin(mesh.faces, mesh.seams[:, 0]).any(axis=1)  # the seams bend the faces beside them
    expected = np.linalg.norm(np.roll(flat, -1, axis=1) - flat, axis=2)
    assert np.abs(sides / expected - 1.0)[inside].max() < 0.01


def test_normals_of_coarse_cloth_are_smooth(opening: Callable[..., Opened], content: Content) -> None:
    """They turn less along an edge than the normals of the faces: else triangles show as saw teeth."""
    mesh, draped = content.mesh, content.draped
    assert mesh is not None and draped is not None
    rough = draped + np.random.default_rng(0).normal(0.0, 0.5, draped.shape)
    opened = opening(replace(content, draped=rough)).ready()
    of_corner = np.array(opened.page.evaluate("[...gcdPage.picture.garment.normals]")).reshape(-1, 3)
    shown = np.zeros_like(rough)
    shown[mesh.uv_vertex] = of_corner
    assert np.abs(shown[mesh.uv_vertex] - of_corner).max() < 1e-6  # at a seam both panels have one normal
    assert np.linalg.norm(of_corner, axis=1) == pytest.approx(1.0, abs=1e-5)
    ends = mesh_edges(mesh.faces).ends
    both = (shown, smooth_normals(rough, mesh.faces))
    turns = [np.linalg.norm(normals[ends[:, 0]] - normals[ends[:, 1]], axis=1).mean() for normals in both]
    assert turns[0] < 0.7 * turns[1]


def test_the_body_goes_and_comes_back(opened: Opened) -> None:
    with_body = opened.view()
    opened.page.get_by_label("Body").uncheck()
    assert (np.abs(opened.view() - with_body).max(axis=2) > 20).mean() > 0.05
    opened.page.get_by_label("Body").check()
    assert np.abs(opened.view() - with_body).max() < 8


@pytest.mark.parametrize("mode", ["stretch", "gap", "crossings"])
def test_colours_change_with_their_legend(opened: Opened, mode: str) -> None:
    before = opened.view()
    opened.page.locator(f"input[value={mode}]").check()
    assert opened.page.locator(f"[data-legend={mode}]").is_visible()
    assert (np.abs(opened.view() - before).max(axis=2) > 20).mean() > 0.05
    opened.page.locator("input[value=panels]").check()
    assert not opened.page.locator(f"[data-legend={mode}]").is_visible()
    assert np.abs(opened.view() - before).max() < 8


def test_drag_turns_shift_moves_wheel_zooms_and_reset_undoes_it(opened: Opened) -> None:
    def state() -> Any:
        return opened.page.evaluate("structuredClone(gcdPage.state)")

    x, y = opened.middle()
    first = opened.view()
    opened.page.mouse.move(x, y)
    opened.page.mouse.down()
    opened.page.mouse.move(x + 90, y + 20, steps=3)
    opened.page.mouse.up()
    assert state()["yaw"] < -0.5 and state()["pitch"] > 0.1
    opened.page.mouse.wheel(0, -300)
    opened.page.wait_for_function("gcdPage.state.zoom < 0.9")
    opened.page.mouse.move(x, y)
    opened.page.mouse.down(button="right")
    opened.page.mouse.move(x + 50, y, steps=3)
    opened.page.mouse.up(button="right")
    assert np.linalg.norm(state()["pan"]) > 5.0  # cm
    opened.page.get_by_role("button", name="Reset view").click()
    opened.page.locator("h1").hover()
    assert np.abs(opened.view() - first).max() < 8


def test_the_drawing_zooms_to_the_pointer_and_back(opened: Opened) -> None:
    corner = opened.page.locator("[data-panel=front] .cloth").bounding_box()
    pointer = {axis: round(corner[axis] + 5) for axis in ("x", "y")}
    opened.page.mouse.move(*pointer.values())
    for _ in range(5):
        opened.page.mouse.wheel(0, -240)
    opened.page.wait_for_selector("#pattern svg.close")  # seam numbers are legible
    near = opened.page.locator("[data-panel=front] .cloth").bounding_box()
    zoom = near["width"] / corner["width"]
    for axis, place in pointer.items():
        assert near[axis] + zoom * (place - corner[axis]) == pytest.approx(place, abs=1)  # stays under the pointer
    opened.page.locator("#pattern svg").dblclick()
    assert opened.page.locator("[data-panel=front] .cloth").bounding_box() == corner


def test_keys_reach_every_part(opened: Opened) -> None:
    page = opened.page
    page.locator("[data-panel=front]").focus()
    assert opened.lit == "panel:0"
    page.keyboard.press("ArrowRight")
    assert opened.lit == "panel:1"
    page.keyboard.press("Enter")
    page.locator("#view").focus()
    assert opened.lit == "panel:1"  # kept lit
    page.keyboard.press("ArrowRight")
    page.keyboard.press("+")
    assert page.evaluate("gcdPage.state.yaw") != 0 and page.evaluate("gcdPage.state.zoom") < 1
    page.keyboard.press("Escape")
    assert opened.lit == ""
    page.locator("#parts").select_option("seam:1")
    assert (opened.lit, opened.lit_edges) == ("seam:1", 2)


def test_two_fingers_zoom_and_one_turns(opening: Callable[..., Opened], content: Content) -> None:
    opened = opening(content, has_touch=True).ready()
    touch = opened.page.context.new_cdp_session(opened.page)
    x, y = opened.middle()

    def send(kind: str, *points: tuple[float, float]) -> None:
        places = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(points)]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": places})

    send("touchStart", (x, y))
    send("touchMove", (x + 60, y))
    send("touchEnd")
    assert opened.page.evaluate("gcdPage.state.yaw") < -0.3
    send("touchStart", (x - 40, y), (x + 40, y))
    send("touchMove", (x - 90, y), (x + 90, y))
    send("touchEnd")
    assert opened.page.evaluate("gcdPage.state.zoom") < 0.7


def test_the_scheme_follows_the_system_and_the_button(opening: Callable[..., Opened], content: Content) -> None:
    opened = opening(content, color_scheme="dark").ready()
    background = "getComputedStyle(document.body).backgroundColor"
    assert opened.page.evaluate(background) == "rgb(21, 23, 26)"
    opened.page.get_by_role("button", name="Dark").click()
    assert opened.page.evaluate(background) == "rgb(246, 245, 242)"


def test_a_hostile_name_is_shown_as_text(opening: Callable[..., Opened], content: Content) -> None:
    name = "</script><b onmouseover=\"alert(1)\">x</b><img src=x onerror='alert(2)'>"
    front: Panel = replace(content.pattern.panels[0], name=name)
    pattern = Pattern(name, (front, *content.pattern.panels[1:]), ())
    assert content.mesh is not None
    mesh = replace(content.mesh, panel_names=(name, "back"))
    hostile = replace(content, title=name, caption=name, tags=(name,), pattern=pattern, mesh=mesh)
    opened = opening(hostile).ready()
    assert opened.page.locator("h1").inner_text() == name
    opened.page.mouse.move(*opened.middle())
    assert opened.page.locator("#readout").inner_text().startswith(name)
    assert opened.page.locator("b, img").count() == 0


def test_a_garment_without_a_drape_ends_at_the_placed_panels(opening: Callable[..., Opened], content: Content) -> None:
    placed = replace(content, draped=None, values={}, crossed=None, outcome=None, body=None)
    opened = opening(placed).ready()
    assert opened.page.locator("#stage").get_attribute("max") == "1"
    assert content.mesh is not None
    assert np.abs(opened.positions - content.mesh.vertices[content.mesh.uv_vertex]).max() < 0.01


def test_a_pattern_alone_is_lit(opening: Callable[..., Opened], content: Content) -> None:
    opened = opening(Content("skirt", content.pattern))
    opened.page.locator("[data-panel=back] .cloth").hover()
    assert opened.lit_panels == ["back"]


def test_a_browser_without_webgl_says_so_and_shows_the_rest(browser: Any, content: Content, tmp_path: Path) -> None:
    flags = ["--no-sandbox", "--disable-3d-apis"]
    limited = browser.browser_type.launch(executable_path=shutil.which("chromium"), args=flags)
    opened = Opened(limited, content, tmp_path)
    opened.page.wait_for_selector("#no-view:visible")
    assert "WebGL 2" in opened.page.locator("#no-view").inner_text()
    opened.page.locator("[data-panel=back] .cloth").hover()
    assert opened.lit_panels == ["back"]
    limited.close()


@pytest.mark.parametrize(
    ("asked", "expected"),
    [
        (
            {"yaw": 0.5, "zoom": 2.0, "stage": 1, "colours": "stretch", "body": False},
            {"yaw": 0.5, "zoom": 2.0, "stage": 1},
        ),
        (
            {"yaw": "x", "zoom": 1e9, "pitch": -9, "stage": 7, "colours": "<b>", "pan": [1, None, 2]},
            {"zoom": 4, "stage": 2},
        ),
        ([], {"yaw": 0, "zoom": 1, "stage": 2}),
    ],
)
def test_the_address_asks_for_a_view(
    asked: Any, expected: dict[str, Any], opening: Callable[..., Opened], content: Content
) -> None:
    opened = opening(content, view=json.dumps(asked)).ready()
    state = opened.page.evaluate("structuredClone(gcdPage.state)")
    assert {name: state[name] for name in expected} == expected
    assert len(state["pan"]) == 3 and all(isinstance(part, int | float) for part in state["pan"])


def test_a_phone_shows_all_without_sideways_scrolling(opening: Callable[..., Opened], content: Content) -> None:
    opened = opening(content, viewport={"width": 390, "height": 800}, has_touch=True).ready()
    assert opened.page.evaluate("document.documentElement.scrollWidth") <= 390


def test_the_layers_of_an_outfit_come_off_from_the_outside(opening: Callable[..., Opened]) -> None:
    """What lies under a grid of points: panels of the garments that are left, and fewer cloth pixels at each step."""
    opened = opening(content_of(replace(fake_outfit(1, 3), shape=None))).ready()
    width, height = (opened.page.evaluate(f"gcdPage.picture.canvas.client{side}") for side in ("Width", "Height"))
    points = [[x, y] for x in range(4, width, 24) for y in range(4, height, 16)]
    found, views = [], []
    for count in (3, 2, 1):
        opened.page.locator(f"[data-layer='{count}']").click()
        assert opened.page.locator("#layers").input_value() == str(count)
        picked = opened.page.evaluate("(points) => points.map((at) => gcdPage.picture.pick(...at))", points)
        found.append([part["number"] for part in picked if part and part["kind"] == "panel"])
        assert all(part["number"] < 2 * count for part in picked if part)  # as many seams as panels
        views.append(opened.view())
    assert len(found[0]) > len(found[1]) > len(found[2]) > 0
    blank = views[0][5, 5]
    cloth = [(np.abs(view - blank).max(axis=2) > 40).sum() for view in views]
    assert cloth[0] > cloth[1] > cloth[2]


def test_the_frames_of_a_motion_play(opening: Callable[..., Opened]) -> None:
    """The slider moves cloth and body to its frame; the button plays on from there, over and over."""
    sample = fake_sample(3, 1, fineness=3)
    assert sample.box_mesh and sample.drape
    rise = 2.0 * np.arange(4)[:, None, None] * [0.0, 1.0, 0.0]
    vertices = (sample.drape.vertices + rise).astype(np.float32)
    motion = GarmentMotion(vertices, sample.box_mesh.faces, tuple(walk()[:4]), 30.0, np.zeros((4, 3), int))
    body, _, _ = named_body("neutral")
    shown = content_of(replace(sample, motion=motion), body)
    opened = opening(replace(shown, body_motion=body.vertices + rise)).ready()
    heights = "() => [gcdPage.picture.garment.positions, gcdPage.picture.body.vertices].map((all) => Math.max(...all))"
    before = opened.page.evaluate(heights)
    opened.page.locator("#motion").fill("3")
    np.testing.assert_allclose(opened.page.evaluate(heights), np.add(before, 6.0), atol=0.1)
    opened.page.locator("#play").click()
    opened.page.wait_for_selector("body[data-frame='1']")
    opened.page.locator("#play").click()
    assert opened.page.locator("#play").get_attribute("aria-pressed") == "false"
