"""What matches what at which score threshold: the greedy 2D matching of predictions with ground truth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluator.predictions import Float64Array, IndexArray

MaskArray = NDArray[np.uint64]
"""Sets of score thresholds: bit t stands for `thresholds[t]`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Matches:
    """The matching of one submission at all score thresholds at once.

    N predictions, M ground-truth boxes, T <= 64 thresholds, P pairs. A pair that is matched at several
    thresholds stands once, with one bit for each; a box may be in several pairs, never twice at one threshold.
    """

    thresholds: Float64Array
    """(T,) score thresholds, ascending; a prediction is active at all that are <= its score."""
    ground_truth_index: IndexArray
    """(P,) int32, row in `GroundTruth`."""
    prediction_index: IndexArray
    """(P,) int32, row in `Predictions`."""
    pair_thresholds: MaskArray
    """(P,) at which thresholds this pair is a true positive; never 0."""
    false_positive_thresholds: MaskArray
    """(N,) at which thresholds a prediction is a false positive: active, unmatched, not ignored."""
    ignored_thresholds: MaskArray
    """(N,) at which thresholds a prediction is discarded: active, unmatched, inside an ignore region."""
    matched_thresholds: MaskArray
    """(M,) at which thresholds a ground-truth box is found; 0 for boxes of classes that are not evaluated."""
