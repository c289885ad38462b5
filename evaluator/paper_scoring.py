"""Aggregation by the paper's words (protocol `paper`): AP over all scores, integrals over the whole depth range.

Paper, sections 2D Average Precision and Depth-Dependent True Positive Metrics. The curves stored with the result are
sampled at the score thresholds; AP and the working point come from every score that occurs.
"""

import numpy as np
from numpy.typing import NDArray

from evaluator.average_precision import average_precision, precision_and_recall
from evaluator.predictions import Float64Array
from evaluator.results import Scores
from evaluator.scoring import Aggregates, assemble, count, sum_true_positives
from evaluator.statistics import Statistics
from evaluator.true_positive_metrics import integral_over_range


def score_by_paper(statistics: Statistics) -> Scores:
    """Compute the whole result by the protocol `paper`.

    Args:
        statistics: Outcomes of all images, matched by `match_by_paper`.

    Returns:
        The scores; None wherever there is no ground truth to measure on.
    """
    classes, bins = statistics.grid
    counts = count(statistics)
    ap, working_point = _by_group(statistics, np.arange(classes * bins) // bins, counts.ground_truth.sum(axis=1))
    depth_ap, _ = _by_group(statistics, np.arange(classes * bins), counts.ground_truth.ravel())
    fixed = statistics.protocol.working_point
    if fixed is not None:
        working_point = np.full(classes, min(max(fixed, 0.0), 1.0))
    at_point = statistics.pair_score >= working_point[statistics.pair_cell // bins]
    true_positives = sum_true_positives(statistics, at_point)
    aggregates = Aggregates(
        counts=counts,
        ap=ap,
        depth_ap=depth_ap.reshape(classes, bins)[:, :-1],
        working_point=working_point,
        true_positives=true_positives,
        similarities=integral_over_range(true_positives.sums, true_positives.counts),
    )
    return assemble(statistics, aggregates)


def all_score_curve(
    true_scores: Float64Array, false_scores: Float64Array, ground_truth_count: int
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Compute precision and recall at every score that occurs.

    Args:
        true_scores: Scores of the true positives.
        false_scores: Scores of the false positives.
        ground_truth_count: Boxes to be found.

    Returns:
        The S distinct scores, ascending, precision (S,) and recall (S,) counting all predictions of at least it.
    """
    scores = np.unique(np.concatenate([true_scores, false_scores]))
    tp, fp = (
        len(found) - np.searchsorted(np.sort(found), scores, side="left") for found in (true_scores, false_scores)
    )
    return scores, *precision_and_recall(tp, fp, np.array(ground_truth_count))


def _by_group(
    statistics: Statistics, group_of_cell: NDArray[np.intp], ground_truth_count: NDArray[np.int64]
) -> tuple[Float64Array, Float64Array]:
    """Return AP and working point of each of G groups of cells; 0 for a group without true positives."""
    true_group = group_of_cell[statistics.pair_cell]
    false_group = group_of_cell[statistics.false_positive_cell]
    ap, working_point = np.zeros((2, len(ground_truth_count)))
    for group in np.unique(true_group):
        scores, precision, recall = all_score_curve(
            statistics.pair_score[true_group == group],
            statistics.false_positive_score[false_group == group],
            int(ground_truth_count[group]),
        )
        ap[group] = average_precision(precision, recall)
        working_point[group] = scores[np.argmax(precision * recall)]
    return ap, working_point
