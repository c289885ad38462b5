"""Score thresholds, and sets of them as bit masks: bit t of a mask stands for threshold t."""

import numpy as np
from numpy.typing import NDArray

from evaluator.predictions import Float64Array
from evaluator.protocol import Protocol

MaskArray = NDArray[np.uint64]

LOWEST_THRESHOLD = 0.02
"""The lowest threshold above 0 of both published protocols: lower scores all act like a score of 0."""


def share_below_lowest_threshold(score: Float64Array) -> float | None:
    """Return which share of (N,) scores act like 0, in [0, 1]; None without scores."""
    return float((score < LOWEST_THRESHOLD).mean()) if len(score) else None


def score_thresholds(protocol: Protocol) -> Float64Array:
    """Return the ascending score thresholds, with the rounding of `numpy.arange` (reference: `_conf_thresholds`).

    The grid is `arange` and not k / 50: its 0.7 is 0.7000000000000001, which a score of 0.7 does not reach.
    """
    return np.arange(0.0, 1.01, 1.0 / protocol.score_steps)


def active_masks(score: Float64Array, thresholds: Float64Array) -> MaskArray:
    """Return (N,) at which thresholds predictions of these scores are active; never for NaN or below 0.

    Args:
        score: (N,) any numbers.
        thresholds: (T,) of `score_thresholds`: from 0 to 1, and but for rounding as far from each other.
    """
    # Which one is the first that is not reached, only the grid's own numbers tell; a search in it takes five times as long.
    near = (np.fmin(np.fmax(score, 0.0), 1.0) * (len(thresholds) - 1)).astype(np.intp)
    after = np.append(thresholds, np.nan)[near + 1]
    level = near + (thresholds[near] <= score) + (after <= score)
    return prefix_masks(len(thresholds))[level]


def prefix_masks(threshold_count: int) -> MaskArray:
    """Return (T + 1,) masks; number n has the lowest n thresholds."""
    return np.array([(1 << level) - 1 for level in range(threshold_count + 1)], dtype=np.uint64)


def has_threshold(masks: MaskArray, threshold_index: NDArray[np.integer] | int) -> NDArray[np.bool_]:
    """Return (N,) whether each mask contains the threshold of that index (one for all, or one for each)."""
    shift = np.asarray(threshold_index, dtype=np.uint64)
    return np.asarray((masks >> shift) & np.uint64(1)).astype(bool)


def count_by_group(
    group: NDArray[np.integer], masks: MaskArray, group_count: int, threshold_count: int
) -> NDArray[np.int64]:
    """Count, for each group and threshold, the masks that contain the threshold.

    Nearly every mask is a prefix ("active up to its score"): those are counted by their length alone.

    Args:
        group: (N,) in [0, group_count).
        masks: (N,) masks.
        group_count: Number of groups G.
        threshold_count: Number of thresholds T.

    Returns:
        (G, T) int64 counts; zeros without input.
    """
    level = np.bitwise_count(masks).astype(np.intp)
    is_prefix = prefix_masks(threshold_count)[level] == masks
    width = threshold_count + 1
    by_level = np.bincount(group[is_prefix] * width + level[is_prefix], minlength=group_count * width)
    counts = by_level.reshape(group_count, width)[:, ::-1].cumsum(axis=1)[:, -2::-1]
    row, threshold = np.nonzero(unpacked(masks[~is_prefix], threshold_count))
    rest = np.bincount(group[~is_prefix][row] * threshold_count + threshold, minlength=group_count * threshold_count)
    return np.asarray(counts + rest.reshape(group_count, threshold_count))


def unpacked(masks: MaskArray, threshold_count: int) -> NDArray[np.bool_]:
    """Return (N, T) booleans: row n says which thresholds mask n contains."""
    octets = masks.astype("<u8").view(np.uint8).reshape(-1, 8)
    return np.unpackbits(octets, axis=1, count=threshold_count, bitorder="little").astype(bool)
