"""Checks on names from files and servers before they become paths.

A safe name is one component of a path: it begins with a letter, a digit or ``_``, contains no slash, control character
or look-alike of a dot, and leaves room for a file's ending.

>>> safe_name("rand_K3V9QX7T1B"), safe_name("../evil")
('rand_K3V9QX7T1B', '_evil-2d6afc710923')
"""

import hashlib
import re

from gcd_dataset.errors import ShardError

__all__ = ["LONGEST", "require_name", "safe_name"]

NAME = re.compile(r"\w[\w .()+-]*")
OTHERS = re.compile(r"[^\w .()+-]+")
LONGEST = 120  # bytes in UTF-8: file systems allow 255, and endings such as _vertex_labels.yaml are appended
HASH = 12  # hexadecimal digits appended to a replaced name, so that different names stay different


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


def _is_safe(name: str) -> bool:
    return NAME.fullmatch(name) is not None and len(name.encode()) <= LONGEST
