"""What scores mean: how often a score is right, where c_w lies, how finely scores are told apart.

A prediction's outcome here is the one at the highest threshold it reaches, that is among the predictions with about its
score or more: at lower thresholds a better-fitting prediction may take its box. Discarded predictions have no outcome.
"""

from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from evaluator.average_precision import average_precision
from evaluator.diagnosis.working_point import BoolArray, WorkingPoint
from evaluator.evaluation import Evaluation
from evaluator.predictions import Float64Array
from evaluator.results import ClassScore, DepthBin
from evaluator.thresholds import active_masks, has_threshold

RELIABILITY_BINS = 10


class ReliabilityBin(msgspec.Struct, frozen=True, kw_only=True):
    """Predictions with scores in [lower, upper); the last bin includes its upper end."""

    lower: float
    upper: float
    count: int
    mean_score: float | None
    """None without predictions."""
    precision: float | None
    """Share of true positives, in [0, 1]; equal to `mean_score` for a calibrated method. None without predictions."""


class DepthWorkingPoint(msgspec.Struct, frozen=True, kw_only=True):
    """How well the one c_w of a class suits one depth bin."""

    lower_m: int
    upper_m: int
    best_threshold: float
    """Lowest threshold with the greatest precision x recall within the bin."""
    best_precision_recall: float
    precision_recall: float
    """Precision x recall within the bin at the class's c_w."""
    loss: float
    """best_precision_recall - precision_recall, at least 0; smaller is better."""


class ScoreResolution(msgspec.Struct, frozen=True, kw_only=True):
    """Whether scores are spread so that the protocol's thresholds can tell them apart."""

    prediction_count: int
    distinct_score_count: int
    used_level_count: int
    """Levels between neighbouring thresholds that hold predictions."""
    level_count: int
    never_active_count: int
    """Predictions with a score below every threshold."""
    fullest_level_share: float | None
    """Share of the predictions in the fullest level, smaller is better; None without predictions."""
    ap: float
    """AP as scored, on the thresholds of the protocol."""
    ap_all_scores: float
    """AP with every distinct score as a threshold, outcomes as at each prediction's highest threshold."""


class Calibration(msgspec.Struct, frozen=True, kw_only=True):
    """What the scores of one class mean."""

    reliability: tuple[ReliabilityBin, ...]
    expected_calibration_error: float | None
    """Mean of |mean score - precision| over the bins, weighed by their counts; in [0, 1], smaller is better."""
    depth_working_points: tuple[DepthWorkingPoint, ...]
    """Of the depth bins with ground truth."""
    resolution: ScoreResolution


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcomes:
    """Predictions of one class that are a true or a false positive at the highest threshold they reach."""

    score: Float64Array
    """(N,)."""
    right: BoolArray
    """(N,)."""


def outcomes(evaluation: Evaluation, point: WorkingPoint, class_index: int) -> Outcomes:
    """Collect the outcomes of one class."""
    matches, predictions = evaluation.matches, evaluation.predictions
    level = np.bitwise_count(active_masks(predictions.score, matches.thresholds)).astype(np.intp)
    highest = np.maximum(level - 1, 0)
    right = np.zeros(len(predictions), dtype=bool)
    at_highest = has_threshold(matches.pair_thresholds, highest[matches.prediction_index])
    right[matches.prediction_index[at_highest]] = True
    discarded = has_threshold(matches.ignored_thresholds, highest)
    rows = (level > 0) & ~discarded & (point.prediction_class == class_index)
    return Outcomes(score=predictions.score[rows], right=right[rows])


def calibrate(evaluation: Evaluation, point: WorkingPoint, class_index: int) -> Calibration:
    """Measure one class with ground truth."""
    score = evaluation.scores.classes[class_index]
    found = outcomes(evaluation, point, class_index)
    bins = reliability(found)
    own = point.prediction_class == class_index
    return Calibration(
        reliability=bins,
        expected_calibration_error=expected_calibration_error(bins),
        depth_working_points=depth_working_points(
            score, int(point.threshold_index[class_index]), evaluation.scores.thresholds
        ),
        resolution=score_resolution(evaluation.predictions.score[own], found, score, evaluation.matches.thresholds),
    )


