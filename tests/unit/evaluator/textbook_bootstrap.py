"""Bootstrap intervals by the book's formulas, in plain loops: what evaluator/confidence.py is compared with.

Efron and Tibshirani, An Introduction to the Bootstrap (1993), equations 14.10 (bounds), 14.14 (bias correction) and 14.15
(acceleration). docs/metrics.md: an interval reaches over those for the bias seen and for 1 + sqrt(2) times as much.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist, fmean

NORMAL = NormalDist()
BIAS_SEEN_AND_WIDENED = (1.0, 1 + math.sqrt(2))


def bias_correction(estimate: float, drawn: Sequence[float]) -> float:
    """Return z0, the normal quantile of the share of replicates below the estimate."""
    return NORMAL.inv_cdf(sum(value < estimate for value in drawn) / len(drawn))


def acceleration(left_out: Sequence[float]) -> float:
    """Return a, by the estimates with one unit left out at a time."""
    gaps = [fmean(left_out) - value for value in left_out]
    return sum(gap**3 for gap in gaps) / (6 * math.pow(sum(gap**2 for gap in gaps), 1.5))


def bca_shares(z0: float, a: float, level: float) -> tuple[float, float]:
    """Return which shares of the replicates lie below the lower and the upper bound."""
    lower, upper = (
        [NORMAL.cdf(z0 + (factor * z0 + tail) / (1 - a * (factor * z0 + tail))) for factor in BIAS_SEEN_AND_WIDENED]
        for tail in (NORMAL.inv_cdf((1 - level) / 2), NORMAL.inv_cdf((1 + level) / 2))
    )
    return min(lower), max(upper)


def quantile(drawn: Sequence[float], share: float) -> float:
    """Return the value that this share of the replicates lies below, on the line between the two next to it."""
    ordered, place = sorted(drawn), share * (len(drawn) - 1)
    below = min(math.floor(place), len(drawn) - 2)
    return ordered[below] + (place - below) * (ordered[below + 1] - ordered[below])
