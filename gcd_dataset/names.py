"""Names from files and servers as paths, and as the plain names of formats that hold ASCII alone.

A safe name is one component of a path: it begins with a letter, a digit or ``_``, contains no slash, control character
or look-alike of a dot, and leaves room for a file's ending.

>>> safe_name("rand_K3V9QX7T1B"), safe_name("../evil")
('rand_K3V9QX7T1B', '_evil-2d6afc710923')
"""

import hashlib
import re
import unicodedata
from collections.abc import Sequence

from gcd_dataset.errors import ShardError

NAME = re.compile(r"\w[\w .()+-]*")
OTHERS = re.compile(r"[^\w .()+-]+")
LONGEST = 120  # bytes in UTF-8: file systems allow 255, and endings such as _vertex_labels.yaml are appended
HASH = 12  # hexadecimal digits appended to a replaced name, so that different names stay different
LATIN = str.maketrans({"ß": "ss", "æ": "ae", "œ": "oe", "ø": "o", "ł": "l", "đ": "d", "ð": "d", "þ": "th", "ı": "i"})
"""Latin letters that are not a letter and an accent."""
_LETTER = re.compile(r"[A-Za-z0-9]")


def require_name(name: object, source: str) -> str:
    """``name``, the name of a split, a shard or a key in our formats. Raises ``ShardError`` unless it is safe.

    ``source``: the file, and the position in it, for the message.
    """
    if isinstance(name, str) and _is_safe(name):
        return name
    raise ShardError(
        f"{source}: {ascii(name)[:LONGEST]} cannot be a file's name: use letters, digits "
        f"and _ . - ( ) +, at most {LONGEST} bytes, beginning with a letter, a digit or _"
    )


def safe_name(name: str) -> str:
    """``name`` if it is safe as one component of a path, else a similar safe name; deterministic."""
    if _is_safe(name):
        return name
    digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:HASH]
    stem = OTHERS.sub("_", name).lstrip(" .()+-").encode()[: LONGEST - HASH - 1].decode(errors="ignore")
    return f"{stem or 'unnamed'}-{digest}"


def plain_names(names: Sequence[str], *, longest: int, stem: str = "piece") -> list[str]:
    """The names in printable ASCII, at most ``longest`` characters each, without accents.

    They differ in letters and digits, whatever their case. A name that loses letters, or would be another one's, ends
    in its number, from 1; without a letter left it begins with ``stem``.

    >>> plain_names(["Cós", "cos", "спинка", "back 后"], longest=31)
    ['Cos', 'cos_2', 'piece_3', 'back_4']
    """
    bare = [_without_accents(name) for name in names]
    plain = [" ".join(re.sub(r"[^ -~]", "", re.sub(r"\s", " ", text)).split()) for text in bare]
    whole = [p == b and len(p) <= longest and _LETTER.search(p) for p, b in zip(plain, bare, strict=True)]
    found, taken = [""] * len(names), set[str]()
    for i in sorted(range(len(names)), key=lambda i: not whole[i]):  # complete names are kept
        start = plain[i] if _LETTER.search(plain[i]) else stem
        ends = ([""] if whole[i] else []) + [f"_{i + 1 + turn * len(names)}" for turn in range(len(names) + 1)]
        tries = (start[: longest - len(end)].rstrip() + end for end in ends)
        found[i] = next(name for name in tries if _letters(name) not in taken)
        taken.add(_letters(found[i]))
    return found


def _letters(name: str) -> str:
    return re.sub(r"[^A-Z0-9]", "_", name.upper())


def _without_accents(text: str) -> str:
    text = "".join(c.lower().translate(LATIN).upper() if c.isupper() else c.translate(LATIN) for c in text)
    decomposed = unicodedata.normalize("NFKD", text)
    return "".join(letter for letter in decomposed if not unicodedata.combining(letter))


def _is_safe(name: str) -> bool:
    return NAME.fullmatch(name) is not None and len(name.encode()) <= LONGEST
