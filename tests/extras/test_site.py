"""The documentation builds without a warning; links and anchors are checked; its tools do what their examples say."""

import doctest
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.extras.guide import ROOT

pytest.importorskip("mkdocs", reason="mkdocs is not installed: make test-extras")
pytest.importorskip("mkdocstrings", reason="mkdocstrings is not installed: make test-extras")
READ = ("docs", "gcd_dataset", "generator", "loaders", "benchmarks/reports")


def build(tree: Path, site: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(site)]
    env = {**os.environ, "PYTHONPATH": str(tree), "NO_MKDOCS_2_WARNING": "1"}
    return subprocess.run(command, cwd=tree, env=env, capture_output=True, text=True, timeout=300, check=False)


def warnings_of(done: subprocess.CompletedProcess[str]) -> list[str]:
    """The warnings, with the lines that belong to them."""
    lines = [line for line in done.stderr.splitlines() if not line.startswith("INFO")]
    return [line for line in lines if line and not line.startswith("Aborted")]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    done = build(ROOT, folder)
    assert warnings_of(done) == []
    assert done.returncode == 0, done.stderr[-4000:]
    return folder


def test_every_page_is_built(site: Path) -> None:
    for path in (ROOT / "docs").rglob("*.md"):
        name = path.relative_to(ROOT / "docs").with_suffix("")
        page = site / name.with_suffix(".html")
        assert page.exists(), f"{name}.md has no page"


def test_files_outside_the_documents_are_pages(site: Path) -> None:
    assert 'id="words"' in (site / "project" / "architecture.html").read_text()
    assert (site / "reports" / "drapes.jpg").stat().st_size > 100_000
    assert 'href="reports/drape_sampled.html"' in (site / "limits.html").read_text()


def test_the_reference_documents_every_public_name_of_the_loaders(site: Path) -> None:
    import gcd_dataset.loaders

    page = (site / "api" / "loaders.html").read_text()
    missing = [name for name in gcd_dataset.loaders.__all__ if f'id="gcd_dataset.loaders.{name}"' not in page]
    assert missing == []


def test_doctests_are_shown_as_code(site: Path) -> None:
    for page in (site / "api").rglob("*.html"):
        assert "<blockquote>" not in page.read_text(), f"{page} shows a doctest as a quotation"


def test_pages_need_no_other_server(site: Path) -> None:
    loaded = re.compile(r'<(?:script|img|link)[^>]*(?:src|href)="(https?://[^"]+)"')
    found = {url for page in site.rglob("*.html") for url in loaded.findall(page.read_text())}
    assert found == set()


def test_the_built_pages_work_without_a_server(site: Path) -> None:
    """Opened from disk, a link to a folder shows its list of files: links lead to files."""
    link = re.compile(r'<a[^>]* href="([^"#?:]+)(?:#[^"]*)?"')
    for page in site.rglob("*.html"):
        if page.name != "404.html":  # its links begin at the root of a server
            broken = [target for target in set(link.findall(page.read_text())) if not (page.parent / target).is_file()]
            assert broken == [], page


def test_a_broken_link_and_a_missing_anchor_stop_the_build(tmp_path: Path) -> None:
    tree = tmp_path / "tree"
    for name in READ:
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copytree(ROOT / name, tree / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("mkdocs.yml", "ARCHITECTURE.md", "CHANGELOG.md", "CONTRIBUTING.md"):
        shutil.copy(ROOT / name, tree / name)
    for page in (tree / "docs" / "api").glob("*.md"):  # most of the time of a build, and read by the other one
        page.write_text("# A module\n")
    page = tree / "docs" / "limits.md"
    broken = (
        "[a](../pyproject.toml) [b](figures.md#no-such-heading) [c](nowhere.md) [d](../ARCHITECTURE.md#no-such-word)"
    )
    page.write_text(page.read_text() + f"\n{broken}\n")
    (tree / "docs" / "guides" / "forgotten.md").write_text("# In no menu\n")
    (tree / "docs" / "added.md").write_text("# An added page\n")
    done = build(tree, tmp_path / "site")
    told = "\n".join(warnings_of(done))
    assert done.returncode != 0
    for word in ("../pyproject.toml", "no-such-heading", "nowhere.md", "no-such-word", "forgotten.md"):
        assert word in told
    assert "added.md" not in told
    assert "An added page" in (tmp_path / "site" / "guides" / "train.html").read_text()


def test_examples_in_the_tools() -> None:
    from docs.tools import docstrings, hooks

    for module in (docstrings, hooks):
        result = doctest.testmod(module)
        assert result.attempted > 0
        assert result.failed == 0
