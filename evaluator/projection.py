"""3D boxes to their amodal boxes in the image.

Reference: `Box3dImageTransform.get_amodal_box_2d`. The six faces are cut at the near plane, projected, and the
circumscribing rectangle of what remains is clipped to the image. Vertices in front of the plane and the points
where an edge crosses it are exactly the corners of the cut faces, so faces need not be built.
Camera frame here: x right, y down, z forward (the reference's `CRS_S`).
"""

import numpy as np
from numpy.typing import NDArray

from evaluator.orientation import rotation_matrices
from evaluator.predictions import Float64Array, IndexArray

IMAGE_WIDTH_PX = 2048
IMAGE_HEIGHT_PX = 1024
"""Every image's size; `imgWidth` and `imgHeight` of the files are not used, like in the reference."""

NEAR_PLANE_M = 0.01
"""Only what lies further in front of the camera is projected."""

BLOCK = 4096
"""Boxes projected at a time: their 8 vertices then stay in the processor's cache."""

_EDGES = np.array([(i, i | bit) for bit in (1, 2, 4) for i in range(8) if not i & bit]).T
"""(2, 12): the vertices at both ends of each edge; a vertex's number has one bit for each sign of its offset."""

BoolArray = NDArray[np.bool_]


def projected_corners_px(
    center_m: Float64Array,
    dimensions_m: Float64Array,
    rotation: Float64Array,
    *,
    intrinsics_px: Float64Array,
    sensor_from_vehicle: Float64Array,
    camera_index: IndexArray,
    clip: bool = True,
) -> Float64Array:
    """Project boxes to amodal boxes.

    Args:
        center_m: (N, 3) box centres x, y, z in the ISO 8855 vehicle frame.
        dimensions_m: (N, 3) length, width, height.
        rotation: (N, 4) quaternions w, x, y, z.
        intrinsics_px: (I, 4) fx, fy, u0, v0 of each camera.
        sensor_from_vehicle: (I, 3, 4) vehicle frame to camera frame (x forward, y left, z up).
        camera_index: (N,) which camera sees the box.
        clip: Clip to the image, as the reference does.

    Returns:
        (4, N) x_min, y_min, x_max, y_max in pixels. All zeros for a box wholly behind the near plane; clipped, a box
        beside the image collapses to a line on the border.
    """
    boxes = np.empty((4, len(center_m)))
    # One row for each number of a camera, and `take` keeps it so: views of rows are fast to calculate with.
    cameras = np.ascontiguousarray(sensor_from_vehicle.transpose(1, 2, 0))
    intrinsics = np.ascontiguousarray(intrinsics_px.T)
    for start in range(0, len(center_m), BLOCK):
        block = slice(start, start + BLOCK)
        camera = camera_index[block]
        vertices = vertices_in_camera_m(
            center_m[block], dimensions_m[block], rotation[block], cameras.take(camera, axis=2).transpose(2, 0, 1)
        )
        boxes[:, block] = circumscribed_px(vertices, intrinsics.take(camera, axis=1).T)
    return clipped_to_image(boxes) if clip else boxes


def vertices_in_camera_m(
    center_m: Float64Array, dimensions_m: Float64Array, rotation: Float64Array, sensor_from_vehicle: Float64Array
) -> Float64Array:
    """Return the vertices of boxes in the camera frame (x right, y down, z forward).

    Args:
        center_m: (N, 3) in the vehicle frame.
        dimensions_m: (N, 3) length, width, height.
        rotation: (N, 4) quaternions w, x, y, z.
        sensor_from_vehicle: (N, 3, 4) of each box's camera.

    Returns:
        (3, 8, N); vertices whose numbers differ in one bit share an edge.
    """
    columns = rotation_matrices(rotation).transpose(1, 0, 2) * (np.ascontiguousarray(dimensions_m.T) / 2)[:, None]
    forward, left, up = sensor_from_vehicle.transpose(1, 2, 0)
    camera = np.stack([-left, -up, forward])
    middle = _transformed(camera, np.ascontiguousarray(center_m.T)) + camera[:, 3]
    half_length, half_width, half_height = _transformed(camera, columns)
    vertices = np.empty((3, 2, 2, 2, len(center_m)))
    np.subtract(middle, half_length, out=vertices[:, 0, 0, 0])
    np.add(middle, half_length, out=vertices[:, 1, 0, 0])
    np.add(vertices[:, :, 0, 0], half_width[:, None], out=vertices[:, :, 1, 0])
    vertices[:, :, 0, 0] -= half_width[:, None]
    np.add(vertices[:, :, :, 0], half_height[:, None, None], out=vertices[:, :, :, 1])
    vertices[:, :, :, 0] -= half_height[:, None, None]
    return vertices.reshape(3, 8, -1)


