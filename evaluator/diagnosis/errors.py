"""Errors of true positives in physical units, by distance.

Similarities in [0, 1] rank methods; metres and degrees tell what to repair. All errors are those of the true positives
at the working point, prediction minus ground truth. Distance is the ground truth's from the rear axle on the ground
plane, as in the depth bins.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from evaluator.diagnosis.working_point import BoolArray, WorkingPoint
from evaluator.evaluation import Evaluation
from evaluator.ground_truth import GroundTruth
from evaluator.orientation import yaw_pitch_roll_rad
from evaluator.predictions import Float64Array, Predictions


class Errors(msgspec.Struct, frozen=True, kw_only=True):
    """One statistic of each error; None where there is nothing to measure on. Nearer to 0 is better."""

    center_m: float | None
    """Distance of the centres on the ground plane; it has no sign, so no bias."""
    lateral_m: float | None
    """Across the viewing ray on the ground plane; positive: too far left."""
    longitudinal_m: float | None
    """Along the viewing ray on the ground plane, from the camera to the true centre; positive: too far away."""
    depth_percent: float | None
    """Error of the ground-plane distance from the camera, as a share of the true one; positive: too far away."""
    yaw_deg: float | None
    """Positive: turned too far counter-clockwise."""
    pitch_deg: float | None
    roll_deg: float | None
    size_percent: float | None
    """Mean over length, width and height of the relative error, absolute or signed; positive: too large."""


ERROR_NAMES = Errors.__struct_fields__


class ErrorSummary(msgspec.Struct, frozen=True, kw_only=True):
    """Errors of a group of true positives."""

    true_positive_count: int
    mean: Errors
    """Mean of the absolute errors; of the size: of each side's absolute error, so that sides do not cancel."""
    median: Errors
    """Median of the absolute errors."""
    bias: Errors
    """Mean of the signed errors."""


class DistanceRange(msgspec.Struct, frozen=True, kw_only=True):
    """Errors of the true positives with a distance in [lower_m, upper_m)."""

    lower_m: float
    upper_m: float | None
    """None: no limit."""
    errors: ErrorSummary


