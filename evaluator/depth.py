"""Depth of a box and its depth bin.

Depth is the distance on the ground plane from the vehicle's rear axle, not from the camera, in whole metres
(reference: `CsBbox3d.depth`). Bins are [s, s + step) up to the maximum depth (paper, section Benchmark Metrics).
"""

import numpy as np

from evaluator.predictions import Float64Array, IndexArray
from evaluator.protocol import Protocol


def depth_m(center_m: Float64Array) -> Float64Array:
    """Return (N,) depths in whole metres, rounded down, of (N, 3) centres in the vehicle frame."""
    x, y = center_m[:, 0], center_m[:, 1]
    return np.floor(np.sqrt(x * x + y * y))


def depth_bin_index(center_m: Float64Array, protocol: Protocol) -> IndexArray:
    """Assign boxes to depth bins.

    Args:
        center_m: (N, 3) centres in the vehicle frame.
        protocol: Gives the bins.

    Returns:
        (N,) int32 index into `protocol.depth_bins_m`; its length for a box at or beyond the maximum depth.
    """
    end, beyond = protocol.max_depth_m, len(protocol.depth_bins_m)
    depth = np.fmin(depth_m(center_m), end).astype(np.int64)  # what is too far for an integer is beyond the end, too
    return np.where(depth < end, depth // protocol.depth_step_m, beyond).astype(np.int32)
