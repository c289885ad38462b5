"""The four similarities of a true positive, and their average over depth bins (DDTP).

Paper, section Depth-Dependent True Positive Metrics; reference: `_calcCenterDistances`, `_calcSizeSimilarities`,
`_calcOrientationSimilarities`, `_calculateAUC`. Every similarity is in [0, 1], 1 for equal boxes, greater is better.
"""

import numpy as np

from evaluator.average_precision import CountArray
from evaluator.orientation import yaw_pitch_roll_rad
from evaluator.predictions import Float64Array
from evaluator.protocol import FEWEST_BINS

SIMILARITIES = ("bevcd", "yaw_sim", "pr_sim", "size_sim")
"""Column order wherever the four stand in one array."""


def center_similarity(first_m: Float64Array, second_m: Float64Array, max_depth_m: float) -> Float64Array:
    """Compare positions on the ground plane: 1 - min(distance / max_depth, 1).

    Args:
        first_m: (P, 3) centres in the vehicle frame.
        second_m: (P, 3) centres in the vehicle frame.
        max_depth_m: The distance that counts as entirely wrong (the paper's X_max).

    Returns:
        (P,) in [0, 1].
    """
    offset = first_m - second_m
    distance = np.sqrt(offset[:, 0] ** 2 + offset[:, 1] ** 2)
    return np.asarray(1.0 - np.minimum(distance / max_depth_m, 1.0))


def yaw_similarity(first_rad: Float64Array, second_rad: Float64Array) -> Float64Array:
    """Compare headings: (1 + cos(difference)) / 2, for (P,) yaw angles; (P,) in [0, 1]."""
    return np.asarray((1.0 + np.cos(first_rad - second_rad)) / 2.0)


def pitch_roll_similarity(first_rad: Float64Array, second_rad: Float64Array) -> Float64Array:
    """Compare tilts: (2 + cos(pitch difference) + cos(roll difference)) / 4.

    Args:
        first_rad: (2, P) pitch and roll.
        second_rad: (2, P) pitch and roll.

    Returns:
        (P,) in [0, 1].
    """
    pitch, roll = np.cos(first_rad - second_rad)
    return np.asarray(0.5 + (pitch + roll) / 4.0)


def size_similarity(first_m: Float64Array, second_m: Float64Array) -> Float64Array:
    """Compare dimensions: the product of min(a / b, b / a) over length, width and height; (P, 3) to (P,) in [0, 1]."""
    return np.asarray(np.prod(np.minimum(first_m / second_m, second_m / first_m), axis=1))


def pair_similarities(
    center_m: tuple[Float64Array, Float64Array],
    dimensions_m: tuple[Float64Array, Float64Array],
    rotation: tuple[Float64Array, Float64Array],
    max_depth_m: float,
) -> Float64Array:
    """Compute all four similarities of matched pairs.

    Args:
        center_m: (P, 3) centres of ground truth and prediction, vehicle frame.
        dimensions_m: (P, 3) length, width, height of both.
        rotation: (P, 4) quaternions w, x, y, z of both.
        max_depth_m: The paper's X_max.

    Returns:
        (P, 4) in the order of `SIMILARITIES`.
    """
    first, second = (yaw_pitch_roll_rad(quaternions) for quaternions in rotation)
    return np.stack(
        [
            center_similarity(*center_m, max_depth_m),
            yaw_similarity(first[0], second[0]),
            pitch_roll_similarity(first[1:], second[1:]),
            size_similarity(*dimensions_m),
        ],
        axis=1,
    )


def mean_over_bins(sums: Float64Array, counts: CountArray) -> Float64Array:
    """Average similarities within each depth bin, then over the bins that hold a true positive.

    Every bin weighs the same. With fewer than two such bins the result is 0, as in the reference.

    Args:
        sums: (..., B, 4) sums of the similarities of the true positives in each depth bin.
        counts: (..., B) true positives in each bin.

    Returns:
        (..., 4) in [0, 1].
    """
    filled = counts > 0
    means = sums / np.where(filled, counts, 1)[..., None]
    bins = filled.sum(axis=-1)
    average = np.where(filled[..., None], means, 0).sum(axis=-2) / np.maximum(bins, 1)[..., None]
    return np.where(bins[..., None] >= FEWEST_BINS, average, 0.0)


def integral_over_range(sums: Float64Array, counts: CountArray) -> Float64Array:
    """Average over the whole depth range: the paper's integral over [0, X_max], divided by X_max.

    A bin without a true positive has nothing to be similar and contributes 0, for all four similarities alike.

    Args:
        sums: (..., B, 4) sums of the similarities of the true positives in each depth bin.
        counts: (..., B) true positives in each bin.

    Returns:
        (..., 4) in [0, 1]; 1 only when every bin holds true positives and all are perfect.
    """
    return np.asarray((sums / np.maximum(counts, 1)[..., None]).mean(axis=-2))
