"""Precision, recall, average precision and the working point, from counts at each score threshold.

Paper, sections 2D Average Precision and Depth-Dependent True Positive Metrics (c_w); reference: `_calculateAp`.
All functions work on any leading axes; the last axis is the score threshold, ascending.
"""

import numpy as np
from numpy.typing import NDArray

from evaluator.predictions import Float64Array

CountArray = NDArray[np.int64] | Float64Array
"""Counts; resampled images make them weighted sums."""


def precision_and_recall(
    true_positives: CountArray, false_positives: CountArray, ground_truth_count: CountArray
) -> tuple[Float64Array, Float64Array]:
    """Compute precision and recall.

    Args:
        true_positives: (..., T) counts.
        false_positives: (..., T) counts.
        ground_truth_count: (...) counts.

    Returns:
        Precision and recall, (..., T) in [0, 1]; both 0 where there is no true positive.
    """
    tp = np.asarray(true_positives, dtype=np.float64)
    detections = tp + false_positives
    precision = tp / np.where(detections > 0, detections, 1)
    recall = tp / np.maximum(np.asarray(ground_truth_count), 1)[..., None]
    return precision, recall


def average_precision(precision: Float64Array, recall: Float64Array) -> Float64Array:
    """Integrate the precision envelope over recall, at all points (Pascal VOC 2010).

    The envelope at recall r is the greatest precision at any recall >= r; beyond the greatest recall it is 0.

    Args:
        precision: (..., T).
        recall: (..., T).

    Returns:
        (...) in [0, 1], greater is better.
    """
    recall, precision = _by_ascending_recall(recall, precision)
    envelope = np.maximum.accumulate(precision[..., ::-1], axis=-1)[..., ::-1]
    return np.asarray((np.diff(recall, axis=-1, prepend=0.0) * envelope).sum(axis=-1))


def _by_ascending_recall(recall: Float64Array, precision: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Order both by recall, without sorting where it only falls with the threshold, as it nearly always does."""
    if (recall[..., 1:] <= recall[..., :-1]).all():
        return recall[..., ::-1], precision[..., ::-1]
    order = np.argsort(recall, axis=-1, kind="stable")
    return np.take_along_axis(recall, order, axis=-1), np.take_along_axis(precision, order, axis=-1)


def working_point_index(
    precision: Float64Array, recall: Float64Array, thresholds: Float64Array, fixed: float | None
) -> NDArray[np.intp]:
    """Choose the score threshold at which true positives are measured (the paper's c_w).

    Args:
        precision: (..., T).
        recall: (..., T).
        thresholds: (T,) ascending.
        fixed: A threshold for every class: limited to [0, 1], then raised to the next one of the grid; or None.

    Returns:
        (...) index of the lowest threshold with the greatest precision x recall (0 where that is 0), or of `fixed`.
    """
    if fixed is None:
        return np.asarray(np.argmax(precision * recall, axis=-1))
    index = np.searchsorted(thresholds, min(max(fixed, 0.0), 1.0), side="left")
    return np.full(precision.shape[:-1], index)
