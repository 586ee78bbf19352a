"""Times to drawn garments in headless Chromium."""

import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.viewing.server import PAUSE, started

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
WARM_UP = """() => {
  const context = document.createElement("canvas").getContext("webgl2");
  context.clear(context.COLOR_BUFFER_BIT);
  context.finish();
}"""
"""Starts the renderer of the browser, which serves all pages."""
LOOK = 2.0  # s between garments: a look
DRAWN = """(position) => {
  const frame = document.querySelector("iframe.shown");
  const page = frame.contentDocument;
  const asked = frame.contentWindow.location.search;
  return page && page.body && page.body.dataset.ready && asked.includes(`position=${position}&`);
}"""


@dataclass(frozen=True)
class Pictures:
    """Times to drawn garments [s]."""

    first: float
    """From the command to the first."""
    following: list[float]
    """From each click to the next, after a look of ``LOOK``."""
    hurried: list[float]
    """The same after ``PAUSE``, when the next garment is still loading."""


def pictures_of(folder: Path, index: int, environment: Mapping[str, str], count: int) -> Pictures | None:
    """Times of the garment at ``index`` and the ``count`` after it; ``None`` without Playwright or Chromium."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return None
    chromium = shutil.which("chromium")
    if chromium is None:
        return None
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.evaluate(WARM_UP)
        with started(folder, index, environment) as (address, began, _):
            page.goto(address)
            _wait(page, index)
            first = time.perf_counter() - began
            following = [_next(page, index + step, LOOK) for step in range(1, count + 1)]
            hurried = [_next(page, index + count + step, PAUSE) for step in range(1, count + 1)]
        browser.close()
    return Pictures(first, following, hurried)


def _next(page: Any, position: int, pause: float) -> float:
    time.sleep(pause)
    began = time.perf_counter()
    page.evaluate("document.getElementById('next').click()")
    _wait(page, position)
    return time.perf_counter() - began


def _wait(page: Any, position: int) -> None:
    page.wait_for_function(DRAWN, arg=position, polling=5, timeout=120_000)
