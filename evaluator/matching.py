"""What matches what at which score threshold: the greedy 2D matching of predictions with ground truth.

Reference: `_addImageEvaluation`, `_getMatches`. Within one image and class, at each score threshold by itself, the
pair with the greatest IoU is matched and both boxes are taken, as long as the IoU is above the minimum. Scores play
no part but to make a prediction active. Ties go to the first ground-truth box, then to the first prediction.

All thresholds are matched in one pass. Candidate pairs are sorted by (-IoU, ground truth, prediction); each box
carries the set of thresholds at which it is still free; a pair takes the thresholds free for both. At any single
threshold that is the same sequence of decisions as the reference's.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluator.candidates import RowArray, pairs_within_groups
from evaluator.errors import UsageError
from evaluator.ground_truth import GroundTruth
from evaluator.overlap import corners_px, covered_fractions, intersections_over_unions
from evaluator.predictions import Float64Array, IndexArray, Predictions
from evaluator.projection import projected_corners_px
from evaluator.protocol import Protocol
from evaluator.rounding import ROUNDING, Pairs, settled, through_width_and_height
from evaluator.thresholds import MaskArray, active_masks, score_thresholds


@dataclass(frozen=True, slots=True, kw_only=True)
class Matches:
    """The matching of one submission at all score thresholds at once.

    N predictions, M ground-truth boxes, T <= 63 thresholds, P pairs. A pair that is matched at several
    thresholds stands once, with one bit for each; a box may be in several pairs, never twice at one threshold.
    Pairs are ordered by ground truth, then prediction, so that sums over them never depend on how work was split.
    """

    thresholds: Float64Array
    """(T,) score thresholds, ascending; a prediction is active at all that are <= its score."""
    ground_truth_index: IndexArray
    """(P,) int32, row in `GroundTruth`."""
    prediction_index: IndexArray
    """(P,) int32, row in `Predictions`."""
    pair_thresholds: MaskArray
    """(P,) at which thresholds this pair is a true positive; never 0."""
    false_positive_thresholds: MaskArray
    """(N,) at which thresholds a prediction is a false positive: active, unmatched, not ignored."""
    ignored_thresholds: MaskArray
    """(N,) at which thresholds a prediction is discarded: active, unmatched, inside an ignore region."""
    matched_thresholds: MaskArray
    """(M,) at which thresholds a ground-truth box is found; 0 for boxes of classes that are not evaluated."""


@dataclass(frozen=True, slots=True)
class Edges:
    """Candidate pairs in the order in which they are matched."""

    ground_truth_index: RowArray
    prediction_index: RowArray


def match(ground_truth: GroundTruth, predictions: Predictions, protocol: Protocol) -> Matches:
    """Match predictions with ground truth by the protocol `cityscapes3d`.

    Args:
        ground_truth: M boxes of any classes.
        predictions: N boxes, of the same images.
        protocol: Labels, minimum IoU, thresholds, modal or amodal.

    Returns:
        The matches; without predictions or ground truth there are no pairs.

    Raises:
        UsageError: The images of the two differ.
    """
    thresholds = score_thresholds(protocol)
    active = active_masks(predictions.score, thresholds)
    edges = candidate_edges(ground_truth, predictions, protocol)
    free_gt = np.full(len(ground_truth), (1 << len(thresholds)) - 1, dtype=np.uint64)
    unmatched = active.copy()
    taken = take_edges(edges, free_gt, unmatched)
    ignored = np.where(_inside_ignore_region(ground_truth, predictions, unmatched, protocol), unmatched, np.uint64(0))
    return matches_of(edges, taken, thresholds=thresholds, free_gt=free_gt, unmatched=unmatched, ignored=ignored)


def matches_of(
    edges: Edges,
    taken: MaskArray,
    *,
    thresholds: Float64Array,
    free_gt: MaskArray,
    unmatched: MaskArray,
    ignored: MaskArray,
) -> Matches:
    """Order what the edges took.

    Args:
        edges: E candidate pairs.
        taken: (E,) the thresholds each takes.
        thresholds: (T,) score thresholds.
        free_gt: (M,) thresholds at which each ground-truth box is left free.
        unmatched: (N,) thresholds at which each prediction is active and left free.
        ignored: (N,) those of them at which it is discarded.
    """
    kept = np.flatnonzero(taken)
    kept = kept[np.argsort(edges.ground_truth_index[kept] * len(unmatched) + edges.prediction_index[kept])]
    return Matches(
        thresholds=thresholds,
        ground_truth_index=edges.ground_truth_index[kept].astype(np.int32),
        prediction_index=edges.prediction_index[kept].astype(np.int32),
        pair_thresholds=taken[kept],
        false_positive_thresholds=unmatched ^ ignored,
        ignored_thresholds=ignored,
        matched_thresholds=np.uint64((1 << len(thresholds)) - 1) ^ free_gt,
    )


def evaluated_labels(protocol: Protocol) -> tuple[str, ...]:
    """Return the protocol's labels, each once, in order."""
    return tuple(dict.fromkeys(protocol.labels))


