"""What is to be put into a data set, when some of it may be there."""

from dataclasses import dataclass

from gcd_dataset.errors import ConfigError

__all__ = ["MakingPlan", "check_count"]

MOST = 10_000_000  # samples of a data set, ten terabytes of garments; a plan of them has 400 MB


@dataclass(frozen=True)
class MakingPlan:
    """A data set to be made, and what of it is still missing."""

    count: int
    missing: tuple[int, ...]

    @property
    def there(self) -> int:
        """How many of its samples an earlier run has finished."""
        return self.count - len(self.missing)


def check_count(count: int) -> int:
    """The number of samples, if a data set may have as many. Raises ``ConfigError``."""
    if not 1 <= count <= MOST:
        raise ConfigError(f"count is {count if count < 10**15 else '10**15 or more'}: give 1 to {MOST}")
    return count
