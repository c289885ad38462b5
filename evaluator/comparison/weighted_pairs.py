"""Pairs of boxes that Waymo's metrics may match, and what a match is worth: by overlap, or with a tolerated depth error.

Sources: `metrics/iou.cc` and `metrics/matcher.h` of the Waymo Open Dataset; Hung et al., ICRA 2024.
"""

from dataclasses import dataclass

import msgspec
import numpy as np

from evaluator.candidates import RowArray, pairs_within_groups
from evaluator.comparison.boxes import BoolArray, Boxes, ClassBoxes
from evaluator.comparison.overlap import may_overlap, overlaps
from evaluator.predictions import Float64Array


class Tolerance(msgspec.Struct, frozen=True, kw_only=True):
    """How far off along the line of sight a prediction may be."""

    share: float = 0.1
    """Of the distance to the camera."""
    at_least_m: float = 0.5


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


def let_pairs(boxes: ClassBoxes, min_iou: float, tolerance: Tolerance) -> WeightedPairs:
    """Return the pairs whose longitudinal error is tolerated and whose aligned 3D IoU is at least `min_iou`."""
    found = [WeightedPairs(prediction=_NO_ROWS, ground_truth=_NO_ROWS, weight=_NOTHING, affinity=_NOTHING)]
    for block in pairs_within_groups(boxes.predictions.image_index, boxes.ground_truth.image_index):
        prediction, ground_truth = block
        camera_m = boxes.camera_m[boxes.ground_truth.image_index[ground_truth]]
        seen = boxes.predictions.center_m[prediction] - camera_m
        true = boxes.ground_truth.center_m[ground_truth] - camera_m
        affinity = longitudinal_affinity(seen, true, tolerance)
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


def longitudinal_affinity(seen_m: Float64Array, true_m: Float64Array, tolerance: Tolerance) -> Float64Array:
    """Return how well predictions agree with the ground truth along its line of sight.

    Args:
        seen_m: (P, 3) predicted centres relative to the camera.
        true_m: (P, 3) true centres relative to the camera.
        tolerance: At which error the affinity is 0.

    Returns:
        (P,) 1 without an error along the line of sight, falling linearly to 0 at the tolerance.
    """
    distance = np.maximum(np.linalg.norm(true_m, axis=1), 1e-6)
    error = np.abs((seen_m * true_m).sum(axis=1) / distance - distance)
    worst = np.maximum(tolerance.share * distance, tolerance.at_least_m)
    affinity: Float64Array = np.clip(1 - error / worst, 0, 1)
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
