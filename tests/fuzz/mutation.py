"""Damage to files: the bytes of a file changed at random places, repeatably."""

import random
import re
import struct

EXTREME_INTEGERS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**32 - 1, 2**63 - 1, 2**64 - 1)
EXTREME_TEXTS = (
    b"-1", b"0", b"1e400", b"-1e400", b"NaN", b"1e-320", b"9" * 25, b"9" * 5000, b"null", b'""', b"[]", b"{}", b"true",
    b"[" * 3000, b'"../../x"', b'"\\u0000"', b"'a'",
)  # fmt: skip
NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
MOST_EDITS = 3


def mutated(content: bytes, chance: random.Random) -> bytes:
    """The content after one to three random edits: bits, ranges, integers and numbers in text."""
    for _ in range(chance.randint(1, MOST_EDITS)):
        content = chance.choice(EDITS)(content, chance)
    return content


def _flip_bit(content: bytes, chance: random.Random) -> bytes:
    if not content:
        return content
    at = chance.randrange(len(content))
    return content[:at] + bytes([content[at] ^ 1 << chance.randrange(8)]) + content[at + 1 :]


def _overwrite_byte(content: bytes, chance: random.Random) -> bytes:
    if not content:
        return content
    at = chance.randrange(len(content))
    return content[:at] + bytes([chance.randrange(256)]) + content[at + 1 :]


def _delete_range(content: bytes, chance: random.Random) -> bytes:
    start, end = _range(content, chance)
    return content[:start] + content[end:]


def _repeat_range(content: bytes, chance: random.Random) -> bytes:
    start, end = _range(content, chance)
    return content[:end] + content[start:end] + content[end:]


def _move_range(content: bytes, chance: random.Random) -> bytes:
    start, end = _range(content, chance)
    rest = content[:start] + content[end:]
    at = chance.randint(0, len(rest))
    return rest[:at] + content[start:end] + rest[at:]


def _zero_range(content: bytes, chance: random.Random) -> bytes:
    start, end = _range(content, chance)
    return content[:start] + bytes(end - start) + content[end:]


def _truncate(content: bytes, chance: random.Random) -> bytes:
    return content[: chance.randint(0, len(content))]


def _insert_noise(content: bytes, chance: random.Random) -> bytes:
    at = chance.randint(0, len(content))
    return content[:at] + chance.randbytes(chance.randint(1, 16)) + content[at:]


def _overwrite_integer(content: bytes, chance: random.Random) -> bytes:
    """Overwrite 1 to 8 bytes by an extreme binary integer, as if a size or offset in a header were wrong."""
    size, order = chance.choice((1, 2, 4, 8)), chance.choice("<>")
    value = chance.choice(EXTREME_INTEGERS) % 2 ** (8 * size)
    at = chance.randint(0, max(len(content) - size, 0))
    return content[:at] + struct.pack(order + {1: "B", 2: "H", 4: "I", 8: "Q"}[size], value) + content[at + size :]


def _replace_number(content: bytes, chance: random.Random) -> bytes:
    """Replace a number that is written as text (in JSON, YAML, OBJ and tar headers)."""
    start = chance.randint(0, len(content))
    match = NUMBER.search(content, start) or NUMBER.search(content)
    if match is None:
        return content
    return content[: match.start()] + chance.choice(EXTREME_TEXTS) + content[match.end() :]


def _range(content: bytes, chance: random.Random) -> tuple[int, int]:
    longest = chance.choice((4, 64, 1024, len(content)))
    start = chance.randint(0, len(content))
    return start, min(len(content), start + chance.randint(1, max(longest, 1)))


EDITS = (
    _flip_bit, _flip_bit, _overwrite_byte, _delete_range, _repeat_range, _move_range, _zero_range, _truncate,
    _insert_noise, _overwrite_integer, _replace_number, _replace_number,
)  # fmt: skip
