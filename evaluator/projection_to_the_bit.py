"""Projection with the reference's own sequence of operations, for the last bit of the corners.

Two predictions that describe one shape (turned by 180 degrees, or with a longer quaternion) have equal boxes but for
rounding, and the greedy matching takes whichever IoU is greater by 1e-16. To agree with the reference even there, the
few boxes whose order or threshold hangs on rounding are projected once more with the same matrix products of the same
shapes and memory layouts, which round alike whether numpy takes them one by one or in stacks. That costs a hundred
times what evaluator/projection.py takes, and more for the rare box that the near plane cuts.
Reference: `Box3dImageTransform`, `pyquaternion.Quaternion`.
"""

import numpy as np

from evaluator.orientation import UNIT_TOLERANCE
from evaluator.predictions import Float64Array
from evaluator.projection import NEAR_PLANE_M, clipped_to_image

_SIGNS = np.array(
    [[-1, 1, -1], [-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, 1], [-1, -1, 1], [1, -1, 1], [1, 1, 1]], dtype=float
)
"""(8, 3): the reference's order of vertices: back left bottom, back right bottom, front right, front left; then top."""
_FACES = np.array([(3, 0, 4, 7), (1, 5, 6, 2), (3, 2, 6, 7), (0, 1, 5, 4), (4, 5, 6, 7), (0, 1, 2, 3)])
_IMAGE_AXES = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
"""Camera frame (x forward, y left, z up) to image axes (x right, y down, z forward)."""


def projected_to_the_bit_px(
    center_m: Float64Array,
    dimensions_m: Float64Array,
    rotation: Float64Array,
    intrinsics_px: Float64Array,
    sensor_from_vehicle: Float64Array,
) -> Float64Array:
    """Project N boxes, each with its own camera.

    Args:
        center_m: (N, 3) in the vehicle frame.
        dimensions_m: (N, 3) length, width, height.
        rotation: (N, 4) quaternions w, x, y, z.
        intrinsics_px: (N, 4) fx, fy, u0, v0.
        sensor_from_vehicle: (N, 3, 4).

    Returns:
        (4, N) x_min, y_min, x_max, y_max in pixels, clipped; all zeros for a box behind the near plane.
    """
    vertices = _vertices_m(center_m, dimensions_m, rotation, sensor_from_vehicle)
    cameras = _camera_matrices(intrinsics_px)
    whole = (vertices[:, :, 2] > NEAR_PLANE_M).all(axis=1)
    boxes = np.zeros((4, len(center_m)))
    boxes[:, whole] = _bounds(_pixels(cameras[whole, None], vertices[whole][:, _FACES]))
    for row in np.flatnonzero(~whole).tolist():
        faces = [_cut(list(vertices[row, face])) for face in _FACES]
        pixels = [_pixels(cameras[row], np.array(face)) for face in faces if face]
        if pixels:
            boxes[:, row] = _bounds(np.concatenate(pixels, axis=1)[None, None])[:, 0]
    return clipped_to_image(boxes)


def _vertices_m(
    center_m: Float64Array, dimensions_m: Float64Array, rotation: Float64Array, sensor_from_vehicle: Float64Array
) -> Float64Array:
    """Return the (N, 8, 3) vertices along the image's axes."""
    offsets = _SIGNS * (dimensions_m / 2)[:, None]
    vehicle = np.matmul(_rotation_matrices(rotation), offsets.transpose(0, 2, 1)) + center_m[:, :, None]
    homogeneous = np.concatenate([vehicle, np.ones((len(center_m), 1, 8))], axis=1)
    camera = np.matmul(np.ascontiguousarray(sensor_from_vehicle), homogeneous)
    return np.asarray(np.matmul(_IMAGE_AXES, camera)).transpose(0, 2, 1)


def _rotation_matrices(rotation: Float64Array) -> Float64Array:
    """Return (N, 3, 3) matrices; the squared length is a product of matrices, too, for its order of summation."""
    squared = np.matmul(rotation[:, None, :], rotation[:, :, None])[:, 0]
    is_unit = np.abs(1.0 - squared) < UNIT_TOLERANCE
    w, x, y, z = np.where(is_unit, rotation, rotation / np.sqrt(squared)).T
    left = np.stack([w, -x, -y, -z, x, w, -z, y, y, z, w, -x, z, -y, x, w], axis=1).reshape(-1, 4, 4)
    right = np.stack([w, -x, -y, -z, x, w, z, -y, y, -z, w, x, z, y, -x, w], axis=1).reshape(-1, 4, 4)
    return np.ascontiguousarray(np.matmul(left, right.transpose(0, 2, 1))[:, 1:, 1:])


def _camera_matrices(intrinsics_px: Float64Array) -> Float64Array:
    """Return (N, 3, 3) pinhole matrices."""
    matrices = np.tile(np.eye(3), (len(intrinsics_px), 1, 1))
    matrices[:, 0, 0], matrices[:, 1, 1], matrices[:, 0, 2], matrices[:, 1, 2] = intrinsics_px.T
    return matrices


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


def _pixels(camera: Float64Array, polygons: Float64Array) -> Float64Array:
    """Return (..., 2, K) pixels of (..., K, 3) corners seen by (..., 3, 3) cameras."""
    projected = np.matmul(camera, np.ascontiguousarray(polygons).swapaxes(-1, -2))
    return np.asarray(projected[..., :2, :] / projected[..., 2:, :])


def _bounds(pixels: Float64Array) -> Float64Array:
    """Return (4, N) the least and greatest u, v of (N, F, 2, K) pixels."""
    return np.concatenate([pixels.min(axis=(1, 3)), pixels.max(axis=(1, 3))], axis=1).T
