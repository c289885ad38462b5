"""All scores for many weightings of the images at once, from the statistics alone.

A weighting counts every image a whole number of times. With all weights 1 the result equals evaluator/scoring.py.
The working point is chosen anew for each weighting. Undefined is NaN here: a class whose ground truth no image of the
resample holds.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluator.average_precision import average_precision, precision_and_recall, working_point_index
from evaluator.errors import UsageError
from evaluator.predictions import Float64Array
from evaluator.protocol import PAPER
from evaluator.resampling import Weighting, total, total_of
from evaluator.statistics import Statistics
from evaluator.thresholds import count_by_group, has_threshold
from evaluator.true_positive_metrics import mean_over_bins

METRICS = ("ap", "bevcd", "yaw_sim", "pr_sim", "size_sim", "detection_score")
"""The last axis of `Replicates`: a class's metrics in `ClassScore`, and their means in `Scores`."""

MEANS = ("map", "mbevcd", "myaw_sim", "mpr_sim", "msize_sim", "mds")


@dataclass(frozen=True, slots=True)
class Replicates:
    """Scores of R weightings of the images, for C classes; NaN where undefined."""

    classes: Float64Array
    """(R, C, 6), the last axis in the order of `METRICS`."""
    means: Float64Array
    """(R, 6) over the classes with ground truth in the resample, in the order of `MEANS`."""
    working_index: NDArray[np.intp]
    """(R, C) threshold index of the working point."""


def replicate(statistics: Statistics, weights: Weighting) -> Replicates:
    """Compute all scores for each weighting.

    Args:
        statistics: Outcomes of I images under a protocol of the family `cityscapes3d`.
        weights: (R, I) how often each image counts, or the jackknife.

    Returns:
        The replicates.

    Raises:
        UsageError: The protocol is `paper`, whose thresholds are all scores.
    """
    if statistics.protocol.name == PAPER.name:
        raise UsageError("Uncertainty is computed for the protocol cityscapes3d; evaluate with that one.")
    true_positives, false_positives, ground_truth = _weighted_counts(statistics, weights)
    precision, recall = precision_and_recall(true_positives, false_positives, ground_truth)
    working = working_point_index(precision, recall, statistics.thresholds, statistics.protocol.working_point)
    ap = average_precision(precision, recall)
    similarities = _similarities(statistics, weights, working)
    detection = ap * similarities.sum(axis=-1) / similarities.shape[-1]
    classes = np.concatenate([ap[..., None], similarities, detection[..., None]], axis=-1)
    classes[ground_truth == 0] = np.nan
    return Replicates(classes, _mean_over_classes(classes), working)


def _weighted_counts(statistics: Statistics, weights: Weighting) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return true and false positives (R, C, T) and ground truth (R, C) under each weighting.

    Single precision is exact here: these are sums of whole numbers far below 2^24.
    """
    images, thresholds = len(statistics.images), len(statistics.thresholds)
    classes, bins = statistics.grid

    def weighted(image: NDArray[np.int32], cell: NDArray[np.int32], masks: NDArray[np.uint64]) -> Float64Array:
        by_image = count_by_group(image * classes + cell // bins, masks, images * classes, thresholds)
        counts = total(weights, by_image.reshape(images, -1).astype(np.float32))
        return np.asarray(counts.reshape(-1, classes, thresholds).astype(np.float64))

    of_image = statistics.ground_truth_image * classes + statistics.ground_truth_cell // bins
    ground_truth = np.bincount(of_image, minlength=images * classes).reshape(images, classes)
    return (
        weighted(statistics.pair_image, statistics.pair_cell, statistics.pair_masks),
        weighted(statistics.false_positive_image, statistics.false_positive_cell, statistics.false_positive_masks),
        np.asarray(total(weights, ground_truth.astype(np.float32)).astype(np.float64)),
    )


def _similarities(statistics: Statistics, weights: Weighting, working: NDArray[np.intp]) -> Float64Array:
    """Return (R, C, 4) similarities at the working points.

    Resamples that chose the same working point for a class share the sums of each image.
    """
    classes, _ = statistics.grid
    result = np.zeros((*working.shape, statistics.pair_similarities.shape[1]))
    for label in range(classes):
        for threshold in np.unique(working[:, label]):
            rows = np.flatnonzero(working[:, label] == threshold)
            images, sums = _sums_by_image(statistics, label, int(threshold))
            flat = sums.reshape(len(images), sums.shape[1] * sums.shape[2])
            chosen = total_of(weights, rows, images, flat).reshape(-1, *sums.shape[1:])
            result[rows, label] = mean_over_bins(
                chosen[..., :-1].astype(np.float64), chosen[..., -1].astype(np.float64)
            )
    return result


def _sums_by_image(statistics: Statistics, label: int, threshold: int) -> tuple[NDArray[np.intp], Float64Array]:
    """Sum up a class's true positives at a threshold, image by image.

    Returns:
        The images that have any, and for each of them (B, 5): in each depth bin the sums of the four similarities
        and the count.
    """
    _, bins = statistics.grid
    wanted = has_threshold(statistics.pair_masks, threshold) & (statistics.pair_cell // bins == label)
    images, position = np.unique(statistics.pair_image[wanted], return_inverse=True)
    group = position * bins + statistics.pair_cell[wanted] % bins
    columns = [*statistics.pair_similarities[wanted].T, None]
    sums = np.zeros((len(images) * bins, len(columns)))
    for column, values in enumerate(columns):
        sums[:, column] = np.bincount(group, weights=values, minlength=len(sums))
    return images, sums.reshape(len(images), bins, len(columns))[:, :-1]


def _mean_over_classes(classes: Float64Array) -> Float64Array:
    """Average (R, C, 6) over the defined classes; NaN where none is."""
    defined = ~np.isnan(classes)
    count = defined.sum(axis=1)
    total = np.where(defined, classes, 0).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
