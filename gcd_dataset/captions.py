"""The member ``caption.txt``: the captions of a garment, one level a line, after its name: ``short: A skirt.``

>>> text = caption_text({"short": "A skirt.", "medium": "A long skirt.", "full": "A long skirt. It has a plain hem."})
>>> read_captions(text)["medium"]
'A long skirt.'
"""

from collections.abc import Mapping, Sequence

from gcd_dataset.errors import ShardError

__all__ = ["LEVELS", "caption_text", "outfit_captions", "read_captions"]

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


def outfit_captions(
    own: Sequence[Mapping[str, str]], *, tucked: Sequence[bool], closed: Sequence[bool]
) -> dict[str, str]:
    """Level to caption of an outfit, from the captions of its garments, from the skin outwards.

    The short one is one sentence; the others name the garments in turn.

    >>> shirt, skirt = ({level: f"A plain {noun}." for level in LEVELS} for noun in ("shirt", "skirt"))
    >>> outfit_captions([shirt, skirt], tucked=[True, False], closed=[True, True])["short"]
    'A plain shirt tucked into a plain skirt.'
    >>> outfit_captions([shirt, skirt], tucked=[False, False], closed=[True, False])["full"]
    'A plain shirt. Over it, worn open, a plain skirt.'
    """
    short, longer = own[0]["short"].rstrip("."), {level: own[0][level] for level in LEVELS[1:]}
    for number, captions in enumerate(own[1:], 1):
        said = {level: text[:1].lower() + text[1:] for level, text in captions.items()}
        way = "" if closed[number] else " worn open"
        short += f" {'tucked into' if tucked[number - 1] else 'under'} {said['short'].rstrip('.')}{way}"
        place = "It is tucked into" if tucked[number - 1] else f"Over it,{f'{way},' if way else ''}"
        longer = {level: f"{text} {place} {said[level]}" for level, text in longer.items()}
    return {LEVELS[0]: f"{short}.", **longer}
