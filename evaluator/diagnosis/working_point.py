"""What happened at each class's working point: found, missed, false, discarded. The view every diagnosis starts from."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluator.candidates import RowArray
from evaluator.comparison.boxes import camera_positions
from evaluator.evaluation import Evaluation
from evaluator.matching import class_index
from evaluator.predictions import Float64Array
from evaluator.thresholds import has_threshold

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkingPoint:
    """Outcomes of N predictions and M ground-truth boxes at the thresholds c_w of their classes.

    Classes are positions among the evaluated labels, -1 for boxes of other labels, which have no outcome.
    """

    labels: tuple[str, ...]
    threshold_index: NDArray[np.intp]
    """(C,) which threshold is the class's c_w; 0 for a class without ground truth."""
    ground_truth_class: NDArray[np.int32]
    """(M,)."""
    prediction_class: NDArray[np.int32]
    """(N,)."""
    pair_ground_truth: RowArray
    """(P,) ground-truth row of each true positive."""
    pair_prediction: RowArray
    """(P,) prediction row of each true positive."""
    found: BoolArray
    """(M,) the box is matched."""
    false_positive: BoolArray
    """(N,) active, unmatched and not discarded."""
    discarded: BoolArray
    """(N,) active, unmatched, inside an ignore region."""
    camera_m: Float64Array
    """(I, 3) where each image's camera stands in the vehicle frame."""

    @property
    def pair_class(self) -> NDArray[np.int32]:
        """(P,) class of each true positive."""
        return self.ground_truth_class[self.pair_ground_truth]


def at_working_point(evaluation: Evaluation) -> WorkingPoint:
    """Read the outcomes at each class's working point from the matches.

    A class without ground truth has no working point; the lowest threshold stands in for it.
    """
    matches, scores = evaluation.matches, evaluation.scores
    ground_truth, predictions = evaluation.ground_truth, evaluation.predictions
    points = np.array([item.working_point or 0.0 for item in scores.classes])
    index = np.searchsorted(matches.thresholds, points)
    protocol = scores.signature.protocol
    truth_class = class_index(ground_truth.labels, ground_truth.label_index, protocol)
    prediction_class = class_index(predictions.labels, predictions.label_index, protocol)
    of_truth, of_prediction = index[truth_class], index[prediction_class]
    pairs = np.flatnonzero(has_threshold(matches.pair_thresholds, of_truth[matches.ground_truth_index]))
    evaluated = prediction_class >= 0
    return WorkingPoint(
        labels=tuple(item.label for item in scores.classes),
        threshold_index=index,
        ground_truth_class=truth_class,
        prediction_class=prediction_class,
        pair_ground_truth=matches.ground_truth_index[pairs].astype(np.int64),
        pair_prediction=matches.prediction_index[pairs].astype(np.int64),
        found=has_threshold(matches.matched_thresholds, of_truth) & (truth_class >= 0),
        false_positive=has_threshold(matches.false_positive_thresholds, of_prediction) & evaluated,
        discarded=has_threshold(matches.ignored_thresholds, of_prediction) & evaluated,
        camera_m=camera_positions(ground_truth.sensor_from_vehicle),
    )
