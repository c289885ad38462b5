"""Overlap of axis-parallel boxes in pixels, in the reference's convention.

Reference: `calcIouMatrix`, `calcOverlapMatrix`. A box reaches from its first to its last pixel, so its width is
x_max - x_min + 1; 1e-10 keeps the denominator above zero. The order of operations is the reference's, so that equal
boxes give bitwise equal overlaps and ties stay ties.
Boxes are (4, N): rows x_min, y_min, x_max, y_max.
"""

import numpy as np

from evaluator.predictions import Float64Array

DENOMINATOR_GUARD = 1e-10


def corners_px(boxes_px: Float64Array) -> Float64Array:
    """Turn (N, 4) boxes x, y, width, height into (4, N) boxes x_min, y_min, x_max, y_max."""
    x, y, width, height = boxes_px.T
    return np.stack([x, y, x + width, y + height])


def areas_px(boxes: Float64Array) -> Float64Array:
    """Return (N,) areas in pixels of (4, N) boxes."""
    x_min, y_min, x_max, y_max = boxes
    return np.asarray((x_max - x_min + 1) * (y_max - y_min + 1))


def intersections_px(first: Float64Array, second: Float64Array) -> Float64Array:
    """Return (N,) intersection areas in pixels, at least 0, of (4, N) boxes taken pairwise."""
    width = np.minimum(first[2], second[2]) - np.maximum(first[0], second[0]) + 1
    height = np.minimum(first[3], second[3]) - np.maximum(first[1], second[1]) + 1
    return np.asarray(np.maximum(width, 0) * np.maximum(height, 0))


def intersections_over_unions(first: Float64Array, second: Float64Array) -> Float64Array:
    """Return (N,) IoU in [0, 1) of (4, N) boxes taken pairwise; greater is more alike."""
    intersection = intersections_px(first, second)
    union = areas_px(first) + areas_px(second) - intersection + DENOMINATOR_GUARD
    return np.asarray(intersection / union)


def covered_fractions(regions: Float64Array, boxes: Float64Array) -> Float64Array:
    """Return (N,) how much of each box lies in its region, in [0, 1), for (4, N) boxes taken pairwise."""
    return np.asarray(intersections_px(regions, boxes) / (areas_px(boxes) + DENOMINATOR_GUARD))
