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

from dataclasses import dataclass
from itertools import pairwise

import msgspec
import numpy as np

from evaluator.candidates import RowArray, pairs_within_groups
from evaluator.comparison.assignment import components, heaviest_assignments
from evaluator.comparison.boxes import BoolArray, Boxes, ClassBoxes
from evaluator.comparison.means import defined_mean
from evaluator.comparison.overlap import may_overlap, overlaps
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
    longitudinal_tolerance: float = 0.1
    """LET: tolerated error along the line of sight, as a share of the distance to the camera."""
    min_longitudinal_tolerance_m: float = 0.5


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


@dataclass(frozen=True, slots=True, kw_only=True)
class WeightedPairs:
    """Pairs that may match, and what a match is worth."""

    prediction: RowArray
    """(P,)."""
    ground_truth: RowArray
    """(P,)."""
    weight: Float64Array
    """(P,) what the assignment maximises, in (0, 1]."""
    affinity: Float64Array
    """(P,) what a true positive counts in the weighted precision, in [0, 1]."""

    def take(self, rows: RowArray | BoolArray) -> "WeightedPairs":
        """Return the pairs at `rows`."""
        return WeightedPairs(
            prediction=self.prediction[rows],
            ground_truth=self.ground_truth[rows],
            weight=self.weight[rows],
            affinity=self.affinity[rows],
        )


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
    tolerant = let_pairs(
        boxes, parameters.let_min_iou_two_wheeler if light else parameters.let_min_iou_vehicle, parameters
    )
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


def overlap_pairs(boxes: ClassBoxes, min_iou: float) -> WeightedPairs:
    """Return the pairs whose 3D IoU is at least `min_iou`, weighed by it; every affinity is 1."""
    found = [WeightedPairs(prediction=_NO_ROWS, ground_truth=_NO_ROWS, weight=_NOTHING, affinity=_NOTHING)]
    for prediction, ground_truth in pairs_within_groups(boxes.predictions.image_index, boxes.ground_truth.image_index):
        near = may_overlap(boxes.predictions.take(prediction), boxes.ground_truth.take(ground_truth))
        rows = prediction[near], ground_truth[near]
        _, iou = overlaps(boxes.predictions.take(rows[0]), boxes.ground_truth.take(rows[1]))
        pairs = WeightedPairs(prediction=rows[0], ground_truth=rows[1], weight=iou, affinity=np.ones(len(iou)))
        found.append(pairs.take(iou >= min_iou))
    return _concatenate(found)


def let_pairs(boxes: ClassBoxes, min_iou: float, parameters: WaymoParameters) -> WeightedPairs:
    """Return the pairs whose longitudinal error is tolerated and whose aligned 3D IoU is at least `min_iou`."""
    found = [WeightedPairs(prediction=_NO_ROWS, ground_truth=_NO_ROWS, weight=_NOTHING, affinity=_NOTHING)]
    for block in pairs_within_groups(boxes.predictions.image_index, boxes.ground_truth.image_index):
        prediction, ground_truth = block
        camera_m = boxes.camera_m[boxes.ground_truth.image_index[ground_truth]]
        seen = boxes.predictions.center_m[prediction] - camera_m
        true = boxes.ground_truth.center_m[ground_truth] - camera_m
        affinity = longitudinal_affinity(seen, true, parameters)
        aligned_m = align_along_sight(seen, true) + camera_m
        moved = moved_to(boxes.predictions.take(prediction), aligned_m)
        near = may_overlap(moved, boxes.ground_truth.take(ground_truth)) & (affinity > 0)
        _, iou = overlaps(moved.take(near), boxes.ground_truth.take(ground_truth[near]))
        pairs = WeightedPairs(
            prediction=prediction[near],
            ground_truth=ground_truth[near],
            weight=iou * affinity[near],
            affinity=affinity[near],
        )
        found.append(pairs.take(iou >= min_iou))
    return _concatenate(found)


def longitudinal_affinity(seen_m: Float64Array, true_m: Float64Array, parameters: WaymoParameters) -> Float64Array:
    """Return how well predictions agree with the ground truth along its line of sight.

    Args:
        seen_m: (P, 3) predicted centres relative to the camera.
        true_m: (P, 3) true centres relative to the camera.
        parameters: The tolerance.

    Returns:
        (P,) 1 without an error along the line of sight, falling linearly to 0 at the tolerance.
    """
    distance = np.maximum(np.linalg.norm(true_m, axis=1), 1e-6)
    error = np.abs((seen_m * true_m).sum(axis=1) / distance - distance)
    tolerance = np.maximum(parameters.longitudinal_tolerance * distance, parameters.min_longitudinal_tolerance_m)
    affinity: Float64Array = np.clip(1 - error / tolerance, 0, 1)
    return affinity


