"""Estimates of draping time, fitted to measurements; logged before long runs."""

FIXED, PER_DENSITY = 0.8, 6.5  # s, s cm²; fitted to 7.2, 2.4 and 1.2 core-seconds measured at 1, 2 and 4 cm


def core_seconds(spacing: float) -> float:
    """Mean time to drape a sampled garment on one CPU core [s], at a mesh spacing [cm].

    >>> core_seconds(1.0), core_seconds(2.0)
    (7.3, 2.425)
    """
    return FIXED + PER_DENSITY / spacing**2