def reliability(found: Outcomes) -> tuple[ReliabilityBin, ...]:
    """Compare scores with how often they are right, in ten bins of equal width; scores above 1 count as 1."""
    index = np.clip((found.score * RELIABILITY_BINS).astype(np.intp), 0, RELIABILITY_BINS - 1)
    count = np.bincount(index, minlength=RELIABILITY_BINS)
    right = np.bincount(index, weights=found.right, minlength=RELIABILITY_BINS)
    total = np.bincount(index, weights=np.minimum(found.score, 1.0), minlength=RELIABILITY_BINS)
    return tuple(
        ReliabilityBin(
            lower=bin_index / RELIABILITY_BINS,
            upper=(bin_index + 1) / RELIABILITY_BINS,
            count=int(count[bin_index]),
            mean_score=float(total[bin_index] / count[bin_index]) if count[bin_index] else None,
            precision=float(right[bin_index] / count[bin_index]) if count[bin_index] else None,
        )
        for bin_index in range(RELIABILITY_BINS)
    )


def expected_calibration_error(bins: tuple[ReliabilityBin, ...]) -> float | None:
    """Return the mean gap between score and precision, weighed by predictions; None without any (Naeini et al. 2015)."""
    total = sum(part.count for part in bins)
    gaps = [
        part.count * abs(part.mean_score - part.precision)
        for part in bins
        if part.mean_score is not None and part.precision is not None
    ]
    return sum(gaps) / total if total else None


def depth_working_points(
    score: ClassScore, threshold_index: int, thresholds: tuple[float, ...]
) -> tuple[DepthWorkingPoint, ...]:
    """Compare c_w with the best threshold of each depth bin that has ground truth."""
    return tuple(
        _depth_working_point(depth_bin, threshold_index, thresholds)
        for depth_bin in score.depth_bins
        if depth_bin.ground_truth_count
    )


def _depth_working_point(depth_bin: DepthBin, threshold_index: int, thresholds: tuple[float, ...]) -> DepthWorkingPoint:
    """Compare within one depth bin."""
    product = np.array(depth_bin.precision) * np.array(depth_bin.recall)
    best = int(product.argmax())
    return DepthWorkingPoint(
        lower_m=depth_bin.lower_m,
        upper_m=depth_bin.upper_m,
        best_threshold=thresholds[best],
        best_precision_recall=float(product[best]),
        precision_recall=float(product[threshold_index]),
        loss=float(product[best] - product[threshold_index]),
    )


def score_resolution(
    scores: Float64Array, found: Outcomes, score: ClassScore, thresholds: Float64Array
) -> ScoreResolution:
    """Audit how the scores of one class lie on the protocol's thresholds.

    Args:
        scores: (N,) of all predictions of the class.
        found: Those with an outcome.
        score: What the class was given.
        thresholds: (T,) ascending.
    """
    level = np.bitwise_count(active_masks(scores, thresholds)).astype(np.intp)
    filled = np.bincount(level, minlength=len(thresholds) + 1)
    return ScoreResolution(
        prediction_count=len(scores),
        distinct_score_count=len(np.unique(scores)),
        used_level_count=int((filled[1:] > 0).sum()),
        level_count=len(thresholds),
        never_active_count=int(filled[0]),
        fullest_level_share=float(filled.max() / len(scores)) if len(scores) else None,
        ap=score.ap or 0.0,
        ap_all_scores=ap_all_scores(found, score.ground_truth_count),
    )


def ap_all_scores(found: Outcomes, ground_truth_count: int) -> float:
    """Return the AP with every distinct score as a threshold, in [0, 1]; 0 without predictions."""
    order = np.argsort(-found.score, kind="stable")
    score, right = found.score[order], found.right[order]
    end_of_tie = np.append(score[1:] != score[:-1], values=True)[: len(score)]
    counted: NDArray[np.intp] = np.flatnonzero(end_of_tie) + 1
    hits = np.cumsum(right)[end_of_tie]
    return float(average_precision(hits / np.maximum(counted, 1), hits / max(ground_truth_count, 1)))
