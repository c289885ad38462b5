"""False positives and misses by cause, and the AP each cause costs.

After Bolya et al., "TIDE: A General Toolbox for Identifying Object Detection Errors", ECCV 2020, for the matching of
this benchmark: the foreground threshold is the protocol's minimum IoU, the background threshold 0.1. A false positive
has the first cause that fits:

    duplicate        it fits a box of its class that another prediction has
    classification   it fits a box of another class
    localisation     it overlaps a box of its class, not enough in 2D
    both             it overlaps a box of another class only, and not enough
    ignore_region    it touches no box, but more than a tenth of it lies in an ignore region
    background       none of these: there is nothing

A missed box is one that is not found; it is `missed` if no false positive of classification or localisation points at
it, so that no mistake is counted twice. Predictions discarded in ignore regions cost nothing and are only counted.

The cost of a cause is the AP that would be won if it were repaired at every score threshold, everything else equal:
duplicates, both, ignore_region and background are taken away; a localisation or classification error becomes a true
positive of the box it points at if that is still free, else it is taken away; missed boxes are taken away from
the ground truth (those that no threshold finds), which leaves nothing to measure in a class that finds none. Costs of different causes do not sum up to the whole loss, because
repairs help each other; loss.py has the exact split.
"""

from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from evaluator.average_precision import average_precision, precision_and_recall
from evaluator.candidates import RowArray
from evaluator.diagnosis.nearest import Nearest
from evaluator.diagnosis.working_point import BoolArray, WorkingPoint
from evaluator.evaluation import Evaluation
from evaluator.matching import Matches
from evaluator.predictions import Float64Array
from evaluator.results import ClassScore
from evaluator.thresholds import MaskArray, count_by_group

BACKGROUND_IOU = 0.1
"""What overlaps less than this is nothing (TIDE's background threshold)."""

FALSE_POSITIVE_CAUSES = ("duplicate", "classification", "localisation", "both", "ignore_region", "background")
_DUPLICATE, _CLASSIFICATION, _LOCALISATION = range(3)


class Cause(msgspec.Struct, frozen=True, kw_only=True):
    """One cause of lost points in one class."""

    name: str
    """One of `FALSE_POSITIVE_CAUSES`, or `missed`."""
    count: int
    """False positives or missed boxes of this cause at the working point."""
    ap_gain: float | None
    """AP with this cause repaired minus AP, at least 0; greater means that it costs more. None where the repair leaves
    no ground truth: missing every box costs everything, and there is no AP without boxes to compare with."""
    detection_score_gain: float | None
    """The same for the detection score, the four similarities being what they are; None, too, without a true positive
    at the working point, because nobody knows the similarities of what is not found."""


