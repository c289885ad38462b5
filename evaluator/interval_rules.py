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

FEWEST_UNITS = 100
"""Images, or sequences or cities where these are drawn, for any interval."""
FEWEST_BOXES = 10
"""Ground-truth boxes of a class for its AP and detection score, and of each class for their means."""
FEWEST_BOXES_IN_BIN = 20
"""Ground-truth boxes in a depth bin for its AP."""
FEWEST_TRUE_POSITIVES = 20
"""In a depth bin for its similarities; for those of a class the harmonic mean over its bins, which weighs thin ones."""
FEWEST_TRUE_POSITIVES_FOR_YAW = 400
"""For YawSim: one box in some hundreds is turned round, and a sample without such a box shows nothing of it."""

BoolArray = NDArray[np.bool_]


def sufficient(statistics: Statistics, estimate: Replicates, units: int) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Tell which metrics get an interval.

    Args:
        statistics: Outcomes of one submission.
        estimate: Its scores, as the only row.
        units: How many images, sequences or cities are drawn from.

    Returns:
        For means (6,), classes (C, 6) and depth bins (C, B, 5), in the order of `Replicates`. A mean needs enough of
        every class with ground truth.
    """
    boxes = np.bincount(statistics.ground_truth_cell, minlength=int(np.prod(statistics.grid))).reshape(statistics.grid)
    found = estimate.true_positives[0]
    of_class = boxes.sum(axis=1)
    classes = _by_metric(METRICS, of_class >= FEWEST_BOXES, _harmonic_mean(found), found.sum(axis=1))
    classes &= can_be_resampled(statistics.protocol)
    bins = _by_metric(BIN_METRICS, boxes[:, :-1] >= FEWEST_BOXES_IN_BIN, found, found)
    means = classes[of_class > 0].all(axis=0)
    trusted = units >= FEWEST_UNITS
    return means & trusted, classes & trusted, bins[:, : estimate.depth_bins.shape[2]] & trusted


def can_be_resampled(protocol: Protocol) -> BoolArray:
    """Tell for which metrics of a class, in the order of `METRICS`, resamples scatter about the score.

    The protocol `paper` averages similarities over all depth bins, one without true positives counting as nothing. A
    resample that empties a thin bin loses it, and none fills an empty one, so almost all of them lie below the score, and
    detection scores and mDS with them.
    """
    return np.array([protocol.name != PAPER.name or metric == "ap" for metric in METRICS])


def _by_metric(
    metrics: tuple[str, ...], enough_boxes: BoolArray, typical: Float64Array, total: Float64Array
) -> BoolArray:
    """Return (..., K) for the metrics: true positives in a typical depth bin and in all decide on similarities."""
    enough = typical >= FEWEST_TRUE_POSITIVES
    of_metric = {
        "ap": enough_boxes,
        "detection_score": enough_boxes,
        "yaw_sim": enough & (total >= FEWEST_TRUE_POSITIVES_FOR_YAW),
    }
    return np.stack([of_metric.get(metric, enough) for metric in metrics], axis=-1)


def _harmonic_mean(true_positives: Float64Array) -> Float64Array:
    """Return (C,) of the bins that hold any; 0 where none does. Every bin weighs the same, so thin ones decide."""
    filled = true_positives > 0
    inverse = np.where(filled, 1 / np.maximum(true_positives, 1), 0).sum(axis=1)
    return np.asarray(filled.sum(axis=1) / np.where(inverse > 0, inverse, 1))
