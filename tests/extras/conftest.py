"""Marks the tests of this folder; a browser for some of them."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker("extras")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Headless Chromium that draws WebGL in software."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make test-extras")
    if (chromium := shutil.which("chromium")) is None:
        pytest.skip("there is no chromium on the PATH")
    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=flags)
        yield browser
        browser.close()
