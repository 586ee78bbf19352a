"""How long garments take, by figures that were measured; to be told before anybody waits."""

__all__ = ["core_seconds"]

FIXED, BY_AREA = 0.8, 6.5  # s, and s cm²: 7.2, 2.4 and 1.2 CPU-s at 1, 2 and 4 cm, sampled garments on one core


def core_seconds(spacing: float) -> float:
    """A drape on one CPU core [s], in the mean of sampled garments, at a mesh spacing [cm].

    >>> core_seconds(1.0), core_seconds(2.0)
    (7.3, 2.425)
    """
    return FIXED + BY_AREA / spacing**2
