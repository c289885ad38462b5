"""The one way from arrays to scores: `evaluate`."""

from collections.abc import Callable
from dataclasses import dataclass

from evaluator.ground_truth import GroundTruth
from evaluator.matching import Matches, match
from evaluator.paper_scoring import score_by_paper
from evaluator.predictions import Predictions
from evaluator.protocol import CITYSCAPES3D, EVALUATOR_VERSION, PAPER, Protocol, Signature, require_usable
from evaluator.results import Scores
from evaluator.scoring import score
from evaluator.statistics import Statistics, collect


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """Scores together with everything they were made from."""

    scores: Scores
    matches: Matches
    predictions: Predictions
    ground_truth: GroundTruth
    statistics: Statistics


def evaluate(
    ground_truth: GroundTruth,
    predictions: Predictions,
    protocol: Protocol = CITYSCAPES3D,
    *,
    ground_truth_sha256: str = "",
    predictions_sha256: str = "",
    progress: Callable[[int, int], None] | None = None,
) -> Evaluation:
    """Score predictions against ground truth.

    Args:
        ground_truth: Boxes and ignore regions of all images.
        predictions: Boxes for the same images, in the same order.
        protocol: The rules.
        ground_truth_sha256: `GroundTruth.sha256`, for the signature.
        predictions_sha256: Digest of the submission (`Intake.sha256`), likewise.
        progress: Called with images done and images in all.

    Returns:
        The scores with their matches and per-image statistics.

    Raises:
        UsageError: The images differ, or a parameter of the protocol has no meaning (`require_usable`).
    """
    matches = match_by_protocol(ground_truth, predictions, protocol)
    signature = signature_of(protocol, ground_truth_sha256, predictions_sha256)
    statistics = collect(ground_truth, predictions, matches, signature)
    scores = score_by_protocol(statistics)
    if progress is not None:
        progress(len(ground_truth.images), len(ground_truth.images))
    return Evaluation(
        scores=scores, matches=matches, predictions=predictions, ground_truth=ground_truth, statistics=statistics
    )


def signature_of(protocol: Protocol, ground_truth_sha256: str = "", predictions_sha256: str = "") -> Signature:
    """Return the signature of a result of this version of the evaluator; digests that nobody knows are empty."""
    return Signature(
        protocol=protocol,
        evaluator_version=EVALUATOR_VERSION,
        ground_truth_sha256=ground_truth_sha256,
        predictions_sha256=predictions_sha256,
    )


def match_by_protocol(ground_truth: GroundTruth, predictions: Predictions, protocol: Protocol) -> Matches:
    """Match by the rules of the protocol's family.

    Raises:
        UsageError: The images differ, or a parameter of the protocol has no meaning.
    """
    require_usable(protocol)
    if protocol.name == PAPER.name:
        from evaluator.paper_matching import match_by_paper  # noqa: PLC0415 - shapely is slow to import and seldom needed

        return match_by_paper(ground_truth, predictions, protocol)
    return match(ground_truth, predictions, protocol)


def score_by_protocol(statistics: Statistics) -> Scores:
    """Aggregate by the rules of the protocol's family."""
    return score_by_paper(statistics) if statistics.protocol.name == PAPER.name else score(statistics)
