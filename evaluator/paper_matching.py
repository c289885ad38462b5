"""Matching by the paper's words (protocol `paper`).

Paper, section 2D Average Precision: both 2D boxes are the circumscribing rectangles of the projected 3D boxes, a match
needs an IoU of at least 0.7, and AP is that of Pascal VOC (Everingham et al. 2010): predictions come in the order of
their scores, each goes for the ground-truth box it overlaps most, and finding that one taken it is a false positive.
A prediction that matches nothing is discarded when at least 70 % of its 2D box lies in the union of the ignore
regions. The paper's sentence could be read to discard matched ones, too; then perfect predictions would not be perfect.

The rectangles are not clipped to the image, and widths are x_max - x_min. What the paper leaves open is done as in
`cityscapes3d`: a box that reaches behind the camera is cut at the near plane first, one wholly behind it finds nothing.
"""

import numpy as np
import shapely
from numpy.typing import NDArray

from evaluator.candidates import RowArray, pairs_within_groups
from evaluator.errors import UsageError
from evaluator.ground_truth import GroundTruth
from evaluator.matching import Matches, groups_of
from evaluator.predictions import Float64Array, IndexArray, Predictions
from evaluator.projection import projected_corners_px
from evaluator.protocol import Protocol
from evaluator.thresholds import active_masks, score_thresholds

LEAST_IGNORED_FRACTION = 0.7
"""Of the predicted 2D box, in ignore regions (paper, section 2D Average Precision)."""


def match_by_paper(ground_truth: GroundTruth, predictions: Predictions, protocol: Protocol) -> Matches:
    """Match predictions with ground truth by the protocol `paper`.

    Args:
        ground_truth: M boxes of any classes.
        predictions: N boxes, of the same images.
        protocol: Labels and least IoU.

    Returns:
        The matches. In score order a prediction's fate does not depend on the ones after it, so each is what it is
        at every threshold up to its score.

    Raises:
        UsageError: The images of the two differ.
    """
    if ground_truth.images != predictions.images:
        raise UsageError("Ground truth and predictions must list the same images in the same order.")
    gt_boxes, prediction_boxes = projected_boxes(ground_truth, ground_truth), projected_boxes(ground_truth, predictions)
    thresholds = score_thresholds(protocol)
    active = active_masks(predictions.score, thresholds)
    gt_row, prediction_row = _matched(ground_truth, predictions, protocol, (gt_boxes, prediction_boxes))
    wrong = active.copy()
    wrong[prediction_row] = 0
    ignored = np.where(_mostly_ignored(ground_truth, predictions.image_index, prediction_boxes, wrong > 0), wrong, 0)
    matched = np.zeros(len(ground_truth), dtype=np.uint64)
    matched[gt_row] = active[prediction_row]
    return Matches(
        thresholds=thresholds,
        ground_truth_index=gt_row.astype(np.int32),
        prediction_index=prediction_row.astype(np.int32),
        pair_thresholds=active[prediction_row],
        false_positive_thresholds=wrong ^ ignored,
        ignored_thresholds=ignored,
        matched_thresholds=matched,
    )


def projected_boxes(ground_truth: GroundTruth, boxes: GroundTruth | Predictions) -> Float64Array:
    """Return (4, N) 2D boxes of the 3D boxes of either side."""
    return projected_corners_px(
        boxes.center_m,
        boxes.dimensions_m,
        boxes.rotation,
        intrinsics_px=ground_truth.intrinsics_px,
        sensor_from_vehicle=ground_truth.sensor_from_vehicle,
        camera_index=boxes.image_index,
        clip=False,
    )


def plain_areas_px(boxes: Float64Array) -> Float64Array:
    """Return (N,) areas of (4, N) boxes; 0 for a box behind the camera."""
    return np.asarray((boxes[2] - boxes[0]) * (boxes[3] - boxes[1]))


def plain_ious(first: Float64Array, second: Float64Array) -> Float64Array:
    """Return (N,) IoU in [0, 1] of (4, N) boxes taken pairwise; 0 when both are empty."""
    width = np.minimum(first[2], second[2]) - np.maximum(first[0], second[0])
    height = np.minimum(first[3], second[3]) - np.maximum(first[1], second[1])
    intersection = np.maximum(width, 0) * np.maximum(height, 0)
    union = plain_areas_px(first) + plain_areas_px(second) - intersection
    return np.asarray(intersection / np.where(union > 0, union, 1))


def _matched(
    ground_truth: GroundTruth,
    predictions: Predictions,
    protocol: Protocol,
    boxes: tuple[Float64Array, Float64Array],
) -> tuple[RowArray, RowArray]:
    """Return the rows of the matched pairs, ordered by ground truth."""
    gt_boxes, prediction_boxes = boxes
    rows: list[tuple[RowArray, RowArray, Float64Array]] = [(*np.zeros((2, 0), dtype=np.int64), np.zeros(0))]
    for gt_row, prediction_row in pairs_within_groups(*groups_of(ground_truth, predictions, protocol)):
        iou = plain_ious(gt_boxes[:, gt_row], prediction_boxes[:, prediction_row])
        enough = (iou >= protocol.min_iou) & (iou > 0) & (predictions.score[prediction_row] >= 0)
        rows.append((gt_row[enough], prediction_row[enough], iou[enough]))
    gt_row, prediction_row, iou = (np.concatenate(column) for column in zip(*rows, strict=True))
    wanted = _first_of_each(prediction_row, np.lexsort((gt_row, -iou, prediction_row)))
    gt_row, prediction_row = gt_row[wanted], prediction_row[wanted]
    order = np.lexsort((prediction_row, -predictions.score[prediction_row], gt_row))
    taken = _first_of_each(gt_row, order)
    return gt_row[taken], prediction_row[taken]


def _first_of_each(key: RowArray, order: RowArray) -> RowArray:
    """Return, of rows in an order that is grouped by key, the first of each key."""
    ordered = key[order]
    return order[np.flatnonzero(np.diff(ordered, prepend=-1))]


def _mostly_ignored(
    ground_truth: GroundTruth, image_index: IndexArray, boxes: Float64Array, tested: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return (N,) whether enough of a tested box lies in the union of its image's ignore regions."""
    result = np.zeros(len(image_index), dtype=bool)
    regions = _unions(ground_truth)
    rows = np.flatnonzero(tested & np.isin(image_index, list(regions)) & (plain_areas_px(boxes) > 0))
    if len(rows):
        union = np.array([regions[image] for image in image_index[rows].tolist()])
        covered = shapely.area(shapely.intersection(union, shapely.box(*boxes[:, rows])))
        result[rows] = covered >= LEAST_IGNORED_FRACTION * plain_areas_px(boxes[:, rows])
    return result


def _unions(ground_truth: GroundTruth) -> dict[int, shapely.Geometry]:
    """Return the union of the ignore regions of each image that has any."""
    x, y, width, height = ground_truth.ignore_px.T
    shapes = shapely.box(x, y, x + width, y + height)
    images = ground_truth.ignore_image_index
    return {int(image): shapely.union_all(shapes[images == image]) for image in np.unique(images)}
