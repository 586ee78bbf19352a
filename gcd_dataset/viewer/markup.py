"""Pieces of HTML that the page and the notebook displays share; every text of the data is escaped."""

import base64
import json
import re
from collections.abc import Iterable
from functools import cache
from html import escape
from importlib import resources
from typing import Any

from gcd_dataset.generator.lay_plan import LayPlan
from gcd_dataset.generator.svg import pattern_svg
from gcd_dataset.records import Pattern


@cache
def asset(name: str) -> str:
    """The text of a template, style or script of this package."""
    return (resources.files(__package__) / name).read_text("utf-8")


def script_data(value: Any) -> str:
    """JSON text that cannot end its script element. Raises ``ValueError`` for numbers that are not finite."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def inline_svg(pattern: Pattern, attributes: str = "", plan: LayPlan | None = None) -> str:
    """The drawing of a pattern as an ``<svg>`` element without a size of its own; ``attributes``: HTML, escaped.

    ``plan``: the pattern's ``lay_out``, where it is known.
    """
    text = pattern_svg(pattern, plan).decode()
    head, _, rest = text[text.index("<svg") :].partition(">")
    kept = head[head.index("viewBox=") :]
    return f'<svg xmlns="http://www.w3.org/2000/svg" {attributes} {kept}>{rest}'


def picture(encoded: bytes, text: str, style: str = "") -> str:
    """A JPEG or PNG as an ``<img>`` element; ``text`` describes it."""
    kind = "png" if encoded.startswith(b"\x89PNG") else "jpeg"
    content = base64.b64encode(encoded).decode()
    return f'<img alt="{escape(text)}" style="{style}" src="data:image/{kind};base64,{content}">'


def table(rows: Iterable[tuple[str, Any]], *, breaks: bool = False) -> str:
    """A table of names and values; ``breaks``: a name may be broken after a dot or an underscore."""
    lines = (f"<tr><th>{_name(str(name), breaks)}</th><td>{escape(str(value))}</td></tr>" for name, value in rows)
    return f"<table>{''.join(lines)}</table>"


def _name(text: str, breaks: bool) -> str:
    return re.sub(r"([._])(?=.)", r"\1<wbr>", escape(text)) if breaks else escape(text)
