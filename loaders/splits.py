"""Syntax of ``split=``: a split, a slice of one, or a sum of these.

>>> parse_splits("train[:10%]+test")
(SplitPart(name='train', start=None, stop='10%'), SplitPart(name='test', start=None, stop=None))
>>> SplitPart("train", "10%", "-5").range_of(205)
range(20, 200)
"""

import re
from dataclasses import dataclass

from gcd_dataset.errors import ConfigError

BOUND = r"-?[0-9]{1,18}%?"  # 18 digits fit an int64
PART = re.compile(rf"\s*(?P<name>\w[\w.-]*)\s*(?:\[\s*(?P<start>{BOUND})?\s*:\s*(?P<stop>{BOUND})?\s*\])?\s*")


@dataclass(frozen=True)
class SplitPart:
    """The samples ``start`` to ``stop`` of a split: integers or per cent, negative ones from the end."""

    name: str
    start: str | None = None
    stop: str | None = None

    def range_of(self, count: int) -> range:
        """Positions in a split of ``count`` samples. Adjacent parts neither overlap nor leave a gap."""
        return range(count)[_bound(self.start, count) : _bound(self.stop, count)]


def parse_splits(text: str) -> tuple[SplitPart, ...]:
    """The parts of a ``split=`` text. Raises ``ConfigError``."""
    matches = [PART.fullmatch(part) for part in text.split("+")] if isinstance(text, str) else [None]
    parts = tuple(SplitPart(match["name"], match["start"], match["stop"]) for match in matches if match)
    if len(parts) < len(matches):
        raise ConfigError(f"split={text!r:.99}: write train, train[:10%], train[100:200] or train+test")
    for bound in (bound for part in parts for bound in (part.start, part.stop) if bound and bound.endswith("%")):
        if abs(int(bound[:-1])) > 100:
            raise ConfigError(f"split={text!r}: {bound} is out of range: give -100% to 100%")
    return parts


def _bound(text: str | None, count: int) -> int | None:
    if text is None:
        return None
    return round(int(text[:-1]) / 100 * count) if text.endswith("%") else int(text)
