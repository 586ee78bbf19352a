"""Names from files and servers before they become paths.

A name is one component of a path: it begins with a letter, a digit or ``_``, holds no slash, no control character and
no look-alike of a dot, and leaves room for the endings that files get.

>>> safe_name("rand_K3V9QX7T1B"), safe_name("../evil")
('rand_K3V9QX7T1B', '_evil-2d6afc710923')
"""

import hashlib
import re

from gcd_dataset.errors import ShardError

__all__ = ["LONGEST", "require_name", "safe_name"]

NAME = re.compile(r"\w[\w .()+-]*")
OTHERS = re.compile(r"[^\w .()+-]+")
LONGEST = 120  # bytes in UTF-8: file systems end at 255, and names get endings such as _vertex_labels.yaml
HASH = 12  # hexadecimal digits that tell names apart which look the same once they are safe


def require_name(name: object, place: str) -> str:
    """``name`` itself, of a split, a shard or a key in our formats. Raises ``ShardError`` unless it is one.

    ``place``: the file, and where in it, for the message.
    """
    if isinstance(name, str) and _is_safe(name):
        return name
    raise ShardError(
        f"{place}: {ascii(name)[:LONGEST]} cannot be a file's name: give one of letters, digits "
        f"and _ . - ( ) +, of {LONGEST} bytes at most, that begins with a letter or digit"
    )


def safe_name(name: str) -> str:
    """``name`` where it is harmless as one component of a path, else one like it: the same for the same name."""
    if _is_safe(name):
        return name
    digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:HASH]
    stem = OTHERS.sub("_", name).lstrip(" .()+-").encode()[: LONGEST - HASH - 1].decode(errors="ignore")
    return f"{stem or 'unnamed'}-{digest}"


def _is_safe(name: str) -> bool:
    return NAME.fullmatch(name) is not None and len(name.encode()) <= LONGEST
