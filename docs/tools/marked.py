"""Generated parts of documents: text between two marks, written anew by a program.

<!-- NAME: begin (python -m docs.tools.tables) -->
generated text
<!-- NAME: end -->
"""

import re

PART = re.compile(r"(<!-- (?P<name>[\w-]+): begin[^>]*-->\n)(?P<text>.*?)(<!-- (?P=name): end -->)", re.DOTALL)


def marked_names(document: str) -> list[str]:
    """The names of the parts, in order.

    >>> marked_names("<!-- sizes: begin -->\\nold\\n<!-- sizes: end -->\\n")
    ['sizes']
    """
    return [match["name"] for match in PART.finditer(document)]


def with_parts(document: str, parts: dict[str, str]) -> str:
    """The document with the text of each part replaced. Raises ``KeyError`` for a part that ``parts`` lacks.

    >>> print(with_parts("<!-- sizes: begin -->\\nold\\n<!-- sizes: end -->", {"sizes": "new"}))
    <!-- sizes: begin -->
    <BLANKLINE>
    new
    <BLANKLINE>
    <!-- sizes: end -->
    """
    return PART.sub(lambda match: f"{match[1]}\n{parts[match['name']]}\n\n{match[4]}", document)
