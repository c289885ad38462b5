"""The boxes of one class as the comparison metrics see them: upright, with a heading, ordered by score.

KITTI, nuScenes, Waymo and Argoverse know boxes that turn about the vertical axis only. Pitch and roll are dropped
here, the heading is the direction of the box's x axis on the ground plane. This module selects and prepares;
it measures nothing.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluator.candidates import RowArray, pairs_within_groups
from evaluator.errors import UsageError
from evaluator.ground_truth import GroundTruth
from evaluator.overlap import corners_px, covered_fractions
from evaluator.predictions import Float64Array, Predictions

BoolArray = NDArray[np.bool_]

IGNORE_COVERAGE = 0.7
"""A prediction covered more than this by one ignore region is excused (paper, section 2D Average Precision)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Boxes:
    """Upright boxes in the ISO 8855 vehicle frame (x forward, y left, z up), metres. May be empty."""

    image_index: RowArray
    """(N,) which image the box belongs to."""
    center_m: Float64Array
    """(N, 3) box centres x, y, z."""
    dimensions_m: Float64Array
    """(N, 3) length, width, height."""
    yaw_rad: Float64Array
    """(N,) heading of the box's x axis in the ground plane, (-pi, pi], counter-clockwise from forward."""

    def __len__(self) -> int:
        """Count the boxes."""
        return len(self.image_index)

    def take(self, rows: RowArray | BoolArray) -> "Boxes":
        """Return the boxes at `rows`, in that order."""
        return Boxes(
            image_index=self.image_index[rows],
            center_m=self.center_m[rows],
            dimensions_m=self.dimensions_m[rows],
            yaw_rad=self.yaw_rad[rows],
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassBoxes:
    """Predictions and ground truth of one class over all images."""

    label: str
    predictions: Boxes
    """Highest score first; equal scores stay in the order of images and files."""
    score: Float64Array
    """(N,) descending."""
    excused: BoolArray
    """(N,) the prediction lies in an ignore region: unmatched, it is no false positive."""
    ground_truth: Boxes
    """Ordered by image."""
    camera_m: Float64Array
    """(I, 3) where each image's camera stands in the vehicle frame."""

    def take_predictions(self, rows: RowArray | BoolArray) -> "ClassBoxes":
        """Return the same class with the predictions at `rows` only; `rows` must keep the order."""
        return ClassBoxes(
            label=self.label,
            predictions=self.predictions.take(rows),
            score=self.score[rows],
            excused=self.excused[rows],
            ground_truth=self.ground_truth,
            camera_m=self.camera_m,
        )

    def take_ground_truth(self, rows: RowArray | BoolArray) -> "ClassBoxes":
        """Return the same class with the ground-truth boxes at `rows` only; `rows` must keep the order."""
        return ClassBoxes(
            label=self.label,
            predictions=self.predictions,
            score=self.score,
            excused=self.excused,
            ground_truth=self.ground_truth.take(rows),
            camera_m=self.camera_m,
        )


def class_boxes(predictions: Predictions, ground_truth: GroundTruth) -> tuple[ClassBoxes, ...]:
    """Split a submission by class, in the order of `predictions.labels`.

    Raises:
        UsageError: The two do not list the same images in the same order.
    """
    if predictions.images != ground_truth.images:
        raise UsageError("Read the predictions with the image list of this ground truth: their images differ.")
    excused = lies_in_ignore_region(predictions, ground_truth)
    camera_m = camera_positions(ground_truth.sensor_from_vehicle)
    return tuple(_one_class(predictions, ground_truth, label, excused, camera_m) for label in predictions.labels)


def _one_class(
    predictions: Predictions, ground_truth: GroundTruth, label: str, excused: BoolArray, camera_m: Float64Array
) -> ClassBoxes:
    """Select one class and order its predictions by descending score."""
    rows = np.flatnonzero(predictions.label_index == predictions.labels.index(label))
    rows = rows[np.argsort(-predictions.score[rows], kind="stable")]
    known = ground_truth.labels.index(label) if label in ground_truth.labels else -1
    return ClassBoxes(
        label=label,
        predictions=_boxes(predictions, rows),
        score=predictions.score[rows],
        excused=excused[rows],
        ground_truth=_boxes(ground_truth, np.flatnonzero(ground_truth.label_index == known)),
        camera_m=camera_m,
    )


def _boxes(source: Predictions | GroundTruth, rows: RowArray) -> Boxes:
    """Take rows of either kind of array set as upright boxes."""
    return Boxes(
        image_index=source.image_index[rows].astype(np.int64),
        center_m=source.center_m[rows],
        dimensions_m=source.dimensions_m[rows],
        yaw_rad=heading(source.rotation[rows]),
    )


def heading(rotation: Float64Array) -> Float64Array:
    """Return the direction of a box's x axis on the ground plane.

    Args:
        rotation: (N, 4) quaternions w, x, y, z of any length but 0.

    Returns:
        (N,) radians in (-pi, pi]; 0 for a box that stands on its nose (nuScenes `quaternion_yaw`).
    """
    w, x, y, z = rotation.T
    yaw_rad: Float64Array = np.arctan2(2 * (x * y + w * z), w * w + x * x - y * y - z * z)
    return yaw_rad


def camera_positions(sensor_from_vehicle: Float64Array) -> Float64Array:
    """Return where the cameras stand in the vehicle frame: (I, 3) metres from (I, 3, 4) transforms."""
    rotation, translation = sensor_from_vehicle[:, :, :3], sensor_from_vehicle[:, :, 3]
    position_m: Float64Array = -np.einsum("irc,ir->ic", rotation, translation)
    return position_m


def lies_in_ignore_region(predictions: Predictions, ground_truth: GroundTruth) -> BoolArray:
    """Tell which predictions lie in an ignore region.

    The submitted modal box counts, widths and heights with one pixel added, and the regions are taken one by one:
    the reference's way (`evalObjectDetection3d`), so that the comparison metrics excuse what the benchmark excuses.

    Returns:
        (N,) True where one region covers more than `IGNORE_COVERAGE` of the box. Without regions all are False.
    """
    covered = np.zeros(len(predictions), dtype=bool)
    boxes, regions = corners_px(predictions.modal_px), corners_px(ground_truth.ignore_px)
    groups = predictions.image_index.astype(np.int64), ground_truth.ignore_image_index.astype(np.int64)
    for prediction, region in pairs_within_groups(*groups):
        inside = covered_fractions(regions[:, region], boxes[:, prediction]) > IGNORE_COVERAGE
        covered[prediction[inside]] = True
    return covered
