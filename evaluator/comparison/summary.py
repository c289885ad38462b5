"""All comparison metrics of one submission, as plain frozen values."""

import msgspec

from evaluator.comparison.argoverse import ArgoverseScores, evaluate_argoverse
from evaluator.comparison.boxes import class_boxes
from evaluator.comparison.kitti import KittiScores, evaluate_kitti
from evaluator.comparison.nuscenes import NuscenesScores, evaluate_nuscenes
from evaluator.comparison.waymo import WaymoScores, evaluate_waymo
from evaluator.ground_truth import GroundTruth
from evaluator.predictions import Predictions


class ComparisonMetrics(msgspec.Struct, frozen=True, kw_only=True):
    """The same boxes in other benchmarks' eyes. For reading beside the ranking number, never for ranking."""

    kitti: KittiScores
    nuscenes: NuscenesScores
    waymo: WaymoScores
    argoverse: ArgoverseScores


def comparison_metrics(ground_truth: GroundTruth, predictions: Predictions) -> ComparisonMetrics:
    """Score a submission with every comparison metric and its frozen parameters.

    Raises:
        UsageError: The two do not list the same images in the same order.
    """
    classes = class_boxes(predictions, ground_truth)
    return ComparisonMetrics(
        kitti=evaluate_kitti(classes),
        nuscenes=evaluate_nuscenes(classes),
        waymo=evaluate_waymo(classes),
        argoverse=evaluate_argoverse(classes),
    )
