"""The viewer in headless Chromium: move, filter, jump, predictions beside truth, and a design by hand."""

import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from http.server import ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.shards import ShardReader, ShardWriter
from gcd_dataset.spec import write_pattern
from gcd_dataset.viewer.album import ShardAlbum, spec_album
from gcd_dataset.viewer.design_desk import Desk
from gcd_dataset.viewer.server import Design, Gallery, serve

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make test-extras")
CHROMIUM = shutil.which("chromium")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on the PATH")
SOFTWARE_GL = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE_GL)
        yield browser
        browser.close()


@contextmanager
def opened(browser: Any, site: Gallery | Design) -> Iterator[Any]:
    """The site's first page; fails for errors that the browser reports."""
    found: list[Any] = []
    ready = threading.Event()

    def started(server: ThreadingHTTPServer) -> None:
        found.append(server)
        ready.set()

    options = {"show": found.append, "started": started}
    thread = threading.Thread(target=serve, args=(site,), kwargs=options, daemon=True)
    thread.start()
    assert ready.wait(30)
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    faults: list[str] = []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("dialog", lambda dialog: faults.append(dialog.message))
    page.goto(found[0])
    yield page
    page.close()
    found[1].shutdown()
    thread.join(30)
    assert not faults


def heading(page: Any, frame: int = 0) -> str:
    """The title of the garment in a frame, once it is loaded."""
    return str(page.frame_locator("iframe").nth(frame).locator("h1").inner_text())


def test_buttons_keys_filters_and_jumps_move_among_the_garments(browser: Any, tmp_path: Path) -> None:
    with ShardWriter(tmp_path, seed=0, recipe={}) as writer:
        for index in range(5):
            writer.write(replace(fake_sample(0, index), tags=("even",) if index % 2 == 0 else ("odd",)))
    with opened(browser, Gallery(ShardAlbum(ShardReader(tmp_path), "set"), 2)) as page:
        expect = sync_api.expect
        status = page.locator("#status")
        expect(status).to_have_text("3 of 5")
        assert heading(page) == "gcd_000000002"
        page.click("#next")
        expect(status).to_have_text("4 of 5")
        page.keyboard.press("ArrowLeft")
        expect(status).to_have_text("3 of 5")
        expect(page.locator("#tag")).to_be_visible()
        page.select_option("#tag", "odd")
        expect(status).to_have_text("1 of 2")
        expect(page.frame_locator("iframe").locator("h1")).to_have_text("gcd_000000001")
        page.fill("#jump", "3")
        page.press("#jump", "Enter")
        expect(status).to_have_text("2 of 2")
        page.fill("#jump", "99")
        page.press("#jump", "Enter")
        expect(page.locator("#problem")).to_contain_text("no sample '99'")


def test_a_damaged_garment_shows_its_error_and_the_next_one_opens(browser: Any, tmp_path: Path) -> None:
    write_pattern(replace(fake_sample(0, 0).pattern, name="b"), tmp_path / "b.json")
    (tmp_path / "a.json").write_text("{")
    with opened(browser, Gallery(spec_album(tmp_path))) as page:
        sync_api.expect(page.locator("#problem")).to_contain_text("a.json")
        page.click("#next")
        sync_api.expect(page.frame_locator("iframe").locator("h1")).to_have_text("b")
        sync_api.expect(page.locator("#problem")).to_be_hidden()


def test_predictions_stand_beside_the_truth(browser: Any, tmp_path: Path) -> None:
    pattern = fake_sample(0, 0).pattern
    for name, seams in (("predicted", ()), ("true", pattern.seams)):
        (tmp_path / name).mkdir()
        write_pattern(replace(pattern, seams=seams), tmp_path / name / "a.json")
    with opened(browser, Gallery(spec_album(tmp_path / "predicted", tmp_path / "true"))) as page:
        assert page.locator("#frames h2").all_inner_texts() == ["predicted", "true"]
        assert [heading(page, 0), heading(page, 1)] == ["a", "a"]
        options = [page.frame_locator("iframe").nth(k).locator("#parts option") for k in (0, 1)]
        assert options[1].count() - options[0].count() == len(pattern.seams)


def test_a_slider_redraws_the_pattern_and_a_button_drapes_it(browser: Any) -> None:
    with opened(browser, Design(Desk())) as page:
        sync_api.expect(page.locator("#fine")).to_have_text("Can be sewn and worn.")
        before = page.inner_html("#pattern")
        page.evaluate("document.querySelectorAll('details').forEach((part) => { part.open = true; })")
        slider = page.locator("[data-path='flare-skirt.length']")
        slider.evaluate("(input) => { input.value = 0.6; input.dispatchEvent(new Event('input')); }")
        page.wait_for_function("(before) => document.getElementById('pattern').innerHTML !== before", arg=before)
        page.select_option("[data-path='meta.upper']", label="none")
        page.select_option("[data-path='meta.bottom']", label="none")
        sync_api.expect(page.locator("#faults")).to_contain_text("choose meta.upper or meta.bottom")
        page.select_option("[data-path='meta.bottom']", label="Skirt2")
        page.select_option("[data-path='meta.wb']", label="StraightWB")
        page.wait_for_selector("#pattern svg")
        page.click("#drape")
        sync_api.expect(page.frame_locator("#garment").locator("h1")).to_have_text("Design", timeout=120_000)
