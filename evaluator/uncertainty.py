"""How far a score can be trusted: bootstrap over images, from stored statistics, without matching again.

Sources: Efron and Tibshirani, An Introduction to the Bootstrap (1993), chapters 13 (percentile intervals), 14 (BCa)
and 16 (paired comparison). docs/metrics.md shows the coverage found by simulation.
"""

from collections.abc import Sequence
from statistics import NormalDist
from typing import Literal

import msgspec
import numpy as np

from evaluator.errors import UsageError
from evaluator.predictions import Float64Array
from evaluator.replicates import MEANS, METRICS, Replicates, replicate
from evaluator.resampling import Unit, bootstrap_weights, leave_one_out
from evaluator.statistics import Statistics

RESAMPLES = 1000
SEED = 20200614
"""The default draw; any number does, but everybody's must be the same to compare."""
LEVEL = 0.95

Method = Literal["percentile", "bca"]


class Interval(msgspec.Struct, frozen=True, kw_only=True):
    """An estimate with its confidence interval."""

    estimate: float
    lower: float
    upper: float


class Uncertainty(msgspec.Struct, frozen=True, kw_only=True):
    """Intervals of every metric; None where the metric is undefined."""

    level: float
    resamples: int
    seed: int
    unit: Unit
    method: Method
    means: dict[str, Interval | None]
    """By the names of `Scores`: map, mbevcd, myaw_sim, mpr_sim, msize_sim, mds."""
    classes: dict[str, dict[str, Interval | None]]
    """By label, then by the names of `ClassScore`."""


class Comparison(msgspec.Struct, frozen=True, kw_only=True):
    """First minus second submission, on the same resamples."""

    difference: Interval
    p_value: float
    """Two-sided, of no difference; in (0, 1]."""


def intervals(
    statistics: Statistics,
    *,
    resamples: int = RESAMPLES,
    seed: int = SEED,
    unit: Unit = "image",
    level: float = LEVEL,
    method: Method = "bca",
) -> Uncertainty:
    """Compute confidence intervals of all metrics.

    Args:
        statistics: Outcomes of one submission.
        resamples: Bootstrap resamples.
        seed: Decides the draw.
        unit: What is drawn as a whole.
        level: Confidence level in (0, 1).
        method: "bca" (bias-corrected and accelerated, from a jackknife over the units), which covers best where
            scores are biased by few boxes, or "percentile", which costs half.

    Returns:
        The intervals.
    """
    _require_level(level)
    images = statistics.images
    estimate = _table(replicate(statistics, np.ones((1, len(images)), dtype=np.float32)))[0]
    drawn = _table(replicate(statistics, bootstrap_weights(images, resamples=resamples, seed=seed, unit=unit)))
    if method == "bca":
        left_out = _table(replicate(statistics, leave_one_out(images, unit=unit)))
        bounds = [bca_bounds(estimate[i], drawn[:, i], left_out[:, i], level) for i in range(len(estimate))]
    else:
        bounds = [_quantiles(drawn[:, i], *_tails(level)) for i in range(len(estimate))]
    found = [
        None if np.isnan(value) or bound is None else Interval(estimate=float(value), lower=bound[0], upper=bound[1])
        for value, bound in zip(estimate, bounds, strict=True)
    ]
    rows = [found[start : start + len(METRICS)] for start in range(0, len(found), len(METRICS))]
    return Uncertainty(
        level=level,
        resamples=resamples,
        seed=seed,
        unit=unit,
        method=method,
        means=dict(zip(MEANS, rows[0], strict=True)),
        classes={
            label: dict(zip(METRICS, row, strict=True)) for label, row in zip(statistics.labels, rows[1:], strict=True)
        },
    )


def mds_replicates(
    statistics: Statistics, *, resamples: int = RESAMPLES, seed: int = SEED, unit: Unit = "image"
) -> Float64Array:
    """Return (R,) mDS on each resample: all a leaderboard has to keep of a submission to be compared with others."""
    weights = bootstrap_weights(statistics.images, resamples=resamples, seed=seed, unit=unit)
    return replicate(statistics, weights).means[:, MEANS.index("mds")]


def compare(
    first: Statistics,
    second: Statistics,
    *,
    resamples: int = RESAMPLES,
    seed: int = SEED,
    unit: Unit = "image",
    level: float = LEVEL,
) -> dict[str, Comparison | None]:
    """Compare two submissions on the same images, in every mean.

    Args:
        first: Outcomes of one submission.
        second: Outcomes of the other, on the same images under the same protocol.
        resamples: Bootstrap resamples.
        seed: Decides the draw.
        unit: What is drawn as a whole.
        level: Confidence level in (0, 1).

    Returns:
        By the names of `Scores` (mds, map, ...); None where undefined.

    Raises:
        UsageError: Images or protocols differ.
    """
    if (first.images, first.protocol) != (second.images, second.protocol):
        raise UsageError("Only submissions evaluated on the same images under the same protocol can be compared.")
    weights = bootstrap_weights(first.images, resamples=resamples, seed=seed, unit=unit)
    ones = np.ones((1, len(first.images)), dtype=np.float32)
    estimate = replicate(first, ones).means[0] - replicate(second, ones).means[0]
    drawn = replicate(first, weights).means - replicate(second, weights).means
    return {name: compare_replicates(float(estimate[i]), drawn[:, i], level) for i, name in enumerate(MEANS)}


