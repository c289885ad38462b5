"""nuScenes-style AP over centre distances, three true-positive errors, and a detection score of those three.

Source: Caesar et al., "nuScenes: A multimodal dataset for autonomous driving", CVPR 2020, section 3, and
nuscenes-devkit 1.2.0 (`eval/detection/algo.py`, configuration `detection_cvpr_2019`), which it equals on the same boxes
with distinct scores (`bench/comparison_reference.py`).

What differs on purpose:
- Velocity and attributes do not exist in Cityscapes 3D. The score of the three errors left is named NDS3, because
  it is not the NDS of nuScenes: (5 mAP + (1 - mATE) + (1 - mASE) + (1 - mAOE)) / 8.
- nuScenes looks 40 or 50 m far by class. Here it is 100 m for all, as far as the benchmark.
- There is no cap of 500 boxes to a sample. Bike racks are the ignore regions.
- Classes without ground truth are left out of the means (nuScenes always has all ten).
- An error with no recall above 0.1 to take it from is None for the class and counts as 1 in the mean, as there.
"""

import msgspec
import numpy as np

from evaluator.candidates import RowArray
from evaluator.comparison.assignment import match_in_score_order
from evaluator.comparison.boxes import BoolArray, ClassBoxes
from evaluator.comparison.centers import ground_distance, heading_errors, near_pairs, scale_errors
from evaluator.comparison.means import defined_mean
from evaluator.predictions import Float64Array

_RECALL = np.linspace(0, 1, 101)


class NuscenesParameters(msgspec.Struct, frozen=True, kw_only=True):
    """What the numbers depend on."""

    distances_m: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)
    """A match needs centres nearer than this on the ground plane; AP is the mean over all."""
    error_distance_m: float = 2.0
    """The three errors are taken from the matches at this distance."""
    min_recall: float = 0.1
    min_precision: float = 0.1
    """AP is the area of the curve above both, scaled back to [0, 1]."""
    map_weight: float = 5.0
    max_range_m: float = 100.0
    """Boxes with a centre farther from the rear axle on the ground plane are left out."""


NUSCENES = NuscenesParameters()


class NuscenesClass(msgspec.Struct, frozen=True, kw_only=True):
    """One class; everything is None without ground truth."""

    label: str
    ground_truth_count: int
    ap: float | None
    """Mean of `ap_by_distance`, in [0, 1], greater is better."""
    ap_by_distance: tuple[float | None, ...]
    ate_m: float | None
    """Average translation error on the ground plane, metres, smaller is better; None if recall stays below 0.1."""
    ase: float | None
    """Average scale error, in [0, 1], smaller is better."""
    aoe_rad: float | None
    """Average orientation error, radians in [0, pi], smaller is better."""


class NuscenesScores(msgspec.Struct, frozen=True, kw_only=True):
    """All classes, and the means over those with ground truth; None when there is no such class."""

    parameters: NuscenesParameters
    map: float | None
    mate_m: float | None
    mase: float | None
    maoe_rad: float | None
    nds3: float | None
    """Detection score of three errors, in [0, 1], greater is better. Not the NDS of nuScenes."""
    classes: tuple[NuscenesClass, ...]


def evaluate_nuscenes(classes: tuple[ClassBoxes, ...], parameters: NuscenesParameters = NUSCENES) -> NuscenesScores:
    """Score every class and combine them."""
    scores = tuple(_evaluate_class(within_range(boxes, parameters.max_range_m), parameters) for boxes in classes)
    counted = [score for score in scores if score.ground_truth_count]
    errors = [
        defined_mean(1.0 if error is None else error for error in column)
        for column in ([s.ate_m for s in counted], [s.ase for s in counted], [s.aoe_rad for s in counted])
    ]
    mean_ap = defined_mean(score.ap for score in counted)
    return NuscenesScores(
        parameters=parameters,
        map=mean_ap,
        mate_m=errors[0],
        mase=errors[1],
        maoe_rad=errors[2],
        nds3=None if mean_ap is None else _detection_score(mean_ap, [e for e in errors if e is not None], parameters),
        classes=scores,
    )


def _detection_score(mean_ap: float, errors: list[float], parameters: NuscenesParameters) -> float:
    """Weigh AP and the errors, each cut at 1, as `DetectionMetrics.nd_score` does."""
    accuracy = sum(max(0.0, 1 - error) for error in errors)
    return (parameters.map_weight * mean_ap + accuracy) / (parameters.map_weight + len(errors))


def within_range(boxes: ClassBoxes, max_range_m: float) -> ClassBoxes:
    """Leave out predictions and ground truth with centres at `max_range_m` or farther on the ground plane."""
    near = [
        np.hypot(side.center_m[:, 0], side.center_m[:, 1]) < max_range_m
        for side in (boxes.predictions, boxes.ground_truth)
    ]
    return boxes.take_predictions(near[0]).take_ground_truth(near[1])


