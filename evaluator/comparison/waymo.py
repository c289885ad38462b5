"""Waymo-style AP by range, and the longitudinal error tolerant LET-3D-AP and LET-3D-APL.

Sources: Sun et al., "Scalability in Perception for Autonomous Driving: Waymo Open Dataset", CVPR 2020, section 5; Hung
et al., "LET-3D-AP: Longitudinal Error Tolerant 3D Average Precision for Camera-Only 3D Detection", ICRA 2024; and the
metrics library of the Waymo Open Dataset 1.6.7 (`metrics/detection_metrics.cc`, `iou.cc`, `metrics_utils.cc`), which it
equals on the same boxes (`bench/comparison_reference.py`).

What stays as there: at each of 101 score cutoffs the predictions left are assigned to the ground truth with the
greatest total overlap; ranges [0, 30), [30, 50), [50, inf) by the distance in space from the vehicle's origin,
predictions by their own; the curve is integrated with gaps of recall above 0.05 filled by the precision behind them.
For LET a prediction is first moved along its line of sight to where it is nearest to the ground truth, and pairs weigh
overlap x longitudinal affinity; APL weighs each true positive in the precision by its affinity.

What differs: Cityscapes 3D has no lidar points, hence no difficulty levels (all boxes count). The sensor is each
image's own camera, not one mean position. No-label zones are the ignore regions. A range without ground truth
is None where Waymo says 0. Classes map to Waymo's thresholds as in `WaymoParameters`.
"""

from itertools import pairwise

import msgspec
import numpy as np

from evaluator.comparison.assignment_steps import assignment_steps
from evaluator.comparison.boxes import BoolArray, ClassBoxes
from evaluator.comparison.means import defined_mean
from evaluator.comparison.weighted_pairs import Tolerance, WeightedPairs, let_pairs, overlap_pairs
from evaluator.predictions import Float64Array


class WaymoParameters(msgspec.Struct, frozen=True, kw_only=True):
    """What the numbers depend on."""

    two_wheelers: tuple[str, ...] = ("motorcycle", "bicycle")
    """Scored with Waymo's thresholds for cyclists; every other class with those for vehicles."""
    min_iou_vehicle: float = 0.7
    min_iou_two_wheeler: float = 0.5
    let_min_iou_vehicle: float = 0.5
    let_min_iou_two_wheeler: float = 0.3
    """A pair may match at an overlap of at least this."""
    range_edges_m: tuple[float, ...] = (30.0, 50.0)
    score_cutoffs: int = 101
    max_recall_step: float = 0.05
    longitudinal_tolerance: Tolerance = Tolerance()
    """LET: the tolerated error along the line of sight."""


WAYMO = WaymoParameters()


class WaymoRange(msgspec.Struct, frozen=True, kw_only=True):
    """One range of one class, or its mean over classes; in [0, 1], greater is better, None without ground truth."""

    lower_m: float
    upper_m: float | None
    """None: no limit."""
    ground_truth_count: int
    ap: float | None
    let_ap: float | None
    let_apl: float | None


class WaymoClass(msgspec.Struct, frozen=True, kw_only=True):
    """One class: over all distances, and by range."""

    label: str
    overall: WaymoRange
    ranges: tuple[WaymoRange, ...]


class WaymoScores(msgspec.Struct, frozen=True, kw_only=True):
    """All classes, and the means over those with ground truth in the range."""

    parameters: WaymoParameters
    overall: WaymoRange
    ranges: tuple[WaymoRange, ...]
    classes: tuple[WaymoClass, ...]


def evaluate_waymo(classes: tuple[ClassBoxes, ...], parameters: WaymoParameters = WAYMO) -> WaymoScores:
    """Score every class over all distances and by range."""
    scores = tuple(_evaluate_class(boxes, parameters) for boxes in classes)
    ranges = tuple(_mean_range([score.ranges[i] for score in scores]) for i in range(len(parameters.range_edges_m) + 1))
    return WaymoScores(
        parameters=parameters,
        overall=_mean_range([score.overall for score in scores]),
        ranges=ranges,
        classes=scores,
    )


def _mean_range(ranges: list[WaymoRange]) -> WaymoRange:
    """Average the same range over the classes in which it is defined."""
    return WaymoRange(
        lower_m=ranges[0].lower_m if ranges else 0.0,
        upper_m=ranges[0].upper_m if ranges else None,
        ground_truth_count=sum(part.ground_truth_count for part in ranges),
        ap=defined_mean(part.ap for part in ranges),
        let_ap=defined_mean(part.let_ap for part in ranges),
        let_apl=defined_mean(part.let_apl for part in ranges),
    )


