"""Extension of griffe: docstrings as Markdown. Doctests, tables and trees in them become fenced code."""

import re
from typing import Any

import griffe

RULE = re.compile(r"^=+( +=+)+$")
TREE = re.compile(r"[├└│◄►─]")


class AsMarkdown(griffe.Extension):
    """Rewrites every docstring that griffe has read."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Called for each module, class, function and attribute."""
        if obj.docstring:
            obj.docstring.value = as_markdown(obj.docstring.value)


def as_markdown(text: str) -> str:
    """The docstring with fences round doctests, tables and trees.

    >>> as_markdown("One.\\n\\n>>> 1\\n1").splitlines()
    ['One.', '', '```pycon', '>>> 1', '1', '```']
    """
    parts = [_fenced(part) for part in _paragraphs(text)]
    return "\n\n".join(parts)


def _paragraphs(text: str) -> list[str]:
    """The paragraphs; a table is one, blank lines included."""
    found: list[str] = []
    lines: list[str] = []
    rules = 0
    for line in text.splitlines():
        rules += bool(RULE.match(line.strip()))
        if line.strip() or rules % 3:
            lines.append(line)
        elif lines:
            found.append("\n".join(lines))
            lines = []
    return [*found, "\n".join(lines)] if lines else found


def _fenced(part: str) -> str:
    lines = part.splitlines()
    if lines[0].lstrip().startswith(">>>"):
        return f"```pycon\n{part}\n```"
    if RULE.match(lines[0].strip()) or TREE.search(part):
        return f"```text\n{part}\n```"
    return part
