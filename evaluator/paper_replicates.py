"""Average precision and working points of the protocol `paper`, for many weightings of the images at once.

Between two scores of true positives only false positives come in: precision falls and recall stays, so neither the
envelope nor c_w can lie there. The curves are therefore computed at the scores of true positives alone, which is exact.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluator.average_precision import precision_and_recall
from evaluator.predictions import Float64Array
from evaluator.resampling import Weighting, weighting_count, weights_of
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
    """Image of each false positive with at least the lowest of the scores, in the order of their scores."""
    false_start: NDArray[np.intp]
    """(S,) the first false positive with at least each score."""
    ground_truth_image: NDArray[np.intp]
    """Image of each ground-truth box."""


def paper_average_precision(statistics: Statistics, weights: Weighting) -> tuple[Float64Array, Float64Array]:
    """Compute AP and c_w of each class.

    Args:
        statistics: Outcomes of I images, matched by `match_by_paper`.
        weights: (R, I) how often each image counts, or the jackknife.

    Returns:
        AP and c_w, both (R, C); 0 without true positives. A fixed c_w is what it is in every row.
    """
    classes, bins = statistics.grid
    ap, working_point = _by_group(statistics, weights, np.arange(classes * bins) // bins)
    fixed = statistics.protocol.working_point
    return ap, working_point if fixed is None else np.full_like(ap, min(max(fixed, 0.0), 1.0))


def paper_depth_average_precision(statistics: Statistics, weights: Weighting) -> Float64Array:
    """Compute AP in each depth bin: (R, C, B), NaN without ground truth in the resample."""
    classes, bins = statistics.grid
    ap, _ = _by_group(statistics, weights, np.arange(classes * bins))
    return ap.reshape(-1, classes, bins)[..., :-1]


def _by_group(
    statistics: Statistics, weights: Weighting, group_of_cell: NDArray[np.intp]
) -> tuple[Float64Array, Float64Array]:
    """Return AP and c_w of each of G groups of cells, both (R, G): AP is NaN without ground truth in the resample."""
    groups = int(group_of_cell.max()) + 1
    ap, working_point = np.zeros((2, weighting_count(weights), groups))
    for index, group in enumerate(_groups(statistics, group_of_cell, groups)):
        for rows in _blocks(weighting_count(weights), max(len(group.true_image), len(group.false_image))):
            ap[rows, index], working_point[rows, index] = _curves(group, weights, rows)
    return ap, working_point


def _blocks(count: int, boxes: int) -> list[NDArray[np.intp]]:
    """Split weightings so that the curves of a block, which have so many boxes, stay small in memory."""
    rows = min(_MOST_ROWS, max(1, _MOST_NUMBERS // max(1, boxes)))
    return np.array_split(np.arange(count), max(1, -(-count // rows)))


_MOST_ROWS = 250
_MOST_NUMBERS = 1_000_000
"""Weights in a block, about 20 bytes each with their sums."""


def _groups(statistics: Statistics, group_of_cell: NDArray[np.intp], groups: int) -> list[_Group]:
    """Sort the outcomes of each group by score."""
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


def _curves(group: _Group, weights: Weighting, rows: NDArray[np.intp]) -> tuple[Float64Array, Float64Array]:
    """Return AP and c_w of one group under some of the weightings."""
    ground_truth = weights_of(weights, rows, group.ground_truth_image).sum(axis=1, dtype=np.float64)
    if not len(group.scores):
        return np.where(ground_truth > 0, 0.0, np.nan), np.zeros(len(rows))
    precision, recall = precision_and_recall(
        _at_least(weights_of(weights, rows, group.true_image), group.true_start),
        _at_least(weights_of(weights, rows, group.false_image), group.false_start),
        ground_truth,
    )
    envelope = np.maximum.accumulate(precision, axis=1)
    ap = (-np.diff(recall, axis=1, append=0.0) * envelope).sum(axis=1)
    return np.where(ground_truth > 0, ap, np.nan), group.scores[np.argmax(precision * recall, axis=1)]


def _at_least(weighted: NDArray[np.float32], start: NDArray[np.intp]) -> Float64Array:
    """Sum (R, N) weights of what is ordered by score from each start to the end: (R, S)."""
    sums = np.zeros((len(weighted), weighted.shape[1] + 1))
    np.cumsum(weighted, axis=1, out=sums[:, 1:], dtype=np.float64)
    return np.asarray(sums[:, -1:] - sums[:, start])
