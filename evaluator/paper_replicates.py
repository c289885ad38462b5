"""Average precision and working points of the protocol `paper`, for many weightings of the images at once.

Between two scores of true positives only false positives come in: precision falls and recall stays, so neither the
envelope nor c_w can lie there. The curves are therefore computed at the scores of true positives alone, which is exact.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from evaluator.average_precision import precision_and_recall
from evaluator.predictions import Float64Array
from evaluator.resampling import WeightArray, Weighting, weighting_count, weights_of_images
from evaluator.statistics import Statistics


@dataclass(frozen=True, slots=True)
class _Group:
    """One class, or one class in one depth bin: S distinct scores of true positives."""

    scores: Float64Array
    """(S,) ascending."""
    true_image: NDArray[np.intp]
    """Image of each true positive, in the order of their scores."""
    true_start: NDArray[np.intp]
    """(S,) the first true positive with each score."""
    false_image: NDArray[np.intp]
    """Image of each false positive, in the order of their scores."""
    false_start: NDArray[np.intp]
    """(S,) the first false positive with at least each score."""
    ground_truth_image: NDArray[np.intp]
    """Image of each ground-truth box."""


class ScoreCurves:
    """Precision and recall of one submission at every score; its boxes are sorted once."""

    def __init__(self, statistics: Statistics) -> None:
        """Sort on demand.

        Args:
            statistics: Outcomes of I images, matched by `match_by_paper`.
        """
        self._statistics = statistics

    def of_classes(self, weights: Weighting) -> tuple[Float64Array, Float64Array]:
        """Compute AP and c_w of each class.

        Args:
            weights: (R, I) how often each image counts, or the jackknife.

        Returns:
            AP and c_w, both (R, C); AP is NaN without ground truth in the resample, and 0, as c_w is, without true
            positives. A fixed c_w is what it is in every row.
        """
        ap, working_point = _curves(self._classes, weights)
        fixed = self._statistics.protocol.working_point
        return ap, working_point if fixed is None else np.full_like(ap, min(max(fixed, 0.0), 1.0))

    def of_cells(self, weights: Weighting, cells: NDArray[np.intp]) -> Float64Array:
        """Compute AP in depth bins.

        Args:
            weights: (R, I) how often each image counts, or the jackknife.
            cells: (N,) which classes in which depth bins.

        Returns:
            (R, N); NaN without ground truth in the resample.
        """
        return _curves([self._cells[cell] for cell in cells.tolist()], weights)[0]

    @cached_property
    def _classes(self) -> list[_Group]:
        classes, bins = self._statistics.grid
        return _groups(self._statistics, np.arange(classes * bins) // bins, classes)

    @cached_property
    def _cells(self) -> list[_Group]:
        cells = int(np.prod(self._statistics.grid))
        return _groups(self._statistics, np.arange(cells), cells)


def _groups(statistics: Statistics, group_of_cell: NDArray[np.intp], groups: int) -> list[_Group]:
    """Sort the outcomes of each of G groups of cells by score."""
    true_group = group_of_cell[statistics.pair_cell]
    false_group = group_of_cell[statistics.false_positive_cell]
    ground_truth_group = group_of_cell[statistics.ground_truth_cell]
    return [
        _group(statistics, true_group == index, false_group == index, ground_truth_group == index)
        for index in range(groups)
    ]


def _group(
    statistics: Statistics,
    is_true: NDArray[np.bool_],
    is_false: NDArray[np.bool_],
    is_ground_truth: NDArray[np.bool_],
) -> _Group:
    true_score, false_score = statistics.pair_score[is_true], statistics.false_positive_score[is_false]
    true_order, false_order = np.argsort(true_score), np.argsort(false_score)
    scores, true_start = np.unique(true_score[true_order], return_index=True)
    return _Group(
        scores=scores,
        true_image=statistics.pair_image[is_true][true_order].astype(np.intp),
        true_start=true_start,
        false_image=statistics.false_positive_image[is_false][false_order].astype(np.intp),
        false_start=np.searchsorted(false_score[false_order], scores),
        ground_truth_image=statistics.ground_truth_image[is_ground_truth].astype(np.intp),
    )


def _curves(groups: list[_Group], weights: Weighting) -> tuple[Float64Array, Float64Array]:
    """Return AP and c_w of G groups, both (R, G); AP is NaN without ground truth in the resample."""
    count = weighting_count(weights)
    ap, working_point = np.empty((2, count, len(groups)))
    for start in range(0, count, _WEIGHTINGS_AT_ONCE):
        rows = np.arange(start, min(start + _WEIGHTINGS_AT_ONCE, count))
        of_image = weights_of_images(weights, rows)
        for index, group in enumerate(groups):
            ap[rows, index], working_point[rows, index] = _sweep(group, of_image)
    return ap, working_point


_WEIGHTINGS_AT_ONCE = 2000
"""So that of the jackknife of many images not all weights are in memory."""

_SCORES_AT_ONCE = 32
"""A block of so many scores under so many weightings stays in the processor's cache."""


