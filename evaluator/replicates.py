"""All scores for many weightings of the images at once, from the statistics alone.

A weighting counts every image a whole number of times. With all weights 1 the result equals evaluator/scoring.py, or
evaluator/paper_scoring.py under the protocol `paper`. The working point is chosen anew for each weighting. Undefined is
NaN here: a class, or the metric of a depth bin, that no image of the resample holds anything for.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluator.average_precision import average_precision, precision_and_recall, working_point_index
from evaluator.depth_replicates import depth_average_precision
from evaluator.paper_replicates import paper_average_precision, paper_depth_average_precision
from evaluator.predictions import Float64Array
from evaluator.protocol import PAPER
from evaluator.resampling import Weighting, total, total_of
from evaluator.statistics import Statistics
from evaluator.thresholds import count_by_group, has_threshold
from evaluator.true_positive_metrics import integral_over_range, mean_over_bins

METRICS = ("ap", "bevcd", "yaw_sim", "pr_sim", "size_sim", "detection_score")
"""The last axis of `Replicates.classes`: a class's metrics in `ClassScore`, and their means in `Scores`."""

MEANS = ("map", "mbevcd", "myaw_sim", "mpr_sim", "msize_sim", "mds")

BIN_METRICS = METRICS[:-1]
"""The last axis of `Replicates.depth_bins`, by their names in `DepthBin`."""


@dataclass(frozen=True, slots=True)
class Replicates:
    """Scores of R weightings of the images, for C classes and B depth bins; NaN where undefined."""

    classes: Float64Array
    """(R, C, 6), the last axis in the order of `METRICS`."""
    means: Float64Array
    """(R, 6) over the classes with ground truth in the resample, in the order of `MEANS`."""
    working_point: Float64Array
    """(R, C) c_w."""
    true_positives: Float64Array
    """(R, C, B) in each depth bin at the working point."""
    depth_bins: Float64Array
    """(R, C, B, 5) in the order of `BIN_METRICS`; B is 0 unless depth bins are asked for."""


def replicate(statistics: Statistics, weights: Weighting, *, by_depth: bool = False) -> Replicates:
    """Compute all scores for each weighting.

    Args:
        statistics: Outcomes of I images.
        weights: (R, I) how often each image counts, or the jackknife.
        by_depth: Compute the metrics of each depth bin, too, which about doubles the time.

    Returns:
        The replicates.
    """
    by_paper = statistics.protocol.name == PAPER.name
    ap, working_point = (paper_average_precision if by_paper else _average_precision)(statistics, weights)
    sums = _sums_at_working_points(statistics, weights, working_point)
    similarities = (integral_over_range if by_paper else mean_over_bins)(sums[..., :-1], sums[..., -1])
    detection = ap * similarities.sum(axis=-1) / similarities.shape[-1]
    classes = np.concatenate([ap[..., None], similarities, detection[..., None]], axis=-1)
    classes[_ground_truth(statistics, weights) == 0] = np.nan
    if by_depth:
        depth_ap = (paper_depth_average_precision if by_paper else depth_average_precision)(statistics, weights)
        depth_bins = np.concatenate([depth_ap[..., None], _bin_means(sums)], axis=-1)
    else:
        depth_bins = np.zeros((*ap.shape, 0, len(BIN_METRICS)))
    return Replicates(classes, _mean_over_classes(classes), working_point, sums[..., -1], depth_bins)