def circumscribed_px(vertices_m: Float64Array, intrinsics_px: Float64Array) -> Float64Array:
    """Circumscribe what lies in front of the near plane.

    Args:
        vertices_m: (3, 8, N) in the camera frame.
        intrinsics_px: (N, 4) fx, fy, u0, v0 of each box's camera, fx and fy > 0.

    Returns:
        (4, N) x_min, y_min, x_max, y_max in pixels, not clipped; zeros for a box wholly behind the near plane.
    """
    cut = np.flatnonzero((vertices_m[2] <= NEAR_PLANE_M).any(axis=0))
    with np.errstate(all="ignore"):  # a vertex of these may have depth 0; their boxes are replaced
        boxes = _pixels(_extremes(vertices_m, None), intrinsics_px)
    if len(cut):
        points, visible = _cut_at_near_plane(vertices_m[:, :, cut])
        in_image = _pixels(_extremes(points, visible), intrinsics_px[cut])
        boxes[:, cut] = np.where(visible.any(axis=0), in_image, 0.0)
    return boxes


def clipped_to_image(boxes: Float64Array) -> Float64Array:
    """Clip (4, N) boxes to the pixels of the image."""
    limits = np.array([IMAGE_WIDTH_PX - 1.0, IMAGE_HEIGHT_PX - 1.0] * 2)
    return np.clip(boxes, 0.0, limits[:, None])


def _transformed(matrices: Float64Array, vectors: Float64Array) -> Float64Array:
    """Return (..., 3, N): (3, 3, N) matrices, more columns being passed over, times (..., 3, N) vectors."""
    x, y, z = (vectors[..., axis, None, :] for axis in range(3))
    transformed = matrices[:, 0] * x
    transformed += matrices[:, 1] * y
    transformed += matrices[:, 2] * z
    return np.asarray(transformed)


def _extremes(points_m: Float64Array, visible: BoolArray | None) -> Float64Array:
    """Return (4, N) least x/z and y/z, greatest x/z and y/z over the visible of (3, K, N) points."""
    ratios = points_m[:2] / points_m[2]
    if visible is None:
        return np.concatenate([ratios.min(axis=1), ratios.max(axis=1)])
    least, greatest = np.where(visible, ratios, np.inf).min(axis=1), np.where(visible, ratios, -np.inf).max(axis=1)
    return np.concatenate([least, greatest])


def _pixels(ratios: Float64Array, intrinsics_px: Float64Array) -> Float64Array:
    """Apply the pinhole model to (4, N) x/z, y/z, x/z, y/z."""
    focal_px, center_px = intrinsics_px.T[:2], intrinsics_px.T[2:]
    return (ratios.reshape(2, 2, -1) * focal_px + center_px).reshape(4, -1)


def _cut_at_near_plane(vertices_m: Float64Array) -> tuple[Float64Array, BoolArray]:
    """Return (3, 20, N) corners of the cut boxes, vertices and crossings, and (20, N) which of them exist."""
    in_front = vertices_m[2] > NEAR_PLANE_M
    points = np.concatenate([vertices_m, _crossings_m(vertices_m)], axis=1)
    visible = np.concatenate([in_front, in_front[_EDGES[0]] != in_front[_EDGES[1]]])
    points[2][~visible] = 1.0  # any depth but 0 for points that do not count
    return points, visible


def _crossings_m(vertices_m: Float64Array) -> Float64Array:
    """Return (3, 12, N): where each edge meets the near plane; the behind end for edges that do not cross it.

    The point is reached from the end behind the plane, as in the reference.
    """
    first, second = vertices_m[:, _EDGES[0]], vertices_m[:, _EDGES[1]]
    first_is_behind = first[2] <= NEAR_PLANE_M
    behind = np.where(first_is_behind, first, second)
    step = behind - np.where(first_is_behind, second, first)
    parallel = step[2] == 0
    return np.asarray(
        behind + np.where(parallel, 0.0, NEAR_PLANE_M - behind[2]) / np.where(parallel, 1.0, step[2]) * step
    )