def align_along_sight(seen_m: Float64Array, true_m: Float64Array) -> Float64Array:
    """Move predicted centres along their own line of sight to the point nearest to the true centre, (P, 3) metres."""
    squared = np.maximum((seen_m**2).sum(axis=1), 1e-6)
    moved_m: Float64Array = seen_m * ((seen_m * true_m).sum(axis=1) / squared)[:, None]
    return moved_m


def moved_to(boxes: Boxes, center_m: Float64Array) -> Boxes:
    """Return the same boxes with other centres."""
    return Boxes(
        image_index=boxes.image_index, center_m=center_m, dimensions_m=boxes.dimensions_m, yaw_rad=boxes.yaw_rad
    )


_NO_ROWS = np.empty(0, dtype=np.int64)
_NOTHING = np.empty(0)


def _concatenate(parts: list[WeightedPairs]) -> WeightedPairs:
    """Put blocks of pairs together."""
    return WeightedPairs(
        prediction=np.concatenate([part.prediction for part in parts]),
        ground_truth=np.concatenate([part.ground_truth for part in parts]),
        weight=np.concatenate([part.weight for part in parts]),
        affinity=np.concatenate([part.affinity for part in parts]),
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


def assignment_steps(pairs: WeightedPairs, excused: BoolArray) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Tell what each prediction changes when predictions enter the best assignment one by one, highest score first.

    Returns:
        Three (N,) arrays, one value for each prediction: change in the number of true positives, in the sum of their
        affinities, and in the number of true positives that lie in ignore regions. Sums from the start give
        the state after each prediction, so one pass serves all score cutoffs.
    """
    change = np.zeros((3, len(excused)))
    name = components(pairs.prediction, pairs.ground_truth)
    order = np.lexsort((pairs.ground_truth, pairs.prediction, name))
    pairs, name = pairs.take(order), name[order]
    starts = np.flatnonzero(np.append(True, name[1:] != name[:-1])[: len(name)])
    sizes = np.diff(np.append(starts, len(name)))
    boxes = pairs.ground_truth
    one_box = np.minimum.reduceat(boxes, starts) == np.maximum.reduceat(boxes, starts) if len(starts) else sizes > 0
    simple = np.repeat(one_box, sizes)
    _add_single_boxes(pairs.take(simple), name[simple], excused, change)
    for start, size in zip(starts[~one_box], sizes[~one_box], strict=True):
        _add_component(pairs.take(np.arange(start, start + size)), excused, change)
    return change[0], change[1], change[2]


def _add_single_boxes(pairs: WeightedPairs, name: RowArray, excused: BoolArray, change: Float64Array) -> None:
    """Write the steps of all components with one ground-truth box: the heaviest prediction so far holds it.

    Args:
        pairs: Ordered by component, then by prediction.
        name: (P,) component of each pair.
        excused: (N,) predictions in ignore regions.
        change: (3, N) steps, written in place.
    """
    first = np.append(True, name[1:] != name[:-1])[: len(name)]
    _, rank = np.unique(pairs.weight, return_inverse=True)
    value = np.cumsum(first) * (len(rank) + 1) + rank
    heaviest = np.maximum.accumulate(value)
    takes = np.append(True, heaviest[1:] > heaviest[:-1])[: len(value)]
    holder = np.maximum.accumulate(np.where(takes, np.arange(len(value)), 0))
    state = np.stack([np.ones(len(holder)), pairs.affinity[holder], excused[pairs.prediction[holder]]])
    before = np.where(first, 0.0, np.roll(state, 1, axis=1))
    change[:, pairs.prediction] = state - before


def _add_component(pairs: WeightedPairs, excused: BoolArray, change: Float64Array) -> None:
    """Write the steps of one connected component with several ground-truth boxes into `change`."""
    rows, row = np.unique(pairs.prediction, return_inverse=True)
    columns, column = np.unique(pairs.ground_truth, return_inverse=True)
    weight = np.full((len(rows), len(columns)), -np.inf)
    affinity = np.zeros_like(weight)
    weight[row, column], affinity[row, column] = pairs.weight, pairs.affinity
    owners = heaviest_assignments(weight)
    held = owners >= 0
    after = np.stack(
        [
            held.sum(axis=1),
            (affinity[owners, np.arange(len(columns))] * held).sum(axis=1),
            (excused[rows][owners] & held).sum(axis=1),
        ]
    )
    change[:, rows] = np.diff(after, axis=1, prepend=0.0)


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
