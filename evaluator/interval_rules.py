"""Where too little is known for a confidence interval that keeps its promise; then none is given.

Resampling can only show what was seen. The limits come from simulation (docs/metrics.md, bench/interval_coverage.py):
above them 95 % intervals cover the truth 93 to 97 times in 100, below them they do not.
"""

import numpy as np
from numpy.typing import NDArray

from evaluator.predictions import Float64Array
from evaluator.protocol import PAPER, Protocol
from evaluator.replicates import BIN_METRICS, METRICS, Replicates
from evaluator.statistics import Statistics

FEWEST_FOR_INTERVALS = 500
"""Images, or sequences or cities where these are drawn, for any interval, and for any difference of two submissions."""
FEWEST_BOXES = 10
"""Ground-truth boxes of a class for its AP and detection score, and of each class for mAP and mDS."""
FEWEST_BOXES_FOR_DIFFERENCE = 500
"""Ground-truth boxes of a class for the difference of two detection scores: what both find alike cancels, little is left."""
FEWEST_BOXES_IN_BIN = 20
"""Ground-truth boxes in a depth bin for its AP."""
FEWEST_TRUE_POSITIVES = 10
"""Of a class for its AP and detection score, not for mAP and mDS, of which what is hardly ever found is a small part."""
FEWEST_TRUE_POSITIVES_IN_BIN = 30
"""In a depth bin for its similarities."""
FEWEST_TRUE_POSITIVES_IN_BIN_FOR_YAW = 400
"""For YawSim: one box in some hundreds is turned round, and a sample without such a box shows nothing of it."""
FEWEST_TRUE_POSITIVES_PER_BIN = 60
"""For similarities of a class: the harmonic mean over its bins that hold any, which weighs thin ones, as the score does.

Where a bin of two or three boxes is empty by chance, the mean over the others is high and the score is another one. So
the limit lies above all that was seen of a class with such a bin.
"""
FEWEST_TRUE_POSITIVES_PER_BIN_FOR_YAW = 100
"""The same mean for YawSim."""

BoolArray = NDArray[np.bool_]


def sufficient(statistics: Statistics, estimate: Replicates, units: int) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Tell which metrics get an interval.

    Args:
        statistics: Outcomes of one submission.
        estimate: Its scores, as the only row.
        units: How many images, sequences or cities are drawn from.

    Returns:
        For means (6,), classes (C, 6) and depth bins (C, B, 5), in the order of `Replicates`. A mean needs enough of
        every class with ground truth; so does a difference of means, of both submissions.
    """
    boxes = np.bincount(statistics.ground_truth_cell, minlength=int(np.prod(statistics.grid))).reshape(statistics.grid)
    found = estimate.true_positives[0]
    of_class, per_bin = boxes.sum(axis=1), _harmonic_mean(found)
    similarities = per_bin >= FEWEST_TRUE_POSITIVES_PER_BIN, per_bin >= FEWEST_TRUE_POSITIVES_PER_BIN_FOR_YAW
    known = (of_class >= FEWEST_BOXES) & (found.sum(axis=1) >= FEWEST_TRUE_POSITIVES)
    classes = _by_metric(METRICS, known, *similarities)
    means = _by_metric(METRICS, of_class >= FEWEST_BOXES, *similarities)[of_class > 0].all(axis=0)
    bins = _by_metric(
        BIN_METRICS,
        boxes[:, :-1] >= FEWEST_BOXES_IN_BIN,
        found >= FEWEST_TRUE_POSITIVES_IN_BIN,
        found >= FEWEST_TRUE_POSITIVES_IN_BIN_FOR_YAW,
    )
    trusted, possible = units >= FEWEST_FOR_INTERVALS, can_be_resampled(statistics.protocol)
    return means & possible & trusted, classes & possible & trusted, bins[:, : estimate.depth_bins.shape[2]] & trusted


def can_be_resampled(protocol: Protocol) -> BoolArray:
    """Tell for which metrics of a class, in the order of `METRICS`, resamples scatter about the score.

    The protocol `paper` averages similarities over all depth bins, one without true positives counting as nothing. A
    resample that empties a thin bin loses it, and none fills an empty one, so almost all of them lie below the score, and
    detection scores and mDS with them.
    """
    return np.array([protocol.name != PAPER.name or metric == "ap" for metric in METRICS])


def _by_metric(metrics: tuple[str, ...], scores: BoolArray, similarities: BoolArray, yaw: BoolArray) -> BoolArray:
    """Return (..., K) for the metrics, from what is known for AP and detection scores, for similarities and for YawSim."""
    of_metric = {"ap": scores, "detection_score": scores, "yaw_sim": yaw}
    return np.stack([of_metric.get(metric, similarities) for metric in metrics], axis=-1)


def _harmonic_mean(true_positives: Float64Array) -> Float64Array:
    """Return (C,) of the bins that hold any; 0 where none does. Every bin weighs the same, so thin ones decide."""
    filled = true_positives > 0
    inverse = np.where(filled, 1 / np.maximum(true_positives, 1), 0).sum(axis=1)
    return np.asarray(filled.sum(axis=1) / np.where(inverse > 0, inverse, 1))
