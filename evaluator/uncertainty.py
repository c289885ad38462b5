"""How far a score can be trusted: bootstrap over images, from stored statistics, without matching again.

Sources: Efron and Tibshirani, An Introduction to the Bootstrap (1993), chapters 13 (percentile intervals), 14 (BCa)
and 16 (paired comparison). docs/metrics.md shows the coverage found by simulation.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from evaluator.confidence import (
    LEVEL,
    Interval,
    accelerations,
    bca_bounds,
    most_contrary,
    percentile_bounds,
    require_level,
)
from evaluator.errors import UsageError
from evaluator.interval_rules import FEWEST_FOR_INTERVALS, can_be_resampled, sufficient
from evaluator.predictions import Float64Array
from evaluator.protocol import Signature, require_comparable
from evaluator.replicates import BIN_METRICS, MEANS, METRICS, Replicates, Replicator, every_bin, replicate
from evaluator.resampling import Unit, bootstrap_weights, leave_one_out, once
from evaluator.statistics import Statistics

RESAMPLES = 1000
SEED = 20200614
"""The default draw; any number does, but everybody's must be the same to compare."""

Method = Literal["percentile", "bca"]

NamedIntervals = dict[str, Interval | None]
"""By the name of the metric; None where it is undefined or too little is known of it (evaluator/interval_rules.py)."""


class Uncertainty(msgspec.Struct, frozen=True, kw_only=True):
    """Intervals of every metric."""

    signature: Signature
    """Of the score that they are about."""
    level: float
    resamples: int
    seed: int
    unit: Unit
    method: Method
    means: NamedIntervals
    """By the names of `Scores`: map, mbevcd, myaw_sim, mpr_sim, msize_sim, mds."""
    classes: dict[str, NamedIntervals]
    """By label, then by the names of `ClassScore`."""
    depth_bins: dict[str, tuple[NamedIntervals, ...]]
    """By label, bin by bin, by the names of `DepthBin`; empty unless asked for."""


class Comparison(msgspec.Struct, frozen=True, kw_only=True):
    """First minus second submission in one metric, on the same resamples."""

    difference: Interval
    p_value: float
    """Two-sided, of no difference; in (0, 1]."""


class PairedComparison(msgspec.Struct, frozen=True, kw_only=True):
    """First minus second submission in every mean."""

    signatures: tuple[Signature, Signature]
    level: float
    resamples: int
    seed: int
    unit: Unit
    means: dict[str, Comparison | None]
    """By the names of `Scores`; None where undefined or too little is known of either."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bootstrap:
    """One submission's scores, and those on resamples."""

    estimate: Replicates
    """One row: the images as they are."""
    drawn: Replicates
    left_out: Replicates | None
    """With one unit left out at a time; None for percentile intervals, which need no jackknife."""
    units: int
    """How many images, sequences or cities were drawn from."""


def bootstrap(
    statistics: Statistics,
    *,
    resamples: int = RESAMPLES,
    seed: int = SEED,
    unit: Unit = "image",
    method: Method = "bca",
    by_depth: bool = False,
    unproven: bool = False,
) -> Bootstrap:
    """Compute all scores on resamples of the images; of depth bins those with enough boxes for an interval, or all.

    Raises:
        UsageError: Nothing can be drawn in this way.
    """
    images = statistics.images
    weights = bootstrap_weights(images, resamples=resamples, seed=seed, unit=unit)
    jackknife = leave_one_out(images, unit=unit)
    replicator = Replicator(statistics)
    bins = every_bin(statistics) if by_depth else None
    estimate = replicator.replicate(once(images), bins)
    if by_depth and not unproven:
        bins = np.asarray(sufficient(statistics, estimate, jackknife.units)[-1].any(axis=-1))
    return Bootstrap(
        estimate=estimate,
        drawn=replicator.replicate(weights, bins),
        left_out=replicator.replicate(jackknife, bins) if method == "bca" else None,
        units=jackknife.units,
    )


