"""Candidate pairs whose fate hangs on rounding: their IoUs, to the last bit as the reference has them.

Two pairs compete when they share a box; which of them goes first, and whether a pair passes the minimum IoU, may hang
on the last bits of projected corners. Such predictions are found here and projected by
evaluator/projection_to_the_bit.py. Among measured boxes there are practically none; methods that submit two headings
for one box, and tests, have them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluator.candidates import RowArray
from evaluator.ground_truth import GroundTruth
from evaluator.overlap import intersections_over_unions
from evaluator.predictions import Float64Array, Predictions
from evaluator.projection_to_the_bit import projected_to_the_bit_px

ROUNDING = 1e-9
"""IoUs closer than this may be equal but for rounding; that of two ways to project one box is below 1e-10."""

_BLOCK = 1024
"""Boxes projected at a time, each with the corners of its six faces."""


@dataclass(frozen=True, slots=True)
class Pairs:
    """E candidate pairs with their IoU."""

    gt_row: RowArray
    prediction_row: RowArray
    iou: Float64Array

    def __getitem__(self, rows: NDArray[np.bool_] | RowArray) -> "Pairs":
        """Take some pairs."""
        return Pairs(self.gt_row[rows], self.prediction_row[rows], self.iou[rows])


def settled(
    pairs: Pairs, min_iou: float, gt_boxes: Float64Array, ground_truth: GroundTruth, predictions: Predictions
) -> Pairs:
    """Return the pairs with the IoUs of those predictions made exact that hang on rounding.

    Args:
        pairs: Candidates, those up to `ROUNDING` below the minimum included.
        min_iou: The minimum.
        gt_boxes: (4, M) annotated boxes.
        ground_truth: Cameras.
        predictions: Boxes in 3D.
    """
    hangs = _hangs_on_rounding(pairs, min_iou, gt_boxes, predictions)
    hanging = np.unique(pairs.prediction_row[hangs])
    if len(hanging) == 0:
        return pairs
    boxes = np.zeros((4, len(predictions)))
    boxes[:, hanging] = _projected(hanging, ground_truth, predictions)
    again = np.isin(pairs.prediction_row, hanging)
    iou = pairs.iou.copy()
    iou[again] = intersections_over_unions(gt_boxes[:, pairs.gt_row[again]], boxes[:, pairs.prediction_row[again]])
    return Pairs(pairs.gt_row, pairs.prediction_row, iou)


def _hangs_on_rounding(
    pairs: Pairs, min_iou: float, gt_boxes: Float64Array, predictions: Predictions
) -> NDArray[np.bool_]:
    """Return (E,) whether a pair is as good as another one of its ground truth or prediction, or as the minimum.

    Pairs of equal boxes do not hang on rounding: they tie exactly, however they are projected.
    """
    hangs = np.abs(pairs.iou - min_iou) <= ROUNDING
    columns = (predictions.center_m, predictions.dimensions_m, predictions.rotation)
    for key, other, boxes in (
        (pairs.gt_row, pairs.prediction_row, columns),
        (pairs.prediction_row, pairs.gt_row, (gt_boxes.T,)),
    ):
        shared = np.flatnonzero(np.bincount(key, minlength=1)[key] > 1)
        order = shared[np.lexsort((pairs.iou[shared], key[shared]))]
        close = (np.diff(key[order]) == 0) & (np.diff(pairs.iou[order]) <= ROUNDING)
        first, second = other[order[:-1][close]], other[order[1:][close]]
        differ = np.zeros(len(close), dtype=bool)
        differ[close] = np.any([(column[first] != column[second]).any(axis=1) for column in boxes], axis=0)
        run = np.concatenate([[0], np.cumsum(~close)])[: len(order)]
        hangs[order[np.isin(run, run[1:][differ])]] = True
    return hangs


def _projected(rows: RowArray, ground_truth: GroundTruth, predictions: Predictions) -> Float64Array:
    """Return (4, R) boxes of some predictions, in the reference's layout."""
    boxes = np.empty((4, len(rows)))
    for start in range(0, len(rows), _BLOCK):
        block = rows[start : start + _BLOCK]
        image = predictions.image_index[block]
        boxes[:, start : start + _BLOCK] = projected_to_the_bit_px(
            predictions.center_m[block],
            predictions.dimensions_m[block],
            predictions.rotation[block],
            ground_truth.intrinsics_px[image],
            ground_truth.sensor_from_vehicle[image],
        )
    return through_width_and_height(boxes)


def through_width_and_height(boxes: Float64Array) -> Float64Array:
    """Round (4, N) corners as the reference does, which keeps boxes as x, y, width, height in between."""
    x_min, y_min, x_max, y_max = boxes
    return np.stack([x_min, y_min, x_min + (x_max - x_min), y_min + (y_max - y_min)])
