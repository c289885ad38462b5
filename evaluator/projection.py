"""3D boxes to their amodal boxes in the image.

Reference: `Box3dImageTransform.get_amodal_box_2d`. The six faces are cut at the near plane, projected, and the
circumscribing rectangle of what remains is clipped to the image. Vertices in front of the plane and the points
where an edge crosses it are exactly the corners of the cut faces, so faces need not be built.
Camera frame here: x right, y down, z forward (the reference's `CRS_S`).
"""

import numpy as np

from evaluator.orientation import rotation_matrices
from evaluator.predictions import Float64Array, IndexArray

IMAGE_WIDTH_PX = 2048
IMAGE_HEIGHT_PX = 1024
"""Every image's size; `imgWidth` and `imgHeight` of the files are not used, like in the reference."""

NEAR_PLANE_M = 0.01
"""Only what lies further in front of the camera is projected."""

BLOCK = 4096
"""Boxes projected at a time: their 8 vertices then stay in the processor's cache."""

_SIGNS = np.array([[i & 4, i & 2, i & 1] for i in range(8)], dtype=bool).T * 1.0 - 0.5
"""(3, 8): vertex = centre + dimensions * signs, in the box frame."""

_EDGES = np.array([(i, i | bit) for bit in (1, 2, 4) for i in range(8) if not i & bit]).T
"""(2, 12): the vertices at both ends of each edge; they differ in one sign."""


def projected_corners_px(
    center_m: Float64Array,
    dimensions_m: Float64Array,
    rotation: Float64Array,
    *,
    intrinsics_px: Float64Array,
    sensor_from_vehicle: Float64Array,
    camera_index: IndexArray,
) -> Float64Array:
    """Project boxes to amodal boxes.

    Args:
        center_m: (N, 3) box centres x, y, z in the ISO 8855 vehicle frame.
        dimensions_m: (N, 3) length, width, height.
        rotation: (N, 4) quaternions w, x, y, z.
        intrinsics_px: (I, 4) fx, fy, u0, v0 of each camera.
        sensor_from_vehicle: (I, 3, 4) vehicle frame to camera frame (x forward, y left, z up).
        camera_index: (N,) which camera sees the box.

    Returns:
        (4, N) x_min, y_min, x_max, y_max in pixels, within the image. All zeros for a box wholly behind the near
        plane; a box beside the image collapses to a line on the border.
    """
    boxes = np.zeros((4, len(center_m)))
    for start in range(0, len(center_m), BLOCK):
        block = slice(start, start + BLOCK)
        camera = camera_index[block]
        vertices = vertices_in_camera_m(
            center_m[block], dimensions_m[block], rotation[block], sensor_from_vehicle[camera]
        )
        boxes[:, block] = _circumscribed_px(vertices, intrinsics_px[camera])
    return boxes


def projected_vertices_px(vertices_m: Float64Array, intrinsics_px: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Project points in front of the camera with the pinhole model.

    Args:
        vertices_m: (3, ..., N) points in the camera frame, z > 0.
        intrinsics_px: (N, 4) fx, fy, u0, v0.

    Returns:
        u and v, both (..., N), in pixels.
    """
    x, y, z = vertices_m
    fx, fy, u0, v0 = intrinsics_px.T
    return (fx * x + u0 * z) / z, (fy * y + v0 * z) / z


def vertices_in_camera_m(
    center_m: Float64Array, dimensions_m: Float64Array, rotation: Float64Array, sensor_from_vehicle: Float64Array
) -> Float64Array:
    """Return (3, 8, N) vertices in the camera frame."""
    matrices = rotation_matrices(rotation)
    offsets = dimensions_m.T[:, None, :] * _SIGNS[:, :, None]
    vehicle = [
        row[0] * offsets[0] + row[1] * offsets[1] + row[2] * offsets[2] + center
        for row, center in zip(matrices, center_m.T, strict=True)
    ]
    forward, left, up = (
        row[:, 0] * vehicle[0] + row[:, 1] * vehicle[1] + row[:, 2] * vehicle[2] + row[:, 3]
        for row in np.moveaxis(sensor_from_vehicle, 1, 0)
    )
    return np.stack([-left, -up, forward])


def _circumscribed_px(vertices_m: Float64Array, intrinsics_px: Float64Array) -> Float64Array:
    """Return (4, N) clipped circumscribing rectangles of boxes given by (3, 8, N) vertices."""
    cut = (vertices_m[2] <= NEAR_PLANE_M).any(axis=0)
    boxes = np.empty((4, vertices_m.shape[2]))
    if not cut.all():
        whole = ~cut if cut.any() else slice(None)
        u, v = projected_vertices_px(vertices_m[:, :, whole], intrinsics_px[whole])
        boxes[:, whole] = u.min(axis=0), v.min(axis=0), u.max(axis=0), v.max(axis=0)
    if cut.any():
        boxes[:, cut] = _cut_and_circumscribed_px(vertices_m[:, :, cut], intrinsics_px[cut])
    limits = np.array([IMAGE_WIDTH_PX - 1.0, IMAGE_HEIGHT_PX - 1.0] * 2)
    return np.clip(boxes, 0.0, limits[:, None], out=boxes)


def _cut_and_circumscribed_px(vertices_m: Float64Array, intrinsics_px: Float64Array) -> Float64Array:
    """Do the same, unclipped, for boxes that reach behind the near plane; zeros for those wholly behind it."""
    points = np.concatenate([vertices_m, _crossings_m(vertices_m)], axis=1)
    visible = np.concatenate([vertices_m[2] > NEAR_PLANE_M, _crosses(vertices_m)], axis=0)
    points[2][~visible] = 1.0  # any depth but 0: these points are masked below
    u, v = projected_vertices_px(points, intrinsics_px)
    least = [np.where(visible, axis, np.inf).min(axis=0) for axis in (u, v)]
    greatest = [np.where(visible, axis, -np.inf).max(axis=0) for axis in (u, v)]
    return np.where(visible.any(axis=0), np.stack([*least, *greatest]), 0.0)


def _crosses(vertices_m: Float64Array) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return (12, N): does this edge cross the near plane?"""
    in_front = vertices_m[2] > NEAR_PLANE_M
    return np.asarray(in_front[_EDGES[0]] != in_front[_EDGES[1]])


def _crossings_m(vertices_m: Float64Array) -> Float64Array:
    """Return (3, 12, N): where each edge meets the near plane; meaningless for edges that do not cross it."""
    first, second = vertices_m[:, _EDGES[0]], vertices_m[:, _EDGES[1]]
    first_is_behind = first[2] <= NEAR_PLANE_M
    behind = np.where(first_is_behind, first, second)
    step = behind - np.where(first_is_behind, second, first)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(behind + (NEAR_PLANE_M - behind[2]) / step[2] * step)