def class_index(labels: tuple[str, ...], label_index: IndexArray, protocol: Protocol) -> IndexArray:
    """Translate label indices to the position among the evaluated labels, -1 for labels not evaluated."""
    evaluated = evaluated_labels(protocol)
    table = [evaluated.index(label) if label in evaluated else -1 for label in labels]
    return np.array([*table, -1], dtype=np.int32)[label_index]


def candidate_edges(ground_truth: GroundTruth, predictions: Predictions, protocol: Protocol) -> Edges:
    """Find all pairs of one image and class whose IoU is above the minimum, best first, ties by row."""
    if ground_truth.images != predictions.images:
        raise UsageError("Ground truth and predictions must list the same images in the same order.")
    gt_group, prediction_group = groups_of(ground_truth, predictions, protocol)
    rows = np.flatnonzero(np.isin(prediction_group, gt_group))
    gt_boxes, prediction_boxes = _boxes_to_match(ground_truth, predictions, rows, protocol)
    groups, above_iou = (gt_group, prediction_group[rows]), max(protocol.min_iou - ROUNDING, 0.0)
    pairs = _overlapping_pairs(groups, gt_boxes, prediction_boxes, above_iou)
    pairs = Pairs(pairs.gt_row, rows[pairs.prediction_row], pairs.iou)
    if not protocol.modal:
        pairs = settled(pairs, protocol.min_iou, gt_boxes, ground_truth, predictions)
    pairs = pairs[pairs.iou > protocol.min_iou]
    best_first = _order(-pairs.iou)
    return Edges(pairs.gt_row[best_first], pairs.prediction_row[best_first])


def _order(keys: Float64Array) -> RowArray:
    """Sort (N,) numbers, equal ones in the order they have; where there are none, several times as fast as numpy."""
    order = np.argsort(keys)
    in_order = keys[order]
    return np.argsort(keys, kind="stable") if (in_order[1:] == in_order[:-1]).any() else order


def _overlapping_pairs(
    groups: tuple[RowArray, RowArray], gt_boxes: Float64Array, prediction_boxes: Float64Array, above_iou: float
) -> Pairs:
    """Return all pairs within groups whose IoU is above a value, ordered by ground truth, then prediction."""
    found = [Pairs(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0))]
    for rows in pairs_within_groups(*groups):
        possible = _side_by_side(gt_boxes, prediction_boxes, *rows, above_iou)
        gt_row, prediction_row = rows[0][possible], rows[1][possible]
        iou = intersections_over_unions(gt_boxes.take(gt_row, axis=1), prediction_boxes.take(prediction_row, axis=1))
        pairs = Pairs(gt_row, prediction_row, iou)
        found.append(pairs[iou > above_iou])
    return Pairs(
        np.concatenate([part.gt_row for part in found]),
        np.concatenate([part.prediction_row for part in found]),
        np.concatenate([part.iou for part in found]),
    )


def _boxes_to_match(
    ground_truth: GroundTruth, predictions: Predictions, rows: RowArray, protocol: Protocol
) -> tuple[Float64Array, Float64Array]:
    """Return the boxes of the ground truth as (4, M) corners, and of R rows of the predictions as (4, R)."""
    if protocol.modal:
        return corners_px(ground_truth.modal_px), corners_px(predictions.modal_px[rows])
    projected = projected_corners_px(
        predictions.center_m.take(rows, axis=0),
        predictions.dimensions_m.take(rows, axis=0),
        predictions.rotation.take(rows, axis=0),
        intrinsics_px=ground_truth.intrinsics_px,
        sensor_from_vehicle=ground_truth.sensor_from_vehicle,
        camera_index=predictions.image_index.take(rows),
    )
    return corners_px(ground_truth.amodal_px), through_width_and_height(projected)


