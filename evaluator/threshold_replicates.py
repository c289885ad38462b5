"""Average precision and working points of the protocol `cityscapes3d`, for many weightings of the images at once.

A group, one class or one class in one depth bin, is found in some of the images only. So each group is weighted on its
own images, and of the jackknife only the units with such an image are computed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from evaluator.average_precision import average_precision, precision_and_recall, working_point_index
from evaluator.predictions import Float64Array
from evaluator.resampling import FloatingArray, Weighting, totals, weighting_count
from evaluator.statistics import Statistics
from evaluator.thresholds import MaskArray, count_by_group, prefix_masks, unpacked


@dataclass(frozen=True, slots=True)
class _Group:
    """What J images hold of one class, or of one class in one depth bin, at K thresholds."""

    images: NDArray[np.intp]
    """(J,)."""
    counts: NDArray[np.float32]
    """(J, 2 K + 1): true positives and false positives at each threshold, ground truth. Exact: far below 2^24."""


class ThresholdCurves:
    """Precision and recall of one submission on the score thresholds; what each image holds is counted once."""

    def __init__(self, statistics: Statistics) -> None:
        """Count on demand."""
        self._statistics = statistics

    def of_classes(self, weights: Weighting) -> tuple[Float64Array, Float64Array]:
        """Compute AP and c_w of each class.

        Args:
            weights: (R, I) how often each image counts, or the jackknife.

        Returns:
            AP and c_w, both (R, C); AP is NaN without ground truth in the resample.
        """
        ap, working_point = np.empty((2, len(self._classes), weighting_count(weights)))
        for label, group in enumerate(self._classes):
            counts, of_row = totals(weights, group.images, group.counts)
            precision, recall, ground_truth = _curves(counts)
            ap[label] = _average_precision(precision, recall, ground_truth)[of_row]
            working_point[label] = self._working_point(precision, recall)[of_row]
        return ap.T, working_point.T

    def of_cells(self, weights: Weighting, cells: NDArray[np.intp]) -> Float64Array:
        """Compute AP in depth bins.

        Args:
            weights: (R, I) how often each image counts, or the jackknife.
            cells: (N,) which classes in which depth bins.

        Returns:
            (R, N); NaN without ground truth in the resample.
        """
        ap = np.empty((len(cells), weighting_count(weights)))
        for row, cell in zip(ap, cells.tolist(), strict=True):
            counts, of_row = totals(weights, self._cells[cell].images, self._cells[cell].counts)
            row[:] = _average_precision(*_curves(counts))[of_row]
        return ap.T

    @cached_property
    def _classes(self) -> list[_Group]:
        classes, bins = self._statistics.grid
        every = np.full(classes, prefix_masks(len(self._statistics.thresholds))[-1])
        return list(_groups(self._statistics, np.arange(classes * bins) // bins, every))

    @cached_property
    def _cells(self) -> list[_Group]:
        cells = int(np.prod(self._statistics.grid))
        return list(_groups(self._statistics, np.arange(cells), _decisive_thresholds(self._statistics)))

    def _working_point(self, precision: Float64Array, recall: Float64Array) -> Float64Array:
        thresholds = self._statistics.thresholds
        index = working_point_index(precision, recall, thresholds, self._statistics.protocol.working_point)
        return np.asarray(thresholds[index])


def _curves(counts: FloatingArray) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return precision and recall, both (S, K), and ground truth (S,) of (S, 2 K + 1) counts."""
    exact: Float64Array = counts.astype(np.float64)
    true_positives, false_positives = np.split(exact[:, :-1], 2, axis=1)
    ground_truth = exact[:, -1]
    return *precision_and_recall(true_positives, false_positives, ground_truth), ground_truth


def _average_precision(precision: Float64Array, recall: Float64Array, ground_truth: Float64Array) -> Float64Array:
    """Return (S,) AP, NaN without ground truth."""
    return np.where(ground_truth > 0, average_precision(precision, recall), np.nan)


def _decisive_thresholds(statistics: Statistics) -> MaskArray:
    """Return of each cell the thresholds that can decide on its AP under any weighting.

    Where until the next threshold no true positive goes and no false positive comes, the next one has at least the
    precision and the recall.
    """
    decisive = np.zeros(int(np.prod(statistics.grid)), dtype=np.uint64)
    true, false = statistics.pair_masks, statistics.false_positive_masks
    np.bitwise_or.at(decisive, statistics.pair_cell, true & ~(true >> np.uint64(1)))
    np.bitwise_or.at(decisive, statistics.false_positive_cell, ~false & (false >> np.uint64(1)))
    return decisive


def _groups(statistics: Statistics, group_of_cell: NDArray[np.intp], wanted: MaskArray) -> Iterator[_Group]:
    """Gather what the images hold of each of G groups of cells at the (G,) wanted thresholds."""
    images, thresholds = len(statistics.images), len(statistics.thresholds)
    pair_group, false_group = group_of_cell[statistics.pair_cell], group_of_cell[statistics.false_positive_cell]
    counted = np.flatnonzero(statistics.false_positive_masks & wanted[false_group])
    found = [
        pair_group * images + statistics.pair_image,
        false_group[counted] * images + statistics.false_positive_image[counted],
        group_of_cell[statistics.ground_truth_cell] * images + statistics.ground_truth_image,
    ]
    places = np.unique(np.concatenate(found))
    pair, false_positive, ground_truth = (np.searchsorted(places, place) for place in found)
    counts = np.concatenate(
        [
            count_by_group(pair, statistics.pair_masks, len(places), thresholds),
            count_by_group(false_positive, statistics.false_positive_masks[counted], len(places), thresholds),
            np.bincount(ground_truth, minlength=len(places))[:, None],
        ],
        axis=1,
        dtype=np.float32,
    )
    kept = np.pad(np.tile(unpacked(wanted, thresholds), 2), ((0, 0), (0, 1)), constant_values=True)
    starts = np.searchsorted(places, np.arange(len(wanted) + 1) * images)
    for group in range(len(wanted)):
        own = slice(starts[group], starts[group + 1])
        yield _Group(places[own] - group * images, counts[own].compress(kept[group], axis=1))