def intervals(
    statistics: Statistics,
    *,
    resamples: int = RESAMPLES,
    seed: int = SEED,
    unit: Unit = "image",
    level: float = LEVEL,
    method: Method = "bca",
    by_depth: bool = True,
    unproven: bool = False,
) -> Uncertainty:
    """Compute confidence intervals of all metrics.

    Args:
        statistics: Outcomes of one submission.
        resamples: Bootstrap resamples.
        seed: Decides the draw.
        unit: What is drawn as a whole.
        level: Confidence level in (0, 1).
        method: "bca" (bias-corrected and accelerated, from a jackknife over the units), which covers best where
            scores are biased by few boxes, or "percentile", which costs two thirds.
        by_depth: Give those of the depth bins, too.
        unproven: Give those, too, of which too little is known for simulation to confirm the level
            (evaluator/interval_rules.py). They say so: `Interval.is_proven`. Scores that resamples do not scatter
            about (`can_be_resampled`) have none all the same.

    Returns:
        The intervals; none at all below `FEWEST_FOR_INTERVALS`, where nothing is drawn, unless unproven ones will do.

    Raises:
        UsageError: Nothing can be drawn in this way, or the level is none.
    """
    require_level(level)
    if not unproven and leave_one_out(statistics.images, unit=unit).units < FEWEST_FOR_INTERVALS:
        found = _undrawn(statistics, unit=unit, by_depth=by_depth)
    else:
        found = bootstrap(
            statistics,
            resamples=resamples,
            seed=seed,
            unit=unit,
            method=method,
            by_depth=by_depth,
            unproven=unproven,
        )
    means, classes, depth_bins = named_intervals(statistics, found, level, unproven=unproven)
    return Uncertainty(
        signature=statistics.signature,
        level=level,
        resamples=resamples,
        seed=seed,
        unit=unit,
        method=method,
        means=means,
        classes=classes,
        depth_bins=depth_bins,
    )


def _undrawn(statistics: Statistics, *, unit: Unit, by_depth: bool) -> Bootstrap:
    """Return the scores of what has too few images to be resampled; no interval comes of it."""
    estimate = replicate(statistics, once(statistics.images), by_depth=by_depth)
    units = leave_one_out(statistics.images, unit=unit).units
    return Bootstrap(estimate=estimate, drawn=estimate, left_out=None, units=units)


def named_intervals(
    statistics: Statistics, found: Bootstrap, level: float, *, unproven: bool = False
) -> tuple[NamedIntervals, dict[str, NamedIntervals], dict[str, tuple[NamedIntervals, ...]]]:
    """Return the intervals of a bootstrap as `Uncertainty` has them: means, classes, depth bins."""
    known = sufficient(statistics, found.estimate, found.units)
    of_scores = can_be_resampled(statistics.protocol) & unproven
    also = of_scores, of_scores, np.array(unproven)
    means, classes, bins = (_intervals(found, *part, level) for part in zip(_PARTS, known, also, strict=True))
    return (
        _named(MEANS, means[None])[0],
        dict(zip(statistics.labels, _named(METRICS, classes), strict=True)),
        {label: _named(BIN_METRICS, of_class) for label, of_class in zip(statistics.labels, bins, strict=True)},
    )


_PARTS: tuple[Callable[[Replicates], Float64Array], ...] = (
    lambda found: found.means,
    lambda found: found.classes,
    lambda found: found.depth_bins,
)


def _intervals(
    found: Bootstrap,
    part: Callable[[Replicates], Float64Array],
    enough: NDArray[np.bool_],
    also: NDArray[np.bool_],
    level: float,
) -> NDArray[np.object_]:
    """Return the intervals of one part of the replicates in its shape, None where there is none.

    Those of which `enough` is known are proven; the others are given where they are asked for `also`.
    """
    estimate = part(found.estimate)[0]
    given = (enough | also) & ~np.isnan(estimate)
    drawn = _columns(part(found.drawn), given)
    if found.left_out is None:
        bounds = percentile_bounds(drawn, level)
    else:
        bounds = bca_bounds(estimate[given], drawn, accelerations(_columns(part(found.left_out), given)), level)
    result = np.full(enough.shape, None, dtype=np.object_)
    result[given] = [
        None if np.isnan(lower) else Interval(estimate=value, lower=lower, upper=upper, is_proven=is_proven)
        for value, lower, upper, is_proven in zip(
            estimate[given].tolist(), *bounds.tolist(), enough[given].tolist(), strict=True
        )
    ]
    return result