def groups_of(ground_truth: GroundTruth, predictions: Predictions, protocol: Protocol) -> tuple[RowArray, RowArray]:
    """Return the (image, class) group of each box of both sides; negative and never equal if not evaluated."""
    classes = len(evaluated_labels(protocol))
    gt_class = class_index(ground_truth.labels, ground_truth.label_index, protocol).astype(np.int64)
    prediction_class = class_index(predictions.labels, predictions.label_index, protocol).astype(np.int64)
    gt_group = np.where(gt_class < 0, -1, ground_truth.image_index * classes + gt_class)
    return gt_group, np.where(prediction_class < 0, -2, predictions.image_index * classes + prediction_class)


def _side_by_side(
    gt_boxes: Float64Array, prediction_boxes: Float64Array, gt_row: RowArray, prediction_row: RowArray, above_iou: float
) -> NDArray[np.bool_]:
    """Return whether the pairs share enough columns of pixels for their IoU: a cheap test that most pairs fail.

    The intersection is at most as high as either box, so the IoU is at most the shared width over the greater width.
    """
    gt_left, gt_right = (edges.take(gt_row) for edges in gt_boxes[[0, 2]])
    left, right = (edges.take(prediction_row) for edges in prediction_boxes[[0, 2]])
    shared_width = np.minimum(gt_right, right) - np.maximum(gt_left, left) + 1
    width = np.maximum(gt_right - gt_left, right - left) + 1
    return np.asarray((shared_width > 0) & (shared_width >= (above_iou - ROUNDING) * width))


def take_edges(edges: Edges, free_gt: MaskArray, free_prediction: MaskArray) -> MaskArray:
    """Match the edges in their order, at all thresholds at once.

    Args:
        edges: E candidate pairs.
        free_gt: (M,) thresholds at which each ground-truth box is free; what is taken is removed in place.
        free_prediction: (N,) the same for predictions.

    Returns:
        (E,) the thresholds each pair takes, 0 for none.
    """
    gt_row, prediction_row = edges.ground_truth_index, edges.prediction_index
    contested = (np.bincount(gt_row, minlength=1)[gt_row] > 1) | (
        np.bincount(prediction_row, minlength=1)[prediction_row] > 1
    )
    taken = free_gt[gt_row] & free_prediction[prediction_row]
    rows = np.flatnonzero(contested)
    taken[rows] = _take_contested(gt_row[rows], prediction_row[rows], free_gt, free_prediction)
    np.bitwise_xor.at(free_gt, gt_row, taken)
    np.bitwise_xor.at(free_prediction, prediction_row, taken)
    return taken


def _take_contested(
    gt_row: RowArray, prediction_row: RowArray, free_gt: MaskArray, free_prediction: MaskArray
) -> MaskArray:
    """Take edges one after another; plain integers are several times faster here than array elements."""
    gt_free = dict(zip(gt_row.tolist(), free_gt[gt_row].tolist(), strict=True))
    prediction_free = dict(zip(prediction_row.tolist(), free_prediction[prediction_row].tolist(), strict=True))
    taken = []
    for gt, prediction in zip(gt_row.tolist(), prediction_row.tolist(), strict=True):
        both = gt_free[gt] & prediction_free[prediction]
        if both:
            gt_free[gt] ^= both
            prediction_free[prediction] ^= both
        taken.append(both)
    return np.array(taken, dtype=np.uint64)


def _inside_ignore_region(
    ground_truth: GroundTruth, predictions: Predictions, unmatched: MaskArray, protocol: Protocol
) -> NDArray[np.bool_]:
    """Return (N,) whether more than `min_iou` of a prediction's submitted modal box lies in one ignore region.

    Only predictions that are unmatched somewhere are tested. Regions count for every class (reference:
    `calcOverlapMatrix`, `matchIgnores`).
    """
    inside = np.zeros(len(predictions), dtype=bool)
    has_regions = np.zeros(len(ground_truth.images), dtype=bool)
    has_regions[ground_truth.ignore_image_index] = True
    tested = np.flatnonzero((unmatched > 0) & has_regions[predictions.image_index])
    boxes, regions = corners_px(predictions.modal_px.take(tested, axis=0)), corners_px(ground_truth.ignore_px)
    groups = predictions.image_index[tested], ground_truth.ignore_image_index
    for row, region in pairs_within_groups(*groups):
        covered = covered_fractions(regions.take(region, axis=1), boxes.take(row, axis=1)) > protocol.min_iou
        inside[tested[row[covered]]] = True
    return inside
