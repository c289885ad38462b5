"""Overlap of upright boxes: bird's-eye-view and volume IoU of pairs, the footprints intersected by shapely."""

import numpy as np
import shapely

from evaluator.comparison.boxes import BoolArray, Boxes
from evaluator.predictions import Float64Array

_CORNERS = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])
_GRID_M = 1e-9


def footprint_corners(boxes: Boxes) -> Float64Array:
    """Return the corners of the boxes on the ground plane.

    Returns:
        (N, 4, 2) x, y in metres, counter-clockwise from the front left corner.
    """
    local = _CORNERS * boxes.dimensions_m[:, None, :2]
    cos, sin = np.cos(boxes.yaw_rad)[:, None], np.sin(boxes.yaw_rad)[:, None]
    x = local[..., 0] * cos - local[..., 1] * sin
    y = local[..., 0] * sin + local[..., 1] * cos
    return np.stack([x, y], axis=-1) + boxes.center_m[:, None, :2]


def may_overlap(first: Boxes, second: Boxes) -> BoolArray:
    """Tell, cheaply, which pairs of footprints can overlap: their circumscribed circles do.

    A box with a side that is not positive overlaps nothing.

    Args:
        first: (P,) boxes.
        second: (P,) boxes, row by row the partners of `first`.
    """
    reach = sum(np.hypot(boxes.dimensions_m[:, 0], boxes.dimensions_m[:, 1]) for boxes in (first, second)) / 2
    across = first.center_m - second.center_m
    solid = (first.dimensions_m > 0).all(axis=1) & (second.dimensions_m > 0).all(axis=1)
    near: BoolArray = solid & (np.hypot(across[:, 0], across[:, 1]) < reach)
    return near


def overlaps(first: Boxes, second: Boxes) -> tuple[Float64Array, Float64Array]:
    """Measure how well pairs of boxes coincide.

    Args:
        first: (P,) boxes with positive dimensions.
        second: (P,) boxes with positive dimensions, row by row the partners of `first`.

    Returns:
        IoU of the rotated footprints (P,) and IoU of the volumes (P,), both in [0, 1], greater is better: the
        footprints' common area times the common height over the union of the volumes. Empty for no pairs.
    """
    area = _common_area_m2(footprint_corners(first), footprint_corners(second))
    ground = first.dimensions_m[:, :2].prod(axis=1), second.dimensions_m[:, :2].prod(axis=1)
    bev = area / (ground[0] + ground[1] - area)
    volume = area * _common_height(first, second)
    solid = first.dimensions_m.prod(axis=1) + second.dimensions_m.prod(axis=1)
    return np.clip(bev, 0, 1), np.clip(volume / (solid - volume), 0, 1)


def _common_area_m2(first: Float64Array, second: Float64Array) -> Float64Array:
    """Return the common areas of pairs of convex polygons with corners (P, K, 2), as (P,) square metres.

    Of a few in 10,000 rectangles that differ by rounding alone GEOS finds some corners in common and no area. On a grid of
    nanometres it finds the area, to 1e-8 square metres.
    """
    polygons, others = (np.asarray(shapely.polygons(corners)) for corners in (first, second))
    common = np.asarray(shapely.intersection(polygons, others))
    is_flat = shapely.get_type_id(common) != shapely.GeometryType.POLYGON
    common[is_flat] = shapely.intersection(polygons[is_flat], others[is_flat], grid_size=_GRID_M)
    return np.asarray(shapely.area(common))


def _common_height(first: Boxes, second: Boxes) -> Float64Array:
    """Return by how much two boxes overlap along the vertical, (P,) metres, 0 where they do not."""
    half = first.dimensions_m[:, 2] / 2, second.dimensions_m[:, 2] / 2
    top = np.minimum(first.center_m[:, 2] + half[0], second.center_m[:, 2] + half[1])
    bottom = np.maximum(first.center_m[:, 2] - half[0], second.center_m[:, 2] - half[1])
    common: Float64Array = np.maximum(top - bottom, 0)
    return common
