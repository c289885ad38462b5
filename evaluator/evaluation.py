"""The one way from arrays to scores: `evaluate`."""

from dataclasses import dataclass

from evaluator.ground_truth import GroundTruth
from evaluator.matching import Matches
from evaluator.predictions import Predictions
from evaluator.results import Scores


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """Scores together with everything they were made from."""

    scores: Scores
    matches: Matches
    predictions: Predictions
    ground_truth: GroundTruth
