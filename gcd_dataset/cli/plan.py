"""What is to be put into a folder of shards, when some of it may be there."""

from dataclasses import dataclass
from pathlib import Path

__all__ = ["Plan"]


@dataclass(frozen=True)
class Plan:
    """A data set to be made, and what of it is still missing."""

    out: Path
    count: int
    missing: tuple[int, ...]

    @property
    def there(self) -> int:
        """How many of its samples an earlier run has finished."""
        return self.count - len(self.missing)
