"""Projection of single boxes with the reference's own sequence of operations, for the last bit of their corners.

Two predictions that describe one shape (turned by 180 degrees, or with a longer quaternion) have equal boxes but for
rounding, and the greedy matching takes whichever IoU is greater by 1e-16. To agree with the reference even there, the
few boxes whose order or threshold hangs on rounding are projected once more with the same numpy calls on the same
shapes, which round alike. That costs 0.1 ms a box, a thousand times what evaluator/projection.py takes.
Reference: `Box3dImageTransform`, `pyquaternion.Quaternion`.
"""

import math

import numpy as np

from evaluator.orientation import UNIT_TOLERANCE
from evaluator.predictions import Float64Array
from evaluator.projection import IMAGE_HEIGHT_PX, IMAGE_WIDTH_PX, NEAR_PLANE_M

_SIGNS = np.array(
    [[-1, 1, -1], [-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, 1], [-1, -1, 1], [1, -1, 1], [1, 1, 1]], dtype=float
)
"""(8, 3): the reference's order of vertices: back left bottom, back right bottom, front right, front left; then top."""
_FACES = ((3, 0, 4, 7), (1, 5, 6, 2), (3, 2, 6, 7), (0, 1, 5, 4), (4, 5, 6, 7), (0, 1, 2, 3))
_IMAGE_AXES = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
"""Camera frame (x forward, y left, z up) to image axes (x right, y down, z forward)."""


def projected_to_the_bit_px(
    center_m: Float64Array,
    dimensions_m: Float64Array,
    rotation: Float64Array,
    intrinsics_px: Float64Array,
    sensor_from_vehicle: Float64Array,
) -> list[float]:
    """Project one box.

    Args:
        center_m: (3,) in the vehicle frame.
        dimensions_m: (3,) length, width, height.
        rotation: (4,) quaternion w, x, y, z.
        intrinsics_px: (4,) fx, fy, u0, v0.
        sensor_from_vehicle: (3, 4).

    Returns:
        x_min, y_min, x_max, y_max in pixels, clipped; all zeros for a box behind the near plane.
    """
    offsets = _SIGNS * (dimensions_m / 2)
    vehicle = np.matmul(_rotation_matrix(rotation), offsets.T).T
    vehicle += center_m
    homogeneous = np.concatenate([vehicle, np.ones((8, 1))], axis=1)
    camera = np.matmul(np.ascontiguousarray(sensor_from_vehicle), homogeneous.T).T
    vertices = np.matmul(_IMAGE_AXES, camera.T).T
    fx, fy, u0, v0 = intrinsics_px
    intrinsics = np.array([[fx, 0, u0], [0, fy, v0], [0, 0, 1]])
    polygons = [_cut([vertices[i] for i in face]) for face in _FACES]
    pixels = [_pixels(intrinsics, polygon) for polygon in polygons if polygon]
    if not pixels:
        return [0.0] * 4
    u, v = np.concatenate(pixels, axis=1)
    bounds = [u.min(), v.min(), u.max(), v.max()]
    limits = [IMAGE_WIDTH_PX - 1, IMAGE_HEIGHT_PX - 1] * 2
    return [float(min(limit, max(0, bound))) for bound, limit in zip(bounds, limits, strict=True)]


def _rotation_matrix(rotation: Float64Array) -> Float64Array:
    squared = np.dot(rotation, rotation)
    if not abs(1.0 - squared) < UNIT_TOLERANCE:
        rotation = rotation / math.sqrt(squared)
    w, x, y, z = rotation
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    right = np.array([[w, -x, -y, -z], [x, w, z, -y], [y, -z, w, x], [z, y, -x, w]])
    return np.array(np.dot(left, right.transpose())[1:][:, 1:])


def _cut(face: list[Float64Array]) -> list[Float64Array]:
    """Cut a face at the near plane; empty when it is wholly behind."""
    cut = []
    for index, point in enumerate(face):
        if point[2] > NEAR_PLANE_M:
            cut.append(point)
            continue
        for neighbour in (face[index - 1], face[(index + 1) % len(face)]):
            if neighbour[2] > NEAR_PLANE_M:
                step = point - neighbour
                cut.append(point + (NEAR_PLANE_M - point[2]) / step[2] * step)
    return cut


def _pixels(intrinsics: Float64Array, polygon: list[Float64Array]) -> Float64Array:
    projected = np.matmul(intrinsics, np.array(polygon).T)
    return np.asarray(projected[:2] / projected[-1])