def _sweep(group: _Group, of_image: WeightArray) -> tuple[Float64Array, Float64Array]:
    """Return AP and c_w of one group, both (R,), going from its lowest score to the highest.

    Args:
        group: S scores.
        of_image: (I, R) how often each image counts.
    """
    ground_truth = _total(of_image, group.ground_truth_image).astype(np.float64)
    ap, envelope, working_point = np.zeros((3, len(ground_truth)))
    greatest = np.full(len(ground_truth), -1.0)
    blocks = range(0, len(group.scores), _SCORES_AT_ONCE)
    for start, true, false in zip(
        blocks,
        _at_least(of_image, group.true_image, group.true_start),
        _at_least(of_image, group.false_image, group.false_start),
        strict=True,
    ):
        precision, recall = precision_and_recall(true.T, false.T, ground_truth)
        area, envelope = _area(precision, recall, envelope)
        ap += area
        product = precision * recall
        value = product.max(axis=1)
        better = np.flatnonzero(value > greatest)
        greatest[better] = value[better]
        working_point[better] = group.scores[start + product[better].argmax(axis=1)]
    return np.where(ground_truth > 0, ap, np.nan), working_point


def _area(precision: Float64Array, recall: Float64Array, envelope: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return (R,) what (R, S) further scores add to AP, and the envelope after them, by the (R,) envelope before.

    Each step of the envelope counts with the recall down to which it holds.
    """
    steps = np.empty((precision.shape[1] + 1, len(precision)))
    steps[0] = envelope
    for at_score, before, after in zip(precision.T, steps, steps[1:], strict=False):
        np.maximum(before, at_score, out=after)
    return np.einsum("sr,sr->r", np.diff(steps, axis=0), recall.T), steps[-1]


def _at_least(of_image: WeightArray, images: NDArray[np.intp], start: NDArray[np.intp]) -> Iterator[Float64Array]:
    """Yield, block by block of starts, (S, R) sums of the weights of the images from each start to the end."""
    left = _total(of_image, images[start.min(initial=len(images)) :])
    spans = list(pairwise([*start.tolist(), len(images)]))
    for first in range(0, len(spans), _SCORES_AT_ONCE):
        block = spans[first : first + _SCORES_AT_ONCE]
        sums = np.empty((len(block), len(left)))
        for sum_, (begin, end) in zip(sums, block, strict=True):
            sum_[:] = left
            for image in images[begin:end].tolist():
                left -= of_image[image]
        yield sums


def _total(of_image: WeightArray, images: NDArray[np.intp]) -> WeightArray:
    """Return (R,) how many of these images, which may come more than once, each weighting counts. Exact below 2^24."""
    return np.bincount(images, minlength=len(of_image)).astype(np.float32) @ of_image