def _evaluate_class(boxes: ClassBoxes, parameters: NuscenesParameters) -> NuscenesClass:
    """Score one class; the distances are measured once."""
    if not len(boxes.ground_truth):
        return _undefined(boxes.label, parameters)
    pairs = near_pairs(boxes, ground_distance, max(parameters.distances_m))
    aps = [average_precision(boxes, pairs, distance_m, parameters) for distance_m in parameters.distances_m]
    errors = true_positive_errors(boxes, pairs, parameters)
    return NuscenesClass(
        label=boxes.label,
        ground_truth_count=len(boxes.ground_truth),
        ap=defined_mean(aps),
        ap_by_distance=tuple(aps),
        ate_m=errors[0],
        ase=errors[1],
        aoe_rad=errors[2],
    )


def _undefined(label: str, parameters: NuscenesParameters) -> NuscenesClass:
    """Return the scores of a class without ground truth."""
    aps = (None,) * len(parameters.distances_m)
    return NuscenesClass(
        label=label, ground_truth_count=0, ap=None, ap_by_distance=aps, ate_m=None, ase=None, aoe_rad=None
    )


Pairs = tuple[RowArray, RowArray, Float64Array]


def _match(boxes: ClassBoxes, pairs: Pairs, max_m: float) -> tuple[RowArray, RowArray, BoolArray]:
    """Match below one distance: rows of matched predictions and boxes, and which predictions count at all."""
    near = pairs[2] < max_m
    prediction, ground_truth, apart = pairs[0][near], pairs[1][near], pairs[2][near]
    chosen = match_in_score_order(prediction, ground_truth, apart, ground_truth_count=len(boxes.ground_truth))
    prediction, ground_truth = prediction[chosen], ground_truth[chosen]
    order = np.argsort(prediction)
    counted = ~boxes.excused
    counted[prediction] = True
    return prediction[order], ground_truth[order], counted


def _curve(matched: RowArray, counted: BoolArray, ground_truth_count: int) -> tuple[Float64Array, Float64Array]:
    """Return recall and precision after each counted prediction, highest score first."""
    found = np.zeros(len(counted))
    found[matched] = 1
    found = np.cumsum(found[counted])
    return found / ground_truth_count, found / np.arange(1, len(found) + 1)


def average_precision(boxes: ClassBoxes, pairs: Pairs, max_m: float, parameters: NuscenesParameters) -> float:
    """Return the area under the interpolated curve above the lowest recall and precision (`calc_ap`).

    In [0, 1], greater is better; 0 when nothing is matched.
    """
    matched, _, counted = _match(boxes, pairs, max_m)
    if not len(matched):
        return 0.0
    recall, precision = _curve(matched, counted, len(boxes.ground_truth))
    sampled = np.interp(_RECALL, recall, precision, right=0)[_first_sample(parameters) :]
    lowest = parameters.min_precision
    return float(np.maximum((sampled - lowest) / (1 - lowest), 0).mean())


def _first_sample(parameters: NuscenesParameters) -> int:
    """Return the first of the 101 recall samples above the lowest recall."""
    return round(100 * parameters.min_recall) + 1


def true_positive_errors(boxes: ClassBoxes, pairs: Pairs, parameters: NuscenesParameters) -> list[float | None]:
    """Return translation, scale and orientation error, each averaged over the reached recall (`calc_tp`).

    The running mean of an error over the matches is read at the score that belongs to each recall sample, and these
    readings are averaged from the lowest recall on. None when that recall is not reached.
    """
    matched, box, counted = _match(boxes, pairs, parameters.error_distance_m)
    if not len(matched):
        return [None, None, None]
    recall, _ = _curve(matched, counted, len(boxes.ground_truth))
    reached = slice(_first_sample(parameters), int(np.flatnonzero(recall[-1] >= _RECALL)[-1]) + 1)
    if reached.stop <= reached.start:
        return [None, None, None]
    score = np.interp(_RECALL, recall, boxes.score[counted], right=0)[reached]
    first, second = boxes.predictions.take(matched), boxes.ground_truth.take(box)
    return [
        _mean_along_score(error, boxes.score[matched], score)
        for error in (ground_distance(first, second), scale_errors(first, second), heading_errors(first, second))
    ]


def _mean_along_score(error: Float64Array, match_score: Float64Array, score: Float64Array) -> float:
    """Average the running mean of `error` (highest score first) read at the given scores."""
    running = np.cumsum(error) / np.arange(1, len(error) + 1)
    return float(np.interp(score[::-1], match_score[::-1], running[::-1]).mean())
