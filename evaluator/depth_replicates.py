"""Average precision of every class in every depth bin, for many weightings of the images at once.

A cell, one class in one depth bin, holds something in a few images only. So each cell is weighted on its own images,
and of the jackknife only the units with such an image are computed.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluator.average_precision import average_precision, precision_and_recall
from evaluator.predictions import Float64Array
from evaluator.resampling import FloatingArray, Weighting, affected_rows, total_of, weighting_count
from evaluator.statistics import Statistics
from evaluator.thresholds import count_by_group


@dataclass(frozen=True, slots=True)
class Cell:
    """What J images hold of one class in one depth bin; T thresholds."""

    label: int
    depth_bin: int
    images: NDArray[np.intp]
    """(J,)."""
    counts: NDArray[np.float32]
    """(J, 2 T + 1): true positives and false positives at each threshold, ground truth."""


def depth_average_precision(statistics: Statistics, weights: Weighting) -> Float64Array:
    """Compute AP in each depth bin by the protocol `cityscapes3d`.

    Args:
        statistics: Outcomes of I images.
        weights: (R, I) how often each image counts, or the jackknife.

    Returns:
        (R, C, B), B without the bin beyond the maximum depth; NaN without ground truth in the resample.
    """
    classes, bins = statistics.grid
    result = np.full((weighting_count(weights), classes, bins), np.nan)
    for cell in cells(statistics):
        rows = affected_rows(weights, cell.images)
        target = result[:, cell.label, cell.depth_bin]
        target[:] = _average_precision(cell.counts.sum(axis=0)[None])
        target[rows] = _average_precision(total_of(weights, rows, cell.images, cell.counts))
    return result[..., :-1]


def cells(statistics: Statistics) -> Iterator[Cell]:
    """Gather what the images hold, cell by cell; cells without ground truth are left out."""
    images, thresholds, (_, bins) = len(statistics.images), len(statistics.thresholds), statistics.grid
    found = [
        statistics.pair_cell * images + statistics.pair_image,
        statistics.false_positive_cell * images + statistics.false_positive_image,
        statistics.ground_truth_cell * images + statistics.ground_truth_image,
    ]
    places = np.unique(np.concatenate(found))
    pair, false_positive, ground_truth = (np.searchsorted(places, place) for place in found)
    counts = np.concatenate(
        [
            count_by_group(pair, statistics.pair_masks, len(places), thresholds),
            count_by_group(false_positive, statistics.false_positive_masks, len(places), thresholds),
            np.bincount(ground_truth, minlength=len(places))[:, None],
        ],
        axis=1,
    ).astype(np.float32)
    for cell in np.unique(statistics.ground_truth_cell).tolist():
        own = slice(*np.searchsorted(places, [cell * images, (cell + 1) * images]).tolist())
        yield Cell(cell // bins, cell % bins, places[own] - cell * images, counts[own])


def _average_precision(cell_counts: FloatingArray) -> Float64Array:
    """Return (R,) AP of (R, 2 T + 1) counts; NaN without ground truth."""
    counts: Float64Array = cell_counts.astype(np.float64)
    thresholds = counts.shape[1] // 2
    ground_truth = counts[:, -1]
    precision, recall = precision_and_recall(counts[:, :thresholds], counts[:, thresholds:-1], ground_truth)
    return np.where(ground_truth > 0, _area(precision, recall), np.nan)


def _area(precision: Float64Array, recall: Float64Array) -> Float64Array:
    """Return the AP of (R, T) curves, without sorting where recall only falls with the threshold, as it nearly always does."""
    if (recall[:, 1:] > recall[:, :-1]).any():
        return average_precision(precision, recall)
    envelope = np.maximum.accumulate(precision, axis=1)
    return np.asarray((-np.diff(recall, axis=1, append=0.0) * envelope).sum(axis=1))
