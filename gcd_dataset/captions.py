"""The member ``caption.txt``: the captions of a garment, one level a line.

>>> text = caption_text({"short": "A skirt.", "medium": "A long skirt.", "full": "A long skirt. It has a plain hem."})
>>> read_captions(text)["medium"]
'A long skirt.'
"""

from collections.abc import Mapping

from gcd_dataset.errors import ShardError

__all__ = ["LEVELS", "caption_text", "read_captions"]

LEVELS = ("short", "medium", "full")
"""The levels of detail, in the order of the lines."""


def caption_text(captions: Mapping[str, str]) -> str:
    """Captions, by level, as one text."""
    return "\n".join(captions[level] for level in LEVELS)


def read_captions(text: str) -> dict[str, str]:
    """Level to caption, from a text by ``caption_text``. Raises ``ShardError`` for a text of other lines."""
    lines = text.split("\n")
    if len(lines) != len(LEVELS):
        raise ShardError(
            f"a caption of {len(lines)} lines, not {len(LEVELS)}, one for each of {', '.join(LEVELS)}: this data set "
            "was captioned by another program, so use its caption field as it is"
        )
    return dict(zip(LEVELS, lines, strict=True))
