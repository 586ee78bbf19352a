"""The viewer in headless Chromium: move, filter, jump, hover, and predictions beside truth."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.records import Grade, Outcome
from gcd_dataset.shards import ShardReader, ShardWriter
from gcd_dataset.spec import write_pattern
from gcd_dataset.viewer.garments import ShardAlbum, spec_album
from gcd_dataset.viewer.server import Gallery
from tests.helpers import renamed
from tests.release.published import publish
from tests.viewer.test_album import album_of
from tests.viewer.test_server import Running

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make test-extras")
VIEW = ("yaw", "pitch", "zoom", "pan", "stage", "colours", "body")


@contextmanager
def opened(browser: Any, site: Gallery) -> Iterator[Any]:
    """The site's first page; fails for errors that the browser reports."""
    running = Running(site)
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    faults: list[str] = []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("dialog", lambda dialog: faults.append(dialog.message))
    page.goto(running.address)
    yield page
    page.close()
    running.close()
    assert not faults


def heading(page: Any, frame: int = 0) -> str:
    """The title of the garment in a frame, once it is loaded."""
    return str(page.frame_locator("iframe.shown").nth(frame).locator("h1").inner_text())


def frame(page: Any, number: int = 0) -> Any:
    """The frame of a garment, once its 3-D view is drawn."""
    page.frame_locator("iframe.shown").nth(number).locator("body[data-ready]").wait_for()
    return page.locator("iframe.shown").nth(number).element_handle().content_frame()


def lit(frame: Any) -> str:
    """The part that is lit in a frame."""
    return str(frame.evaluate("document.body.dataset.lit || ''"))