class Causes(msgspec.Struct, frozen=True, kw_only=True):
    """Where the predictions and boxes of one class went, at the working point."""

    true_positive_count: int
    false_positive_count: int
    discarded_count: int
    """Unmatched predictions inside ignore regions; they cost nothing."""
    ground_truth_count: int
    missed_count: int
    """Boxes not found; at least the count of the cause `missed`."""
    causes: tuple[Cause, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sorted:
    """The cause of each prediction, and the box a repair would give it."""

    cause: NDArray[np.int8]
    """(N,) index into `FALSE_POSITIVE_CAUSES`; meaningful where the prediction is a false positive."""
    target: RowArray
    """(N,) ground-truth row a classification or localisation error points at, -1 for other causes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Curves:
    """Counts by class and threshold that AP follows from: C classes, T thresholds."""

    true_positives: NDArray[np.int64]
    """(C, T)."""
    false_positives: NDArray[np.int64]
    """(C, T)."""
    ground_truth: NDArray[np.int64]
    """(C,)."""

    def average_precision(self) -> Float64Array:
        """Return (C,) AP in [0, 1]; NaN for a class without ground truth."""
        curves = precision_and_recall(self.true_positives, self.false_positives, self.ground_truth)
        return np.where(self.ground_truth > 0, average_precision(*curves), np.nan)


def sort_by_cause(near: Nearest, min_iou: float) -> Sorted:
    """Give every prediction the cause it would have as a false positive."""
    fits_own, fits_other = near.own_iou > min_iou, near.other_iou > min_iou
    touches_own, touches_other = near.own_iou > BACKGROUND_IOU, near.other_iou > BACKGROUND_IOU
    in_region = near.ignore_coverage > BACKGROUND_IOU
    cause = np.select([fits_own, fits_other, touches_own, touches_other, in_region], np.arange(5), default=5)
    target = np.select([cause == _CLASSIFICATION, cause == _LOCALISATION], [near.other_row, near.own_row], default=-1)
    return Sorted(cause=cause.astype(np.int8), target=target)


def count_curves(matches: Matches, point: WorkingPoint) -> Curves:
    """Count true and false positives of every class at every threshold."""
    classes, thresholds = len(point.labels), len(matches.thresholds)
    seen = point.prediction_class >= 0
    truth = point.ground_truth_class[point.ground_truth_class >= 0]
    pair_class = point.ground_truth_class[matches.ground_truth_index]
    return Curves(
        true_positives=count_by_group(pair_class, matches.pair_thresholds, classes, thresholds),
        false_positives=count_by_group(
            point.prediction_class[seen], matches.false_positive_thresholds[seen], classes, thresholds
        ),
        ground_truth=np.bincount(truth, minlength=classes),
    )


def repaired(curves: Curves, matches: Matches, point: WorkingPoint, by_cause: Sorted, cause: int) -> Curves:
    """Return the counts with one cause of false positives repaired at every threshold."""
    rows = np.flatnonzero(
        (by_cause.cause == cause) & (matches.false_positive_thresholds > 0) & (point.prediction_class >= 0)
    )
    masks = matches.false_positive_thresholds[rows]
    shape = curves.false_positives.shape
    gone = count_by_group(point.prediction_class[rows], masks, *shape)
    won: MaskArray = np.zeros(len(point.found), dtype=np.uint64)
    pointing = by_cause.target[rows] >= 0
    np.bitwise_or.at(won, by_cause.target[rows][pointing], masks[pointing])
    won &= ~matches.matched_thresholds
    evaluated = point.ground_truth_class >= 0
    added = count_by_group(point.ground_truth_class[evaluated], won[evaluated], *shape)
    return Curves(
        true_positives=curves.true_positives + added,
        false_positives=curves.false_positives - gone,
        ground_truth=curves.ground_truth,
    )


def without_missed(curves: Curves, matches: Matches, point: WorkingPoint, by_cause: Sorted) -> Curves:
    """Return the counts without the boxes that no threshold finds and no false positive points at."""
    wrong = matches.false_positive_thresholds > 0
    lost = _not_pointed_at(by_cause, wrong, matches.matched_thresholds == 0) & (point.ground_truth_class >= 0)
    gone = np.bincount(point.ground_truth_class[lost], minlength=len(point.labels))
    return Curves(
        true_positives=curves.true_positives,
        false_positives=curves.false_positives,
        ground_truth=curves.ground_truth - gone,
    )


def _not_pointed_at(by_cause: Sorted, wrong: BoolArray, missed: BoolArray) -> BoolArray:
    """Return (M,) which missed boxes no false positive of classification or localisation points at."""
    target = by_cause.target[wrong]
    pointed = np.zeros(len(missed), dtype=bool)
    pointed[target[target >= 0]] = True
    return missed & ~pointed


def causes(evaluation: Evaluation, point: WorkingPoint, near: Nearest) -> tuple[Causes, ...]:
    """Return the causes for every evaluated class, in the protocol's order."""
    matches, protocol = evaluation.matches, evaluation.scores.signature.protocol
    by_cause = sort_by_cause(near, protocol.min_iou)
    curves = count_curves(matches, point)
    variants = [repaired(curves, matches, point, by_cause, cause) for cause in range(len(FALSE_POSITIVE_CAUSES))]
    variants.append(without_missed(curves, matches, point, by_cause))
    gains = np.array([variant.average_precision() for variant in variants]) - curves.average_precision()
    counts = _counts_at_working_point(point, by_cause)
    return tuple(
        _of_class(evaluation, point, index, counts[:, index], gains[:, index]) for index in range(len(point.labels))
    )


def _counts_at_working_point(point: WorkingPoint, by_cause: Sorted) -> NDArray[np.int64]:
    """Return (7, C) false positives of each cause, then missed boxes, at the working point."""
    classes = len(point.labels)
    rows = np.flatnonzero(point.false_positive)
    cell = by_cause.cause[rows] * classes + point.prediction_class[rows]
    false_positives = np.bincount(cell, minlength=6 * classes).reshape(6, classes)
    evaluated = point.ground_truth_class >= 0
    missed = _not_pointed_at(by_cause, point.false_positive, evaluated & ~point.found)
    return np.vstack([false_positives, np.bincount(point.ground_truth_class[missed], minlength=classes)])


def _of_class(
    evaluation: Evaluation, point: WorkingPoint, index: int, counts: NDArray[np.int64], gains: Float64Array
) -> Causes:
    """Put together what is known about one class."""
    own_boxes = point.ground_truth_class == index
    own_predictions = point.prediction_class == index
    found_count = int((point.pair_class == index).sum())
    score_gains = gains * _mean_similarity(evaluation.scores.classes[index]) if found_count else gains * np.nan
    return Causes(
        true_positive_count=found_count,
        false_positive_count=int((point.false_positive & own_predictions).sum()),
        discarded_count=int((point.discarded & own_predictions).sum()),
        ground_truth_count=int(own_boxes.sum()),
        missed_count=int((own_boxes & ~point.found).sum()),
        causes=tuple(
            Cause(name=name, count=int(count), ap_gain=_defined(gain), detection_score_gain=_defined(score_gain))
            for name, count, gain, score_gain in zip(
                (*FALSE_POSITIVE_CAUSES, "missed"), counts, gains, score_gains, strict=True
            )
        ),
    )


def _mean_similarity(score: ClassScore) -> float:
    """Return what turns an AP into a detection score."""
    return sum(part or 0.0 for part in (score.bevcd, score.yaw_sim, score.pr_sim, score.size_sim)) / 4


def _defined(value: float) -> float | None:
    """Return None for NaN."""
    return None if np.isnan(value) else float(value)