def _average_precision(statistics: Statistics, weights: Weighting) -> tuple[Float64Array, Float64Array]:
    """Return AP and c_w, both (R, C), on the thresholds of the protocol.

    Single precision is exact here: these are sums of whole numbers far below 2^24.
    """
    images, thresholds = len(statistics.images), len(statistics.thresholds)
    classes, bins = statistics.grid

    def weighted(image: NDArray[np.int32], cell: NDArray[np.int32], masks: NDArray[np.uint64]) -> Float64Array:
        by_image = count_by_group(image * classes + cell // bins, masks, images * classes, thresholds)
        counts = total(weights, by_image.reshape(images, classes * thresholds).astype(np.float32))
        return np.asarray(counts.reshape(-1, classes, thresholds).astype(np.float64))

    precision, recall = precision_and_recall(
        weighted(statistics.pair_image, statistics.pair_cell, statistics.pair_masks),
        weighted(statistics.false_positive_image, statistics.false_positive_cell, statistics.false_positive_masks),
        _ground_truth(statistics, weights),
    )
    working = working_point_index(precision, recall, statistics.thresholds, statistics.protocol.working_point)
    return average_precision(precision, recall), statistics.thresholds[working]


def _ground_truth(statistics: Statistics, weights: Weighting) -> Float64Array:
    """Return (R, C) ground-truth boxes under each weighting."""
    images, (classes, bins) = len(statistics.images), statistics.grid
    of_image = statistics.ground_truth_image * classes + statistics.ground_truth_cell // bins
    counts = np.bincount(of_image, minlength=images * classes).reshape(images, classes)
    return np.asarray(total(weights, counts.astype(np.float32)).astype(np.float64))


def _sums_at_working_points(statistics: Statistics, weights: Weighting, working_point: Float64Array) -> Float64Array:
    """Return (R, C, B, 5): in each depth bin the sums of the four similarities and the count of the true positives.

    Resamples that chose the same working point for a class share the sums of each image.
    """
    classes, bins = statistics.grid
    result = np.zeros((*working_point.shape, bins - 1, statistics.pair_similarities.shape[1] + 1))
    for label in range(classes):
        for point in np.unique(working_point[:, label]):
            rows = np.flatnonzero(working_point[:, label] == point)
            images, sums = _sums_by_image(statistics, label, float(point))
            flat = sums.reshape(len(images), sums.shape[1] * sums.shape[2])
            result[rows, label] = total_of(weights, rows, images, flat).reshape(-1, *sums.shape[1:])
    return result


def _sums_by_image(statistics: Statistics, label: int, working_point: float) -> tuple[NDArray[np.intp], Float64Array]:
    """Sum up a class's true positives at a working point, image by image.

    Returns:
        The images that have any, and for each of them (B, 5): in each depth bin the sums of the four similarities
        and the count.
    """
    _, bins = statistics.grid
    wanted = np.flatnonzero(statistics.pair_cell // bins == label)
    wanted = wanted[_is_true_positive(statistics, wanted, working_point)]
    images, position = np.unique(statistics.pair_image[wanted], return_inverse=True)
    group = position * bins + statistics.pair_cell[wanted] % bins
    columns = [*statistics.pair_similarities[wanted].T, None]
    sums = np.zeros((len(images) * bins, len(columns)))
    for column, values in enumerate(columns):
        sums[:, column] = np.bincount(group, weights=values, minlength=len(sums))
    return images.astype(np.intp), sums.reshape(len(images), bins, len(columns))[:, :-1]


def _is_true_positive(statistics: Statistics, pairs: NDArray[np.intp], working_point: float) -> NDArray[np.bool_]:
    """Return whether each of these pairs is a true positive at the working point."""
    if statistics.protocol.name == PAPER.name:
        return np.asarray(statistics.pair_score[pairs] >= working_point)
    threshold = int(np.searchsorted(statistics.thresholds, working_point))
    return has_threshold(statistics.pair_masks[pairs], threshold)


def _bin_means(sums: Float64Array) -> Float64Array:
    """Return (R, C, B, 4) similarities of each depth bin; NaN without a true positive."""
    counts = sums[..., -1:]
    return np.where(counts > 0, sums[..., :-1] / np.maximum(counts, 1), np.nan)


def _mean_over_classes(classes: Float64Array) -> Float64Array:
    """Average (R, C, 6) over the defined classes; NaN where none is."""
    defined = ~np.isnan(classes)
    count = defined.sum(axis=1)
    total = np.where(defined, classes, 0).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
