"""What each prediction comes nearest to in the image: boxes of its own class, boxes of other classes, ignore regions.

The boxes are those of the matching: annotated amodal boxes against projected predictions, or the modal boxes of both
when the protocol says so.
"""

from dataclasses import dataclass

import numpy as np

from evaluator.candidates import RowArray, pairs_within_groups
from evaluator.evaluation import Evaluation
from evaluator.overlap import corners_px, covered_fractions, intersections_over_unions, intersections_px
from evaluator.predictions import Float64Array
from evaluator.projection import projected_corners_px


@dataclass(frozen=True, slots=True, kw_only=True)
class Nearest:
    """For each of N predictions the best overlaps in its image; 0 and row -1 where it touches nothing."""

    own_iou: Float64Array
    """(N,) greatest IoU with a ground-truth box of the predicted class."""
    own_row: RowArray
    """(N,) that box."""
    other_iou: Float64Array
    """(N,) greatest IoU with a ground-truth box of any other class, evaluated or not."""
    other_row: RowArray
    """(N,) that box."""
    ignore_coverage: Float64Array
    """(N,) greatest share of the submitted modal box inside one ignore region."""


def nearest(evaluation: Evaluation) -> Nearest:
    """Find what every prediction overlaps most; ties go to the earlier box."""
    truth_boxes, seen_boxes = boxes_in_image(evaluation)
    ground_truth, predictions = evaluation.ground_truth, evaluation.predictions
    names = np.array([*ground_truth.labels, ""])
    own_label = np.array([*predictions.labels, ""])[predictions.label_index]
    own = np.zeros(len(predictions)), np.full(len(predictions), -1)
    other = np.zeros(len(predictions)), np.full(len(predictions), -1)
    groups = predictions.image_index.astype(np.int64), ground_truth.image_index.astype(np.int64)
    for seen, truth in pairs_within_groups(*groups):
        touching = intersections_px(seen_boxes[:, seen], truth_boxes[:, truth]) > 0
        pair = seen[touching], truth[touching]
        iou = intersections_over_unions(truth_boxes[:, pair[1]], seen_boxes[:, pair[0]])
        same = own_label[pair[0]] == names[ground_truth.label_index[pair[1]]]
        for (best, row), wanted in ((own, same), (other, ~same)):
            _keep_greatest(best, row, pair[0][wanted], pair[1][wanted], iou[wanted])
    return Nearest(
        own_iou=own[0], own_row=own[1], other_iou=other[0], other_row=other[1], ignore_coverage=_coverage(evaluation)
    )


def _keep_greatest(best: Float64Array, best_row: RowArray, seen: RowArray, truth: RowArray, iou: Float64Array) -> None:
    """Write each prediction's greatest overlap of a block; a prediction's pairs are all in one block."""
    order = np.lexsort((truth, -iou, seen))
    first = order[np.append(True, np.diff(seen[order]) > 0)[: len(order)]]
    best[seen[first]], best_row[seen[first]] = iou[first], truth[first]


def boxes_in_image(evaluation: Evaluation) -> tuple[Float64Array, Float64Array]:
    """Return the boxes the protocol matches: (4, M) of the ground truth and (4, N) of the predictions, as corners."""
    ground_truth, predictions = evaluation.ground_truth, evaluation.predictions
    if evaluation.scores.signature.protocol.modal:
        return corners_px(ground_truth.modal_px), corners_px(predictions.modal_px)
    projected = projected_corners_px(
        predictions.center_m,
        predictions.dimensions_m,
        predictions.rotation,
        intrinsics_px=ground_truth.intrinsics_px,
        sensor_from_vehicle=ground_truth.sensor_from_vehicle,
        camera_index=predictions.image_index,
    )
    return corners_px(ground_truth.amodal_px), projected


def _coverage(evaluation: Evaluation) -> Float64Array:
    """Return (N,) how much of each submitted modal box lies in the ignore region that covers it most."""
    ground_truth, predictions = evaluation.ground_truth, evaluation.predictions
    boxes, regions = corners_px(predictions.modal_px), corners_px(ground_truth.ignore_px)
    groups = predictions.image_index.astype(np.int64), ground_truth.ignore_image_index.astype(np.int64)
    covered = np.zeros(len(predictions))
    for seen, region in pairs_within_groups(*groups):
        np.maximum.at(covered, seen, covered_fractions(regions[:, region], boxes[:, seen]))
    return covered