class ErrorCurves(msgspec.Struct, frozen=True, kw_only=True):
    """Errors against distance."""

    by_distance: tuple[DistanceRange, ...]
    """Each depth bin, then everything beyond the maximum depth."""
    up_to_distance: tuple[DistanceRange, ...]
    """From 0 to the end of each depth bin, then everything: the way the paper shows annotation errors."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PairErrors:
    """Errors of P true positives, in the order of `ERROR_NAMES`."""

    distance_m: Float64Array
    """(P,) of the ground truth from the rear axle, on the ground plane."""
    class_index: NDArray[np.int32]
    """(P,)."""
    signed: Float64Array
    """(P, 8)."""
    absolute: Float64Array
    """(P, 8), at least 0: without the sign; of the size the mean over the sides without their signs."""

    def take(self, rows: BoolArray) -> "PairErrors":
        """Return the errors of the chosen true positives."""
        return PairErrors(
            distance_m=self.distance_m[rows],
            class_index=self.class_index[rows],
            signed=self.signed[rows],
            absolute=self.absolute[rows],
        )

    def of_class(self, index: int | None) -> "PairErrors":
        """Return the errors of one class, of all for None."""
        return self if index is None else self.take(self.class_index == index)


def pair_errors(evaluation: Evaluation, point: WorkingPoint) -> PairErrors:
    """Measure the errors of all true positives at the working point."""
    truth, seen = point.pair_ground_truth, point.pair_prediction
    ground_truth, predictions = evaluation.ground_truth, evaluation.predictions
    camera_m = point.camera_m[ground_truth.image_index[truth]]
    place = place_errors(ground_truth.center_m[truth] - camera_m, predictions.center_m[seen] - camera_m)
    angles = angle_errors_deg(ground_truth, predictions, point)
    sides = 100 * (predictions.dimensions_m[seen] / ground_truth.dimensions_m[truth] - 1)
    return PairErrors(
        distance_m=np.hypot(ground_truth.center_m[truth, 0], ground_truth.center_m[truth, 1]),
        class_index=point.pair_class,
        signed=np.column_stack([place, angles, sides.mean(axis=1)]),
        absolute=np.abs(np.column_stack([place, angles, np.abs(sides).mean(axis=1)])),
    )


def place_errors(true_m: Float64Array, seen_m: Float64Array) -> Float64Array:
    """Split position errors along and across the viewing ray on the ground plane.

    Args:
        true_m: (P, 3) true centres relative to the camera, in the axes of the vehicle frame.
        seen_m: (P, 3) predicted centres, the same way.

    Returns:
        (P, 4) distance of the centres (m, at least 0), lateral (m), longitudinal (m), depth (%).
    """
    ray = true_m[:, :2]
    distance = np.maximum(np.hypot(ray[:, 0], ray[:, 1]), 1e-9)
    along = ray / distance[:, None]
    offset = seen_m[:, :2] - ray
    longitudinal = (offset * along).sum(axis=1)
    lateral = along[:, 0] * offset[:, 1] - along[:, 1] * offset[:, 0]
    seen_distance = np.hypot(seen_m[:, 0], seen_m[:, 1])
    depth = 100 * (seen_distance - distance) / distance
    return np.column_stack([np.hypot(offset[:, 0], offset[:, 1]), lateral, longitudinal, depth])


def angle_errors_deg(ground_truth: GroundTruth, predictions: Predictions, point: WorkingPoint) -> Float64Array:
    """Return (P, 3) errors of yaw, pitch and roll in degrees, [-180, 180), the angles being those of the protocol."""
    true = yaw_pitch_roll_rad(ground_truth.rotation[point.pair_ground_truth])
    seen = yaw_pitch_roll_rad(predictions.rotation[point.pair_prediction])
    wrapped: Float64Array = (seen - true + np.pi) % (2 * np.pi) - np.pi
    return np.degrees(wrapped).T


def summarize_errors(errors: PairErrors) -> ErrorSummary:
    """Summarise the errors of a group; everything is None for no pairs."""
    mean, median, bias = (
        _errors(statistic(part, axis=0) if len(part) else None)
        for statistic, part in ((np.mean, errors.absolute), (np.median, errors.absolute), (np.mean, errors.signed))
    )
    return ErrorSummary(
        true_positive_count=len(errors.signed),
        mean=mean,
        median=median,
        bias=msgspec.structs.replace(bias, center_m=None),
    )


def _errors(values: Float64Array | None) -> Errors:
    """Name the eight errors."""
    listed: Iterable[float | None] = [None] * len(ERROR_NAMES) if values is None else values.tolist()
    return Errors(**dict(zip(ERROR_NAMES, listed, strict=True)))


def error_curves(errors: PairErrors, edges_m: tuple[int, ...]) -> ErrorCurves:
    """Summarise errors by distance.

    Args:
        errors: Of the true positives to look at.
        edges_m: Edges of the depth bins from 0 to the maximum depth, ascending.
    """
    upper = (*(float(edge) for edge in edges_m[1:]), None)
    return ErrorCurves(
        by_distance=tuple(
            _range(errors, float(lower_m), upper_m) for lower_m, upper_m in zip(edges_m, upper, strict=True)
        ),
        up_to_distance=tuple(_range(errors, 0.0, upper_m) for upper_m in upper),
    )


def _range(errors: PairErrors, lower_m: float, upper_m: float | None) -> DistanceRange:
    """Summarise the true positives of one range."""
    inside = (errors.distance_m >= lower_m) & (errors.distance_m < (np.inf if upper_m is None else upper_m))
    return DistanceRange(lower_m=lower_m, upper_m=upper_m, errors=summarize_errors(errors.take(inside)))
