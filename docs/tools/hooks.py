"""Hooks of MkDocs: show files of the repository outside ``docs/`` as pages, and map links to them.

Documents link to each other as in a checkout, such as ``../ARCHITECTURE.md`` or ``../benchmarks/reports/drapes.jpg``.
``SHOWN`` files become pages or pictures of the site; a relative link to any other file outside ``docs/`` stays as it
is, and ``mkdocs build --strict`` reports it.
"""

import posixpath
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
SHOWN = {
    "ARCHITECTURE.md": "project/architecture.md",
    "CHANGELOG.md": "project/changelog.md",
    "CONTRIBUTING.md": "project/contributing.md",
}
"""File of the repository to its path in the site's sources; files of ``REPORTS`` are added."""
REPORTS = "benchmarks/reports"
MORE = "Guides"
FENCE = re.compile(r"^(?:```|~~~).*?^(?:```|~~~)[ \t]*$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"(\]\()([^)\s#]+)((?:#[^)\s]*)?(?:\s+\"[^\"]*\")?\))")


def on_config(config: Any) -> Any:
    """Add documents that the menu does not name to its section ``MORE``, under their headings."""
    named = set(_pages(config.nav))
    more = next(entry[MORE] for entry in config.nav if MORE in entry)
    more += [path.name for path in sorted(Path(config.docs_dir).glob("*.md")) if path.name not in named]
    return config


def _pages(entry: Any) -> Iterator[str]:
    """The documents that a part of the menu names.

    >>> list(_pages([{"Start": "index.md"}, {"Guides": ["guides/index.md", {"Pictures": "pictures.md"}]}]))
    ['index.md', 'guides/index.md', 'pictures.md']
    """
    if isinstance(entry, str):
        yield entry
    else:
        for part in entry.values() if isinstance(entry, dict) else entry:
            yield from _pages(part)


def on_files(files: Files, config: Any) -> Files:
    """Add the shown files."""
    for origin, path in sorted(shown_files().items()):
        files.append(File.generated(config, path, abs_src_path=str(ROOT / origin)))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """The text of a page with links to shown files as links within the site."""
    return with_site_links(markdown, page.file.src_uri)


def shown_files() -> dict[str, str]:
    """File of the repository to its path in the site's sources, for files outside ``docs/``."""
    reports = [path for path in (ROOT / REPORTS).iterdir() if path.suffix in (".md", ".jpg", ".png")]
    return SHOWN | {f"{REPORTS}/{path.name}": f"reports/{path.name}" for path in reports}


def with_site_links(markdown: str, page: str) -> str:
    """The text of ``page`` (its path in the site's sources) with its relative links mapped; code stays.

    >>> with_site_links("[layers](../ARCHITECTURE.md#layers)", "training.md")
    '[layers](project/architecture.md#layers)'
    >>> with_site_links("[scores](docs/evaluate.md)", "project/contributing.md")
    '[scores](../evaluate.md)'
    """
    site_of = shown_files()
    origin_of = {site: origin for origin, site in site_of.items()}
    origin = origin_of.get(page, f"docs/{page}")

    def mapped(match: re.Match[str]) -> str:
        target = match[2]
        if "://" in target or target.startswith(("/", "mailto:")):
            return match[0]
        file = posixpath.normpath(posixpath.join(posixpath.dirname(origin), target))
        if file.startswith("docs/"):
            site = file.removeprefix("docs/")
        elif file in site_of:
            site = site_of[file]
        else:
            return match[0]
        return f"{match[1]}{posixpath.relpath(site, posixpath.dirname(page) or '.')}{match[3]}"

    return "".join(part if is_code else LINK.sub(mapped, part) for is_code, part in _parts(markdown))


def _parts(markdown: str) -> Iterator[tuple[bool, str]]:
    """The text in parts: fenced code (``True``), and the rest."""
    end = 0
    for fence in FENCE.finditer(markdown):
        yield False, markdown[end : fence.start()]
        yield True, fence[0]
        end = fence.end()
    yield False, markdown[end:]
