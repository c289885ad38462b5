"""Confidence intervals from bootstrap replicates, for many metrics at once.

Sources: Efron and Tibshirani, An Introduction to the Bootstrap (1993), chapters 13 (percentile intervals) and 14 (bias
correction and acceleration). docs/metrics.md shows the coverage found by simulation.
"""

import math
from statistics import NormalDist

import msgspec
import numpy as np

from evaluator.errors import UsageError
from evaluator.predictions import Float64Array

LEVEL = 0.95

_NORMAL = NormalDist()


class Interval(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """An estimate with its confidence interval."""

    estimate: float
    lower: float
    upper: float
    is_proven: bool = True
    """Whether simulation shows that it covers the truth as often as its level says; in JSON where it does not."""


def require_level(level: float) -> None:
    """Refuse what is no confidence level.

    Raises:
        UsageError: It does not lie between 0 and 1.
    """
    if not 0 < level < 1:
        raise UsageError("The confidence level must lie between 0 and 1, for example 0.95.")


def tails(level: float) -> tuple[float, float]:
    """Return the shares of the distribution below the lower and the upper bound."""
    return (1 - level) / 2, (1 + level) / 2


def most_contrary(resamples: int, level: float) -> int:
    """Return on how many resamples a difference may at most be 0 or of the other sign for two scores to differ.

    A tail of k of R resamples has the p-value 2 (k + 1) / (R + 1) (Davison and Hinkley, Bootstrap Methods and their
    Application, 1997, section 4.4), which is at most 1 - level up to this k. Negative: R are too few for this level.
    """
    return math.floor(tails(level)[0] * (resamples + 1) + _ROUNDING) - 1


_ROUNDING = 1e-9
"""Far above the rounding error of a level, so that 0.95 of 999 resamples is 24 as on paper."""


def percentile_bounds(drawn: Float64Array, level: float) -> Float64Array:
    """Return the quantiles of the replicates.

    Args:
        drawn: (R, K) K metrics on R resamples; NaN where undefined.
        level: Confidence level in (0, 1).

    Returns:
        (2, K) lower and upper bounds; NaN for a metric that no resample defines.
    """
    shares = np.broadcast_to(np.array(tails(level))[:, None], (2, drawn.shape[1]))
    return _quantiles(drawn, shares)


BIAS_FACTORS = (1.0, 1 + 2**0.5)
"""Of the bias that resampling shows: for a bias that shrinks with the number of images n as 1 / n, and as 1 / sqrt(n).

The precision envelope is a maximum over what fluctuates, so the bias of AP shrinks slower than that of a smooth score.
"""


TIE = 1e-12
"""Scores that differ by less are equal: the same numbers, summed up in another order."""


def bca_bounds(estimate: Float64Array, drawn: Float64Array, acceleration: Float64Array, level: float) -> Float64Array:
    """Return bias-corrected and accelerated bounds (Efron and Tibshirani, section 14.3).

    They hold the intervals for each of `BIAS_FACTORS`; with the first alone this is the BCa of the book.

    Args:
        estimate: (K,) the metrics on the images as they are.
        drawn: (R, K) on the resamples.
        acceleration: (K,), see `accelerations`; 0 corrects the bias alone.
        level: Confidence level in (0, 1).

    Returns:
        (2, K) lower and upper bounds; NaN where undefined.
    """
    shift = bias(estimate, drawn)
    shares = np.empty((2, len(estimate)))
    for row, tail, outer in zip(shares, tails(level), (np.minimum, np.maximum), strict=True):
        shifted = [factor * shift + _NORMAL.inv_cdf(tail) for factor in BIAS_FACTORS]
        row[:] = _normal_shares(shift + outer(*(z / (1 - acceleration * z) for z in shifted)))
    return np.where(np.isnan(estimate), np.nan, _quantiles(drawn, shares))


def bias(estimate: Float64Array, drawn: Float64Array) -> Float64Array:
    """Return (K,) by how many standard deviations the median replicate lies below the estimate; 0 when undefined."""
    count = np.maximum((~np.isnan(drawn)).sum(axis=0), 1)
    gap = drawn - estimate
    below = ((gap < -TIE).sum(axis=0) + (gap <= TIE).sum(axis=0)) / 2 / count
    limit = 0.5 / count
    below = np.where(np.isnan(estimate), 0.5, np.clip(below, limit, 1 - limit))
    return np.array([_NORMAL.inv_cdf(share) for share in below.tolist()])


def accelerations(left_out: Float64Array) -> Float64Array:
    """Return (K,) how fast each metric's standard error changes with its value, from a jackknife.

    Args:
        left_out: (U, K) the metrics with one unit left out at a time; NaN where undefined.
    """
    defined = ~np.isnan(left_out)
    mean = np.where(defined, left_out, 0).sum(axis=0) / np.maximum(defined.sum(axis=0), 1)
    spread = np.where(defined, mean - left_out, 0)
    scale = (spread**2).sum(axis=0) ** 1.5
    return np.asarray((spread**3).sum(axis=0) / (6 * np.where(scale > 0, scale, 1)))


def _quantiles(drawn: Float64Array, shares: Float64Array) -> Float64Array:
    """Return (2, K) quantiles, each metric at its own (2, K) shares, interpolated linearly between replicates."""
    ordered = np.sort(drawn, axis=0)
    last = (~np.isnan(ordered)).sum(axis=0) - 1
    place = shares * np.maximum(last, 0)
    below = place.astype(np.intp)
    above = np.minimum(below + 1, np.maximum(last, 0))
    low, high = (np.take_along_axis(ordered, index, axis=0) for index in (below, above))
    return np.asarray(low + (high - low) * (place - below))


def _normal_shares(z: Float64Array) -> Float64Array:
    return np.array([_NORMAL.cdf(value) for value in z.tolist()])
