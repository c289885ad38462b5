"""Pairs of boxes with near centres, and the size and heading errors that nuScenes and Argoverse share."""

from collections.abc import Callable

import numpy as np

from evaluator.candidates import RowArray, pairs_within_groups
from evaluator.comparison.boxes import Boxes, ClassBoxes
from evaluator.predictions import Float64Array

Distance = Callable[[Boxes, Boxes], Float64Array]


def ground_distance(first: Boxes, second: Boxes) -> Float64Array:
    """Return the distance of the centres on the ground plane of (P,) pairs, metres."""
    across = first.center_m - second.center_m
    return np.hypot(across[:, 0], across[:, 1])


def space_distance(first: Boxes, second: Boxes) -> Float64Array:
    """Return the distance of the centres in space of (P,) pairs, metres."""
    difference: Float64Array = np.linalg.norm(first.center_m - second.center_m, axis=1)
    return difference


def near_pairs(boxes: ClassBoxes, distance: Distance, max_m: float) -> tuple[RowArray, RowArray, Float64Array]:
    """Return the pairs of one image with centres nearer than `max_m`: prediction, ground-truth row, metres."""
    found: list[tuple[RowArray, RowArray, Float64Array]] = [
        (np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty(0))
    ]
    for prediction, ground_truth in pairs_within_groups(boxes.predictions.image_index, boxes.ground_truth.image_index):
        apart = distance(boxes.predictions.take(prediction), boxes.ground_truth.take(ground_truth))
        near = apart < max_m
        found.append((prediction[near], ground_truth[near], apart[near]))
    prediction, ground_truth, apart = (np.concatenate(column) for column in zip(*found, strict=True))
    return prediction, ground_truth, apart


def scale_errors(first: Boxes, second: Boxes) -> Float64Array:
    """Return 1 - IoU of (P,) pairs moved to one centre and heading; in [0, 1], smaller is better."""
    common = np.minimum(first.dimensions_m, second.dimensions_m).prod(axis=1)
    volumes = first.dimensions_m.prod(axis=1) + second.dimensions_m.prod(axis=1)
    error: Float64Array = 1 - common / (volumes - common)
    return error


def scale_errors_by_greatest(first: Boxes, second: Boxes) -> Float64Array:
    """Return 1 - (product of the smaller sides) / (product of the greater sides) of (P,) pairs, in [0, 1].

    What Argoverse 2 calls the IoU of aligned boxes; it counts more empty space than a true union.
    """
    common = np.minimum(first.dimensions_m, second.dimensions_m).prod(axis=1)
    error: Float64Array = 1 - common / np.maximum(first.dimensions_m, second.dimensions_m).prod(axis=1)
    return error


def heading_errors(first: Boxes, second: Boxes) -> Float64Array:
    """Return the angle between the headings of (P,) pairs, radians in [0, pi]."""
    turned = (first.yaw_rad - second.yaw_rad + np.pi) % (2 * np.pi) - np.pi
    return np.abs(turned)
