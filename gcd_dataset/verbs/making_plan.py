"""Plans of runs that resume: the number of samples and the missing ones."""

from dataclasses import dataclass

from gcd_dataset.errors import ConfigError

__all__ = ["MakingPlan", "check_count"]

MOST = 10_000_000  # samples of a data set: ten terabytes of garments; their plan takes 400 MB


@dataclass(frozen=True)
class MakingPlan:
    """The size of a data set and its missing samples."""

    count: int
    """Samples in the finished data set."""
    missing: tuple[int, ...]
    """Indices of the samples to make."""

    @property
    def existing(self) -> int:
        """Number of samples finished by earlier runs."""
        return self.count - len(self.missing)


def check_count(count: int) -> int:
    """``count``, if a data set can have so many samples. Raises ``ConfigError`` otherwise."""
    if not 1 <= count <= MOST:
        raise ConfigError(f"count is {count if count < 10**15 else '10**15 or more'}: give 1 to {MOST}")
    return count