def _columns(values: Float64Array, given: NDArray[np.bool_]) -> Float64Array:
    """Return (R, N) those of (R, ...) replicates of which an interval is given, row by row in memory."""
    return values.reshape(len(values), -1).compress(given.ravel(), axis=1)


def _named(names: tuple[str, ...], found: NDArray[np.object_]) -> tuple[NamedIntervals, ...]:
    """Name the last axis of (N, K) intervals."""
    return tuple(dict(zip(names, row, strict=True)) for row in found.tolist())


def mds_replicates(
    statistics: Statistics, *, resamples: int = RESAMPLES, seed: int = SEED, unit: Unit = "image"
) -> Float64Array:
    """Return (R,) mDS on each resample: what standings need of a submission (evaluator/standings.py)."""
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
    unproven: bool = False,
) -> PairedComparison:
    """Compare two submissions on the same images, in every mean.

    Args:
        first: Outcomes of one submission.
        second: Outcomes of the other, on the same images and ground truth under the same protocol.
        resamples: Bootstrap resamples.
        seed: Decides the draw.
        unit: What is drawn as a whole.
        level: Confidence level in (0, 1).
        unproven: As for `intervals`.

    Returns:
        Differences, intervals and p-values; None where undefined or, unless unproven ones will do, where too little is
        known of either.

    Raises:
        UsageError: Images, ground truth or protocols differ, nothing can be drawn in this way, or the level is none.
    """
    require_comparable(first.signature, second.signature)
    if first.images != second.images:
        raise UsageError("Only submissions evaluated on the same images can be compared.")
    require_level(level)
    units = leave_one_out(first.images, unit=unit).units
    sides = Replicator(first), Replicator(second)
    scores = [side.replicate(once(first.images)) for side in sides]
    known = sufficient(first, scores[0], units)[0] & sufficient(second, scores[1], units)[0]
    given = known | (can_be_resampled(first.protocol) & unproven)
    means: dict[str, Comparison | None] = dict.fromkeys(MEANS)
    if given.any():
        weights = bootstrap_weights(first.images, resamples=resamples, seed=seed, unit=unit)
        estimate = scores[0].means[0] - scores[1].means[0]
        drawn = sides[0].replicate(weights).means - sides[1].replicate(weights).means
        for i in np.flatnonzero(given).tolist():
            means[MEANS[i]] = compare_replicates(float(estimate[i]), drawn[:, i], level, is_proven=bool(known[i]))
    return PairedComparison(
        signatures=(first.signature, second.signature),
        level=level,
        resamples=resamples,
        seed=seed,
        unit=unit,
        means=means,
    )


def compare_replicates(
    estimate: float, differences: Float64Array, level: float = LEVEL, *, is_proven: bool = True
) -> Comparison | None:
    """Judge a difference by its replicates.

    Args:
        estimate: The difference on the images as they are.
        differences: (R,) the difference on each resample.
        level: Confidence level in (0, 1).
        is_proven: Whether enough is known for the interval to be trusted, `Interval.is_proven`.

    Returns:
        Percentile interval and two-sided p-value (twice the smaller tail beyond 0); None where undefined. The interval
        leaves out 0 exactly where p is at most 1 - level: its bounds are replicates themselves (`most_contrary`). With
        too few resamples for this level, below 39 at 95 %, it spans all of them.

    Raises:
        UsageError: The level is none.
    """
    require_level(level)
    defined = differences[~np.isnan(differences)]
    if np.isnan(estimate) or not len(defined):
        return None
    ordered, outside = np.sort(defined), max(most_contrary(len(defined), level), 0)
    lower, upper = float(ordered[outside]), float(ordered[-1 - outside])
    smaller_tail = min((defined <= 0).sum(), (defined >= 0).sum())
    p_value = min(1.0, 2 * (1 + float(smaller_tail)) / (len(defined) + 1))
    interval = Interval(estimate=estimate, lower=lower, upper=upper, is_proven=is_proven)
    return Comparison(difference=interval, p_value=p_value)