def compare_replicates(estimate: float, differences: Float64Array, level: float = LEVEL) -> Comparison | None:
    """Judge a difference by its replicates.

    Args:
        estimate: The difference on the images as they are.
        differences: (R,) the difference on each resample.
        level: Confidence level in (0, 1).

    Returns:
        Percentile interval and two-sided p-value (twice the smaller tail beyond 0); None where undefined.
    """
    _require_level(level)
    bound = _quantiles(differences, *_tails(level))
    if bound is None or np.isnan(estimate):
        return None
    defined = differences[~np.isnan(differences)]
    smaller_tail = min((defined <= 0).sum(), (defined >= 0).sum())
    p_value = min(1.0, 2 * (1 + float(smaller_tail)) / (len(defined) + 1))
    return Comparison(difference=Interval(estimate=estimate, lower=bound[0], upper=bound[1]), p_value=p_value)


def rank_intervals(mds: Float64Array, level: float = LEVEL) -> list[tuple[int, int]]:
    """Find between which ranks each submission of a leaderboard may stand.

    Adding a submission needs only its own replicates; those of the others are kept.

    Args:
        mds: (M, R) mDS of M submissions on the same R resamples (`mds_replicates`), all defined.
        level: Confidence level in (0, 1).

    Returns:
        Best and worst rank of each submission, from 1; ties share the better rank.
    """
    _require_level(level)
    better = np.sort(mds, axis=0)
    ranks = np.stack([1 + (better > row).sum(axis=0) for row in mds]) if len(mds) else np.zeros((0, 1))
    lower, upper = _tails(level)
    bounds = np.quantile(ranks, [lower, upper], axis=1, method="closest_observation").T
    return [(int(best), int(worst)) for best, worst in bounds]


def indistinguishable_groups(estimates: Sequence[float], mds: Float64Array, level: float = LEVEL) -> list[list[int]]:
    """Group submissions whose differences in mDS may be chance.

    Args:
        estimates: mDS of M submissions.
        mds: (M, R) their replicates on the same resamples.
        level: Confidence level in (0, 1).

    Returns:
        Groups of neighbours in the ranking, best first, as indices into `estimates`. Within a group no submission
        differs from another with that confidence; a submission may be in several groups, and no group is part of
        another.
    """
    order = sorted(range(len(estimates)), key=lambda index: -estimates[index])
    groups: list[list[int]] = []
    reach = 0
    for start in range(len(order)):
        stop = start + 1
        while stop < len(order) and all(_may_be_equal(order[i], order[stop], mds, level) for i in range(start, stop)):
            stop += 1
        if stop > reach:
            groups.append(order[start:stop])
            reach = stop
    return groups


def _may_be_equal(first: int, second: int, mds: Float64Array, level: float) -> bool:
    bound = _quantiles(mds[first] - mds[second], *_tails(level))
    return bound is None or bound[0] <= 0 <= bound[1]


def bca_bounds(
    estimate: float, drawn: Float64Array, left_out: Float64Array, level: float
) -> tuple[float, float] | None:
    """Return bias-corrected and accelerated bounds (Efron and Tibshirani, section 14.3).

    Args:
        estimate: The metric on the images as they are.
        drawn: (R,) on the resamples.
        left_out: (U,) with one unit left out at a time.
        level: Confidence level in (0, 1).

    Returns:
        Lower and upper bound; None where undefined.
    """
    drawn, left_out = drawn[~np.isnan(drawn)], left_out[~np.isnan(left_out)]
    if np.isnan(estimate) or len(drawn) == 0:
        return None
    normal = NormalDist()
    below = ((drawn < estimate).sum() + (drawn == estimate).sum() / 2) / len(drawn)
    limit = 0.5 / len(drawn)
    bias = normal.inv_cdf(float(np.clip(below, limit, 1 - limit)))
    spread = left_out.mean() - left_out if len(left_out) else np.zeros(1)
    scale = float((spread**2).sum())
    acceleration = float((spread**3).sum()) / (6 * scale**1.5) if scale > 0 else 0.0
    shifted = [bias + normal.inv_cdf(tail) for tail in _tails(level)]
    lower, upper = (normal.cdf(bias + z / (1 - acceleration * z)) for z in shifted)
    return _quantiles(drawn, lower, upper)


def _table(replicates: Replicates) -> Float64Array:
    """Return (R, 6 + 6 C): the means, then each class's metrics."""
    return np.concatenate([replicates.means[:, None], replicates.classes], axis=1).reshape(len(replicates.means), -1)


def _tails(level: float) -> tuple[float, float]:
    return (1 - level) / 2, (1 + level) / 2


def _require_level(level: float) -> None:
    if not 0 < level < 1:
        raise UsageError("The confidence level must lie between 0 and 1, for example 0.95.")


def _quantiles(values: Float64Array, lower: float, upper: float) -> tuple[float, float] | None:
    """Return two quantiles of what is defined; None when nothing is."""
    defined = values[~np.isnan(values)]
    if len(defined) == 0:
        return None
    low, high = np.quantile(defined, [lower, upper]).tolist()
    return low, high
