"""Confidence intervals of success rates."""

import math

Z95 = 1.959963984540054


def wilson(successes: float, trials: int, z: float = Z95) -> tuple[float, float]:
    """The score interval of a fraction (Wilson 1927); unlike the normal approximation it is valid near 0 and 1.

    Without trials it is (0, 1).

    Raises:
        ValueError: not 0 <= successes <= trials.
    """
    if not 0 <= successes <= trials:
        raise ValueError(f"{successes} successes in {trials} trials")
    if trials == 0:
        return 0.0, 1.0
    fraction, z2 = successes / trials, z * z
    scale = 1 + z2 / trials
    middle = (fraction + z2 / (2 * trials)) / scale
    half = z / scale * math.sqrt(fraction * (1 - fraction) / trials + z2 / (4 * trials * trials))
    # At the ends the bound is exact; rounding must not exceed it.
    low = 0.0 if successes == 0 else middle - half
    high = 1.0 if successes == trials else middle + half
    return low, high
