"""The mistakes that researchers really make, done to sound predictions."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from evaluator.ground_truth import ImageList
from evaluator.predictions import Float64Array, Predictions

Mistake = Callable[[Predictions, ImageList], Predictions]


def multiply(first: Float64Array, second: Float64Array) -> Float64Array:
    """Multiply quaternions w, x, y, z, each (N, 4)."""
    w, x, y, z = first.T
    a, b, c, d = second.T
    return np.stack(
        [
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ],
        axis=1,
    )


def about_z(yaw_rad: Float64Array) -> Float64Array:
    """Make quaternions of yaw angles (N,)."""
    zero = np.zeros_like(yaw_rad)
    return np.stack([np.cos(yaw_rad / 2), zero, zero, np.sin(yaw_rad / 2)], axis=1)


def _yaw(boxes: Predictions) -> Float64Array:
    return np.asarray(2 * np.arctan2(boxes.rotation[:, 3], boxes.rotation[:, 0]))


def _turned(boxes: Predictions, yaw_rad: float) -> Predictions:
    return replace(boxes, rotation=multiply(boxes.rotation, about_z(np.full(len(boxes), yaw_rad))))


def _lowered(boxes: Predictions) -> Predictions:
    return replace(boxes, center_m=boxes.center_m - boxes.dimensions_m[:, 2:] * np.array([0.0, 0.0, 0.5]))


def _in_camera(boxes: Predictions, images: ImageList) -> Predictions:
    """Give centres in the camera frame: x forward, y left, z up."""
    matrix = np.array(images.sensor_from_vehicle)[boxes.image_index]
    return replace(boxes, center_m=np.einsum("nij,nj->ni", matrix[:, :, :3], boxes.center_m) + matrix[:, :, 3])


def _optical(boxes: Predictions) -> Predictions:
    """Turn the camera frame to x right, y down, z forward."""
    forward, left, up = boxes.center_m.T
    return replace(boxes, center_m=np.stack([-left, -up, forward], axis=1))


def _corners(box_px: Float64Array) -> Float64Array:
    return np.concatenate([box_px[:, :2], box_px[:, :2] + box_px[:, 2:]], axis=1)


def _boxes(boxes: Predictions, change: Callable[[Float64Array], Float64Array]) -> Predictions:
    return replace(boxes, amodal_px=change(boxes.amodal_px), modal_px=change(boxes.modal_px))


_TO_KITTI = np.array([1242 / 2048, 375 / 1024] * 2)

MISTAKES: dict[str, tuple[frozenset[str], Mistake]] = {
    "xyzw": (frozenset({"quaternion_xyzw"}), lambda p, _: replace(p, rotation=p.rotation[:, [1, 2, 3, 0]])),
    "w_l_h": (frozenset({"dimensions_order"}), lambda p, _: replace(p, dimensions_m=p.dimensions_m[:, [1, 0, 2]])),
    "h_w_l": (frozenset({"dimensions_order"}), lambda p, _: replace(p, dimensions_m=p.dimensions_m[:, [2, 1, 0]])),
    "bottom_centre": (frozenset({"center_at_bottom"}), lambda p, _: _lowered(p)),
    "camera_frame": (frozenset({"center_in_camera_frame"}), _in_camera),
    "optical_frame": (frozenset({"center_in_camera_frame"}), lambda p, images: _optical(_in_camera(p, images))),
    "kitti_centres": (
        frozenset({"center_in_camera_frame", "center_at_bottom"}),
        lambda p, images: _optical(_in_camera(_lowered(p), images)),
    ),
    "degrees_as_radians": (
        frozenset({"rotation_in_degrees"}),
        lambda p, _: replace(p, rotation=about_z(np.degrees(_yaw(p)))),
    ),
    "angles_in_degrees": (
        frozenset({"rotation_in_degrees"}),
        lambda p, _: replace(p, rotation=np.degrees(_yaw(p))[:, None] * np.array([0.0, 0, 0, 1]) + 0.01),
    ),
    "yaw_90": (frozenset({"yaw_off_by_90"}), lambda p, _: _turned(p, np.pi / 2)),
    "yaw_minus_90": (frozenset({"yaw_off_by_90"}), lambda p, _: _turned(p, -np.pi / 2)),
    "corners": (frozenset({"boxes_as_corners"}), lambda p, _: _boxes(p, _corners)),
    "image_1242_x_375": (
        frozenset({"boxes_for_other_image_size"}),
        lambda p, _: _boxes(p, lambda box: box * _TO_KITTI),
    ),
    "boxes_of_other_objects": (
        frozenset({"boxes_far_from_projection"}),
        lambda p, _: _boxes(p, lambda box: np.roll(box, 7, axis=0)),
    ),
    "modal_outside": (
        frozenset({"modal_outside_amodal"}),
        lambda p, _: replace(p, modal_px=p.amodal_px + np.array([20.0, 0, 0, 0])),
    ),
    "scores_equal": (frozenset({"scores_all_equal"}), lambda p, _: replace(p, score=np.full(len(p), 0.5))),
    "scores_low": (frozenset({"scores_below_thresholds"}), lambda p, _: replace(p, score=p.score * 0.019)),
    "scores_in_percent": (frozenset({"scores_in_percent"}), lambda p, _: replace(p, score=p.score * 100)),
}
"""Name -> the warnings it must give, and nothing else; and how it is made."""


def noisy(boxes: Predictions, seed: int, strength: float) -> Predictions:
    """Disturb everything as a bad detector would; at strength 1 depth is off by 3 %, sizes by 10 %, yaw by 11 degrees."""
    generator = np.random.default_rng(seed)
    count = len(boxes)
    amodal = boxes.amodal_px.copy()
    amodal[:, 2:] *= np.exp(generator.normal(0, 0.1 * strength, (count, 2)))
    amodal[:, :2] += generator.normal(0, 0.05 * strength, (count, 2)) * amodal[:, 2:]
    return replace(
        boxes,
        center_m=boxes.center_m * (1 + generator.normal(0, 0.03 * strength, (count, 1)))
        + generator.normal(0, 0.2 * strength, (count, 3)),
        dimensions_m=np.maximum(boxes.dimensions_m * np.exp(generator.normal(0, 0.1 * strength, (count, 3))), 0.02),
        rotation=multiply(boxes.rotation, about_z(generator.normal(0, 0.2 * strength, count))),
        amodal_px=amodal,
        modal_px=amodal,
    )
