"""All scores for many weightings of the images at once, from the statistics alone.

A weighting counts every image a whole number of times. With all weights 1 the result equals evaluator/scoring.py, or
evaluator/paper_scoring.py under the protocol `paper`. The working point is chosen anew for each weighting. Undefined is
NaN here: a class, or the metric of a depth bin, that no image of the resample holds anything for.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluator.paper_replicates import ScoreCurves
from evaluator.predictions import Float64Array
from evaluator.protocol import PAPER
from evaluator.resampling import Weighting, totals_of
from evaluator.statistics import Statistics
from evaluator.threshold_replicates import ThresholdCurves
from evaluator.thresholds import has_threshold
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
    """(R, C, B, 5) in the order of `BIN_METRICS`; NaN also in bins not asked for, and B is 0 where none are."""


class Replicator:
    """Computes all scores of one submission for weightings of the images; what these have in common is done once."""

    def __init__(self, statistics: Statistics) -> None:
        """Take the outcomes of I images."""
        self._statistics = statistics
        self._by_paper = statistics.protocol.name == PAPER.name
        self._curves = ScoreCurves(statistics) if self._by_paper else ThresholdCurves(statistics)

    def replicate(self, weights: Weighting, bins: NDArray[np.bool_] | None = None) -> Replicates:
        """Compute all scores for each weighting.

        Args:
            weights: (R, I) how often each image counts, or the jackknife.
            bins: (C, B) of which depth bins to compute the metrics, too; those of the others are NaN. None: no bins.

        Returns:
            The replicates.
        """
        ap, working_point = self._curves.of_classes(weights)
        sums = _sums_at_working_points(self._statistics, weights, working_point)
        similarities = (integral_over_range if self._by_paper else mean_over_bins)(sums[..., :-1], sums[..., -1])
        detection = ap * similarities.sum(axis=-1) / similarities.shape[-1]
        classes = np.concatenate([ap[..., None], similarities, detection[..., None]], axis=-1)
        classes[np.isnan(ap)] = np.nan
        depth_bins = self._depth_bins(weights, sums, bins)
        return Replicates(classes, _mean_over_classes(classes), working_point, sums[..., -1], depth_bins)

    def _depth_bins(self, weights: Weighting, sums: Float64Array, wanted: NDArray[np.bool_] | None) -> Float64Array:
        """Return `Replicates.depth_bins` by (R, C, B, 5) sums at the working points."""
        if wanted is None:
            return np.zeros((*sums.shape[:2], 0, len(BIN_METRICS)))
        classes, bins = self._statistics.grid
        cells = np.arange(classes * bins).reshape(classes, bins)[:, :-1][wanted]
        result = np.full((*sums.shape[:-1], len(BIN_METRICS)), np.nan)
        result[:, wanted, 0] = self._curves.of_cells(weights, cells)
        result[:, wanted, 1:] = _bin_means(sums[:, wanted])
        return result


def replicate(statistics: Statistics, weights: Weighting, *, by_depth: bool = False) -> Replicates:
    """Compute all scores for each weighting (`Replicator.replicate`), and those of every depth bin if asked for."""
    return Replicator(statistics).replicate(weights, every_bin(statistics) if by_depth else None)


def every_bin(statistics: Statistics) -> NDArray[np.bool_]:
    """Ask for the metrics of all depth bins, (C, B)."""
    classes, bins = statistics.grid
    return np.ones((classes, bins - 1), dtype=np.bool_)


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
            result[rows, label] = totals_of(weights, rows, images, flat).reshape(-1, *sums.shape[1:])
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
    """Return (..., 4) similarities of depth bins, by (..., 5) sums; NaN without a true positive."""
    counts = sums[..., -1:]
    return np.where(counts > 0, sums[..., :-1] / np.maximum(counts, 1), np.nan)


def _mean_over_classes(classes: Float64Array) -> Float64Array:
    """Average (R, C, 6) over the defined classes; NaN where none is."""
    defined = ~np.isnan(classes)
    count = defined.sum(axis=1)
    total = np.where(defined, classes, 0).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