@pytest.fixture(scope="module")
def garments(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five garments: even ones are skirts, odd ones dresses; 3 and 4 failed, 4 slid off."""
    folder = tmp_path_factory.mktemp("garments")
    with ShardWriter(folder, seed=0, recipe={}) as writer:
        for index in range(5):
            sample = replace(fake_sample(0, index), tags=("skirt", "mini") if index % 2 == 0 else ("dress",))
            assert sample.drape is not None
            outcome = Outcome.SLID_OFF if index == 4 else Outcome.SETTLED
            grade = Grade.FAILED if index > 2 else Grade.CLEAN
            writer.write(replace(sample, grade=grade, drape=replace(sample.drape, outcome=outcome)))
    return folder


def test_buttons_keys_filters_and_jumps_move_among_the_garments(browser: Any, garments: Path) -> None:
    with opened(browser, Gallery(ShardAlbum(ShardReader(garments), "set"), 2)) as page:
        expect = sync_api.expect
        status = page.locator("#status")
        expect(status).to_have_text("3 of 5")
        assert heading(page) == "gcd_000000002"
        page.click("#next")
        expect(status).to_have_text("4 of 5")
        page.keyboard.press("ArrowLeft")
        expect(status).to_have_text("3 of 5")
        page.wait_for_selector("#kind option[value=dress]", state="attached")
        page.select_option("#kind", "dress")
        expect(status).to_have_text("1 of 2")
        expect(page.frame_locator("iframe.shown").locator("h1")).to_have_text("gcd_000000001")
        page.fill("#jump", "3")
        page.press("#jump", "Enter")
        expect(status).to_have_text("2 of 2")
        page.fill("#jump", "99")
        page.press("#jump", "Enter")
        expect(page.locator("#problem")).to_contain_text("no sample '99'")


def test_kind_and_outcome_are_two_menus_that_combine(browser: Any, garments: Path) -> None:
    with opened(browser, Gallery(ShardAlbum(ShardReader(garments), "set"))) as page:
        expect = sync_api.expect
        page.wait_for_selector("#kind option[value=dress]", state="attached")
        groups = {"#kind": ["Garment", "Style"], "#outcome": ["Grade", "Outcome"]}
        for menu, labels in groups.items():
            assert page.eval_on_selector_all(f"{menu} optgroup", "all => all.map(g => g.label)") == labels
        page.select_option("#outcome", "grade:failed")
        expect(page.locator("#status")).to_have_text("1 of 2")
        page.select_option("#kind", "skirt")
        expect(page.locator("#status")).to_have_text("1 of 1")
        expect(page.frame_locator("iframe.shown").locator("h1")).to_have_text("gcd_000000004")
        page.select_option("#outcome", "outcome:slid off")
        expect(page.locator("#status")).to_have_text("1 of 1")
        page.select_option("#kind", "dress")
        expect(page.locator("#problem")).to_have_text("No garment has this kind and outcome.")
        page.select_option("#outcome", "")
        expect(page.locator("#status")).to_have_text("1 of 2")


def test_hover_lights_both_views_and_the_view_stays_at_the_next_garment(browser: Any, garments: Path) -> None:
    with opened(browser, Gallery(ShardAlbum(ShardReader(garments), "set"))) as page:
        first = frame(page)
        first.locator("[data-panel=back] .cloth").hover()
        assert lit(first) == "panel:1"
        box = first.locator("#view").bounding_box()
        x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
        page.mouse.move(x, y)
        assert lit(first) == "panel:0"
        assert first.eval_on_selector_all("[data-panel].lit", "all => all.map(g => g.dataset.panel)") == ["front"]
        page.mouse.down()
        page.mouse.move(x + 80, y, steps=3)
        page.mouse.up()
        first.locator("input[value=stretch]").check()
        first.locator("#stage").fill("1.25")
        first.locator("#scheme").click()
        view = first.evaluate("structuredClone(gcdPage.state)")
        assert view["yaw"] < -0.5
        page.click("#next")
        sync_api.expect(page.frame_locator("iframe.shown").locator("h1")).to_have_text("gcd_000000001")
        after = frame(page).evaluate("structuredClone(gcdPage.state)")
        assert {name: after[name] for name in VIEW} == {name: view[name] for name in VIEW}
        schemes = [where.evaluate("document.documentElement.dataset.scheme") for where in (page, frame(page))]
        assert schemes == ["dark", "dark"]


def test_the_next_garment_is_drawn_before_it_is_asked_for(browser: Any, garments: Path) -> None:
    spare = "document.querySelector('iframe.spare')"
    with opened(browser, Gallery(ShardAlbum(ShardReader(garments), "set"), 1)) as page:
        for button, shown, ahead in (("#next", 2, 3), ("#next", 3, 4), ("#previous", 2, 1)):
            frame(page)
            page.wait_for_function(f"() => {spare}.contentWindow.gcdPage?.isReady")
            page.evaluate(f"() => {{ {spare}.contentWindow.loadedBefore = {shown}; }}")
            page.click(button)
            sync_api.expect(page.frame_locator("iframe.shown").locator("h1")).to_have_text(f"gcd_{shown:09}")
            loaded = frame(page).evaluate("window.loadedBefore")
            assert loaded == (shown if button == "#next" else None)  # the first step back is not foreseen
            frame(page).evaluate("gcdPage.setStage(1)")
            name = f"gcd_{ahead:09}"
            page.wait_for_function(f"() => {spare}.contentDocument.querySelector('h1')?.innerText === '{name}'")
        assert page.locator("iframe.shown").count() == page.locator("iframe.spare").count() == 1
        assert frame(page).evaluate("gcdPage.state.stage") == 1.0


def test_published_data_opens_by_its_folder(browser: Any, tmp_path: Path) -> None:
    root = publish(tmp_path)
    with opened(browser, Gallery(album_of(root))) as page:
        expect = sync_api.expect
        expect(page.locator("#status")).to_have_text("1 of 4")
        assert frame(page).locator("[data-panel]").count() == 2
        page.wait_for_selector("#kind option[value='random body']", state="attached")
        page.select_option("#kind", "random body")
        expect(page.locator("#status")).to_have_text("1 of 2")
        expect(page.frame_locator("iframe.shown").locator(".tables")).to_contain_text(
            "missing, so the body is left out"
        )


def test_a_damaged_garment_shows_its_error_and_the_next_one_opens(browser: Any, tmp_path: Path) -> None:
    write_pattern(replace(fake_sample(0, 0).pattern, name="b"), tmp_path / "b.json")
    (tmp_path / "a.json").write_text("{")
    with opened(browser, Gallery(spec_album(tmp_path))) as page:
        sync_api.expect(page.locator("#problem")).to_contain_text("a.json")
        shown = page.frame_locator("iframe.shown").locator("body")
        sync_api.expect(shown).to_have_text("This garment cannot be shown.")
        shown.click()
        page.keyboard.press("ArrowRight")
        sync_api.expect(page.frame_locator("iframe.shown").locator("h1")).to_have_text("b")
        sync_api.expect(page.locator("#problem")).to_be_hidden()
        assert heading(page) == "b"


def test_fast_steps_add_up(browser: Any, garments: Path) -> None:
    """Three clicks before the first is answered."""
    with opened(browser, Gallery(ShardAlbum(ShardReader(garments), "set"))) as page:
        sync_api.expect(page.locator("#status")).to_have_text("1 of 5")
        page.evaluate("for (const name of ['next', 'next', 'next', 'previous']) document.getElementById(name).click()")
        sync_api.expect(page.locator("#status")).to_have_text("3 of 5")
        assert heading(page) == "gcd_000000002"


def test_a_reload_shows_the_same_garment(browser: Any, garments: Path) -> None:
    with opened(browser, Gallery(ShardAlbum(ShardReader(garments), "set"), 2)) as page:
        frame(page)  # a busy machine takes seconds for the first garment
        page.click("#next")
        sync_api.expect(page.locator("#status")).to_have_text("4 of 5")
        page.reload()
        sync_api.expect(page.locator("#status")).to_have_text("4 of 5")
        assert heading(page) == "gcd_000000003"


def test_at_1400_by_900_nothing_scrolls_and_a_bar_shows_the_scale(browser: Any, garments: Path) -> None:
    """A panel's width in the drawing, by the bar, is its width in centimetres."""
    overflow = (
        "document.documentElement.scrollHeight > innerHeight || document.documentElement.scrollWidth > innerWidth"
    )
    with opened(browser, Gallery(ShardAlbum(ShardReader(garments), "set"))) as page:
        page.set_viewport_size({"width": 1400, "height": 900})
        inner = frame(page)
        assert not page.evaluate(overflow) and not inner.evaluate(overflow)
        assert inner.locator(".tables").is_visible()
        lengths = [float(inner.inner_text(f"#{name}-scale").removesuffix(" cm")) for name in ("pattern", "view")]
        widths = [inner.locator(f"#{name}-scale").bounding_box()["width"] for name in ("pattern", "view")]
        assert all(length > 0 and 40 < width <= 120 for length, width in zip(lengths, widths, strict=True))
        panel = ShardReader(garments).sample(0).pattern.panels[0]
        cloth = inner.locator(f"[data-panel='{panel.name}'] .cloth").bounding_box()["width"]
        assert cloth / widths[0] * lengths[0] == pytest.approx(np.ptp(panel.vertices[:, 0]), rel=0.05)
        inner.locator("#view").focus()
        page.keyboard.press("+")
        page.keyboard.press("+")
        page.wait_for_timeout(300)
        closer = inner.locator("#view-scale").bounding_box()["width"] / float(
            inner.inner_text("#view-scale").split()[0]
        )
        assert closer == pytest.approx(widths[1] / lengths[1] / 0.88**2, rel=0.1)


def test_a_page_without_its_server_says_how_to_go_on(browser: Any, garments: Path) -> None:
    with opened(browser, Gallery(ShardAlbum(ShardReader(garments), "set"))) as page:
        frame(page)
        page.route("**/find?*", lambda route: route.abort("connectionrefused"))
        page.click("#next")
        sync_api.expect(page.locator("#problem")).to_contain_text("start gcd show again")


def test_ctrl_c_ends_the_viewer_of_a_server_that_does_not_answer(garments: Path) -> None:
    """The server sends manifest and index, and then nothing."""
    asked, ended = threading.Event(), threading.Event()

    class Handler(SimpleHTTPRequestHandler):
        def __init__(self, *args: Any) -> None:
            super().__init__(*args, directory=str(garments))

        def do_GET(self) -> None:
            if self.path.endswith(".tar"):
                asked.set()
                ended.wait(120)
            else:
                super().do_GET()

        def log_message(self, *args: Any) -> None:
            """Requests are not printed."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    command = [sys.executable, "-m", "gcd_dataset", "show", f"http://127.0.0.1:{server.server_port}"]
    env = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env) as process:
        try:
            assert process.stdout is not None and "Ctrl-C" in process.stdout.readline()
            assert asked.wait(60)
            process.send_signal(signal.SIGINT)
            assert process.wait(30) == 0
            assert process.stderr is not None and process.stderr.read() == ""
        finally:
            process.kill()
            ended.set()
            server.shutdown()
            server.server_close()


def test_predictions_beside_the_truth_light_up_with_their_matches(browser: Any, tmp_path: Path) -> None:
    """The prediction has the panels in another order, under other names, and lacks the first seam."""
    true = fake_sample(0, 0).pattern
    other = renamed(true, {panel.name: f"predicted {panel.name}" for panel in true.panels})
    predicted = replace(other, panels=other.panels[::-1], seams=other.seams[1:])
    for name, pattern in (("predicted", predicted), ("true", true)):
        (tmp_path / name).mkdir()
        for key in ("a", "b"):
            write_pattern(replace(pattern, name=key), tmp_path / name / f"{key}.json")
    with opened(browser, Gallery(spec_album(tmp_path / "predicted", tmp_path / "true"))) as page:
        assert [text.split("\n")[0] for text in page.locator("#frames h2").all_inner_texts()] == ["predicted", "true"]
        one, other = frame(page, 0), frame(page, 1)
        page.wait_for_function("links !== null")
        one.locator("[data-panel='predicted back'] .cloth").hover()
        assert (lit(one), lit(other)) == ("panel:0", "panel:1")
        assert page.inner_text("#match") == "matched panel, outlines overlap by 100 %"
        fills = [
            where.locator(f"[data-panel='{name}'] .cloth").evaluate("path => getComputedStyle(path).fill")
            for where, name in ((one, "predicted back"), (other, "back"))
        ]
        assert fills[0] == fills[1]
        other.locator("#parts").select_option("seam:1")
        assert (lit(one), lit(other)) == ("seam:0", "seam:1")
        other.locator("#parts").select_option("seam:0")
        assert (lit(one), lit(other)) == ("", "seam:0")
        assert page.inner_text("#match") == "no matching seam"
        one.locator("#view").focus()
        page.keyboard.press("ArrowRight")
        yaws = [where.evaluate("gcdPage.state.yaw") for where in (one, other)]
        assert yaws[0] == yaws[1] != 0
        page.click("#next")
        sync_api.expect(page.frame_locator("iframe.shown").nth(1).locator("h1")).to_have_text("b")
        assert [frame(page, side).evaluate("gcdPage.state.yaw") for side in (0, 1)] == yaws