def _evaluate_class(boxes: ClassBoxes, parameters: WaymoParameters) -> WaymoClass:
    """Score one class; the pairs are measured once and cut by range."""
    light = boxes.label in parameters.two_wheelers
    plain = overlap_pairs(boxes, parameters.min_iou_two_wheeler if light else parameters.min_iou_vehicle)
    let_min_iou = parameters.let_min_iou_two_wheeler if light else parameters.let_min_iou_vehicle
    tolerant = let_pairs(boxes, let_min_iou, parameters.longitudinal_tolerance)
    distance = [np.linalg.norm(side.center_m, axis=1) for side in (boxes.predictions, boxes.ground_truth)]

    def within(lower_m: float, upper_m: float | None) -> WaymoRange:
        limit = np.inf if upper_m is None else upper_m
        inside = [(side >= lower_m) & (side < limit) for side in distance]
        ap = _range_aps(boxes, plain, inside[0], inside[1], parameters)
        let = _range_aps(boxes, tolerant, inside[0], inside[1], parameters)
        count = int(inside[1].sum())
        return WaymoRange(
            lower_m=lower_m, upper_m=upper_m, ground_truth_count=count, ap=ap[0], let_ap=let[0], let_apl=let[1]
        )

    edges = (0.0, *parameters.range_edges_m, None)
    return WaymoClass(
        label=boxes.label,
        overall=within(0.0, None),
        ranges=tuple(within(lower or 0.0, upper) for lower, upper in pairwise(edges)),
    )


def _range_aps(
    boxes: ClassBoxes,
    pairs: WeightedPairs,
    prediction_in: BoolArray,
    ground_truth_in: BoolArray,
    parameters: WaymoParameters,
) -> tuple[float | None, float | None]:
    """Return AP and affinity-weighted AP of the boxes inside a range."""
    count = int(ground_truth_in.sum())
    if not count:
        return None, None
    inside = pairs.take(prediction_in[pairs.prediction] & ground_truth_in[pairs.ground_truth])
    matched, affinity, excused = assignment_steps(inside, boxes.excused)
    falls = prediction_in & boxes.excused
    steps = np.cumsum([matched, affinity, prediction_in, falls, excused], axis=1)
    cutoffs = np.arange(parameters.score_cutoffs) / (parameters.score_cutoffs - 1)
    active = np.searchsorted(-boxes.score, -cutoffs, side="right")
    found, weighted, used, covered, covered_found = np.concatenate([np.zeros((5, 1)), steps], axis=1)[:, active]
    counted = np.maximum(used - (covered - covered_found), 1e-300)  # with nothing counted, nothing is found either
    recall = found / count
    return tuple(
        integrate_curve(np.where(recall > 0, part / counted, 1.0), recall, parameters.max_recall_step)
        for part in (found, weighted)
    )  # type: ignore[return-value]  # two parts give two numbers


def integrate_curve(precision: Float64Array, recall: Float64Array, max_recall_step: float) -> float:
    """Return the area under a precision-recall curve by Waymo's rule (`ComputeMeanAveragePrecision`).

    Precision becomes its maximum at any greater recall. Where recall jumps by more than `max_recall_step`, points in
    steps of that size carry the precision behind the jump, so only the last step is a slope. At recall 0 the
    precision of the next point holds.

    Args:
        precision: (C,) at each score cutoff, 1 where recall is 0.
        recall: (C,) at each score cutoff.
        max_recall_step: Greatest step that is integrated as a slope.

    Returns:
        In [0, 1], greater is better; 0 when no recall is above 0.
    """
    reached, where = np.unique(np.append(recall, 0.0), return_inverse=True)
    best = np.zeros(len(reached))
    np.maximum.at(best, where, np.append(precision, 1.0))
    best = np.maximum.accumulate(best[::-1])[::-1]
    if len(reached) == 1:
        return 0.0
    best[0] = best[1]
    width = np.diff(reached)
    filled = np.maximum(np.ceil((width - 1e-6) / max_recall_step) - 1, 0) * max_recall_step
    return float((filled * best[1:] + (width - filled) * (best[1:] + best[:-1]) / 2).sum())
