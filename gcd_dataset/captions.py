"""The member ``caption.txt``: the captions of a garment, one level a line, after its name: ``short: A skirt.``

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
    return "\n".join(f"{level}: {captions[level]}" for level in LEVELS)


def read_captions(text: str) -> dict[str, str]:
    """Level to caption, from a text by ``caption_text``. Raises ``ShardError`` for a text of other lines."""
    lines = [line.partition(": ") for line in text.split("\n")]
    if tuple(level for level, _, _ in lines) != LEVELS:
        raise ShardError(
            f"a caption whose lines do not begin with {', '.join(f'{level}:' for level in LEVELS)}: this data set was "
            "captioned by another program, so use its caption field as it is"
        )
    return {level: said for level, _, said in lines}
