"""What numbers of a prediction may be, for single values and for whole arrays alike.

Wide enough for every honest detector, narrow enough that no accepted number can overflow or divide by zero later
(negative or zero dimensions alone raise the reference's mDS beyond all bounds).
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from evaluator.predictions import Float64Array

SCORE_RANGE = (0.0, 1.0)
CENTER_LIMIT_M = 10_000.0
DIMENSION_RANGE_M = (0.01, 100.0)
BOX_LIMIT_PX = 1_000_000.0
ROTATION_NORM_RANGE = (1e-6, 1e6)
"""Below the first a quaternion has no direction that survives the squaring; above the second it is no quaternion."""
ROTATION_TOLERANCE = 1e-3

Mask = NDArray[np.bool_]


def score_is_valid(score: float) -> bool:
    """Tell whether a score lies in [0, 1]."""
    return SCORE_RANGE[0] <= score <= SCORE_RANGE[1]


def center_is_valid(center_m: Sequence[float]) -> bool:
    """Tell whether a centre lies within 10 km of the vehicle."""
    return math.hypot(*center_m) <= CENTER_LIMIT_M


def dimension_is_valid(dimension_m: float) -> bool:
    """Tell whether a dimension lies between 1 cm and 100 m."""
    return DIMENSION_RANGE_M[0] <= dimension_m <= DIMENSION_RANGE_M[1]


def box_is_near(box_px: Sequence[float]) -> bool:
    """Tell whether a 2D box lies within a million pixels of the image."""
    return max(map(abs, box_px)) <= BOX_LIMIT_PX


def rotation_is_normalised(norm: float) -> bool:
    """Tell whether a quaternion's length is 1 but for rounding."""
    return abs(norm - 1.0) <= ROTATION_TOLERANCE


def rows_to_explain(
    *,
    score: Float64Array,
    center_m: Float64Array,
    dimensions_m: Float64Array,
    rotation: Float64Array,
    amodal_px: Float64Array,
    modal_px: Float64Array,
) -> Mask:
    """Find the boxes with a value that the functions above refuse or warn of.

    Args:
        score: (N,).
        center_m: (N, 3) x, y, z.
        dimensions_m: (N, 3) length, width, height.
        rotation: (N, 4) quaternions.
        amodal_px: (N, 4) x, y, width, height.
        modal_px: (N, 4) likewise.

    Returns:
        (N,) True where something is to be said; a NaN counts as such.
    """
    norm = np.sqrt(_sums_of_squares(rotation))
    distance_squared = _sums_of_squares(center_m)
    fine: Mask = (score >= SCORE_RANGE[0]) & (score <= SCORE_RANGE[1])
    fine &= (distance_squared <= CENTER_LIMIT_M**2) & (np.abs(norm - 1.0) <= ROTATION_TOLERANCE)
    # One look at all numbers of a kind costs a tenth of a look at each row, and mostly suffices.
    if not _all_within(dimensions_m, *DIMENSION_RANGE_M):
        fine &= _rows_within(dimensions_m, *DIMENSION_RANGE_M)
    for box_px in (amodal_px, modal_px):
        if not _all_within(box_px, -BOX_LIMIT_PX, BOX_LIMIT_PX):
            fine &= _rows_within(box_px, -BOX_LIMIT_PX, BOX_LIMIT_PX)
        for size_px in box_px.T[2:]:
            if not _all_within(size_px, 0.0, BOX_LIMIT_PX):
                fine &= (size_px >= 0.0) & (size_px <= BOX_LIMIT_PX)
    return np.logical_not(fine)


def _sums_of_squares(rows: Float64Array) -> Float64Array:
    """Sum up the squares of each row's few numbers, (N,); column by column, which numpy does twice as fast. May be infinite."""
    with np.errstate(over="ignore"):
        total = rows[:, 0] * rows[:, 0]
        for column in rows.T[1:]:
            total += column * column
    return total


def _all_within(values: Float64Array, least: float, most: float) -> bool:
    """Tell whether every number lies in [least, most]; false for NaN."""
    return not values.size or bool(values.min() >= least and values.max() <= most)


def _rows_within(values: Float64Array, least: float, most: float) -> Mask:
    """Find the rows whose numbers all lie in [least, most]."""
    return np.asarray(((values >= least) & (values <= most)).all(axis=1))
