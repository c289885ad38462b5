"""All comparison metrics of one submission, as plain frozen values."""

import msgspec

from evaluator.comparison.argoverse import ArgoverseScores, evaluate_argoverse
from evaluator.comparison.boxes import class_boxes
from evaluator.comparison.kitti import KittiScores, evaluate_kitti
from evaluator.comparison.nuscenes import NuscenesScores, evaluate_nuscenes
from evaluator.comparison.waymo import WaymoScores, evaluate_waymo
from evaluator.ground_truth import GroundTruth
from evaluator.predictions import Predictions
from evaluator.protocol import EVALUATOR_VERSION


class ComparisonSignature(msgspec.Struct, frozen=True, kw_only=True):
    """Everything the numbers depend on besides the parameters, which each benchmark's scores hold themselves.

    No protocol is part of it: the rules that rank change nothing here.
    """

    evaluator_version: str
    ground_truth_sha256: str
    predictions_sha256: str

    def __str__(self) -> str:
        """Print the signature on one line, for citing beside a number."""
        return (
            f"comparison|evaluator:{self.evaluator_version}"
            f"|gt:{self.ground_truth_sha256[:12]}|pred:{self.predictions_sha256[:12]}"
        )


class ComparisonMetrics(msgspec.Struct, frozen=True, kw_only=True):
    """The same boxes in other benchmarks' eyes. For reading beside the ranking number, never for ranking."""

    signature: ComparisonSignature
    kitti: KittiScores
    nuscenes: NuscenesScores
    waymo: WaymoScores
    argoverse: ArgoverseScores


def comparison_metrics(
    ground_truth: GroundTruth,
    predictions: Predictions,
    *,
    ground_truth_sha256: str = "",
    predictions_sha256: str = "",
) -> ComparisonMetrics:
    """Score a submission with every comparison metric and its frozen parameters.

    Args:
        ground_truth: Boxes and ignore regions of all images.
        predictions: Boxes for the same images, in the same order.
        ground_truth_sha256: Digest of the ground truth, for the signature.
        predictions_sha256: Digest of the submission, for the signature.

    Raises:
        UsageError: The two do not list the same images in the same order.
    """
    classes = class_boxes(predictions, ground_truth)
    return ComparisonMetrics(
        signature=ComparisonSignature(
            evaluator_version=EVALUATOR_VERSION,
            ground_truth_sha256=ground_truth_sha256,
            predictions_sha256=predictions_sha256,
        ),
        kitti=evaluate_kitti(classes),
        nuscenes=evaluate_nuscenes(classes),
        waymo=evaluate_waymo(classes),
        argoverse=evaluate_argoverse(classes),
    )
