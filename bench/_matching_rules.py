"""Matching with each rule of the protocols `cityscapes3d` and `paper` to be chosen by itself.

Plain and slow, made from the evaluator's parts. With all rules of one protocol it must give that protocol's scores
(protocol_differences.py makes sure of it), so that what lies between is the effect of the rules and of nothing else.
"""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from evaluator.candidates import pairs_within_groups
from evaluator.ground_truth import GroundTruth
from evaluator.matching import Edges, Matches, groups_of, matches_of, take_edges
from evaluator.overlap import corners_px, intersections_over_unions
from evaluator.paper_matching import LEAST_IGNORED_FRACTION as LEAST_COVERED
from evaluator.paper_matching import plain_ious
from evaluator.predictions import Float64Array, Predictions
from evaluator.projection import projected_corners_px
from evaluator.protocol import CITYSCAPES3D
from evaluator.thresholds import active_masks, score_thresholds

PIXEL = np.array([[0.0], [0.0], [1.0], [1.0]])
"""What widths and heights that count both border pixels add to the far corner."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rules:
    """What may differ in the matching; the defaults are those of `cityscapes3d`."""

    projects_ground_truth: bool = False
    """2D boxes of the ground truth come from its 3D boxes, not from the annotation."""
    clips: bool = True
    """Projected boxes end at the border of the image."""
    plain_overlap: bool = False
    """Widths are x_max - x_min, and an overlap of exactly 0.7 is enough; of ignore regions, too."""
    by_score: bool = False
    """The greatest score goes first, to the box it overlaps most; not the greatest IoU at each threshold anew."""
    ignores_projected: bool = False
    """Ignore regions are compared with the projected box, not with the submitted modal one."""
    unites_regions: bool = False
    """Ignore regions are taken together, not one by one."""


PAPER_RULES = Rules(
    projects_ground_truth=True,
    clips=False,
    plain_overlap=True,
    by_score=True,
    ignores_projected=True,
    unites_regions=True,
)


def match_by_rules(ground_truth: GroundTruth, predictions: Predictions, rules: Rules) -> Matches:
    """Match with the labels, thresholds and least overlap of `cityscapes3d`, by these rules."""
    thresholds = score_thresholds(CITYSCAPES3D)
    active = active_masks(predictions.score, thresholds)
    boxes = _projected(ground_truth, predictions, clip=rules.clips)
    truth = corners_px(ground_truth.amodal_px)
    if rules.projects_ground_truth:
        truth = _projected(ground_truth, ground_truth, clip=rules.clips)
    edges = _candidates(ground_truth, predictions, (truth, boxes), rules)
    free_gt = np.full(len(ground_truth), (1 << len(thresholds)) - 1, dtype=np.uint64)
    unmatched = active.copy()
    if rules.by_score:
        edges = _in_order_of_scores(edges, predictions.score)
    taken = take_edges(edges, free_gt, unmatched)
    compared = boxes if rules.ignores_projected else corners_px(predictions.modal_px)
    ignored = np.where(_inside_ignore_region(ground_truth, predictions, compared, rules), unmatched, np.uint64(0))
    return matches_of(edges, taken, thresholds=thresholds, free_gt=free_gt, unmatched=unmatched, ignored=ignored)


def _projected(ground_truth: GroundTruth, boxes: GroundTruth | Predictions, *, clip: bool) -> Float64Array:
    return projected_corners_px(
        boxes.center_m,
        boxes.dimensions_m,
        boxes.rotation,
        intrinsics_px=ground_truth.intrinsics_px,
        sensor_from_vehicle=ground_truth.sensor_from_vehicle,
        camera_index=boxes.image_index,
        clip=clip,
    )


def _candidates(
    ground_truth: GroundTruth, predictions: Predictions, boxes: tuple[Float64Array, Float64Array], rules: Rules
) -> Edges:
    """Return the pairs that overlap enough, the greatest IoU first."""
    blocks = pairs_within_groups(*groups_of(ground_truth, predictions, CITYSCAPES3D))
    gt_row, prediction_row = (np.concatenate(rows) for rows in zip(*blocks, strict=True))
    pairs = boxes[0][:, gt_row], boxes[1][:, prediction_row]
    iou = plain_ious(*pairs) if rules.plain_overlap else intersections_over_unions(*pairs)
    enough = np.flatnonzero(iou >= CITYSCAPES3D.min_iou if rules.plain_overlap else iou > CITYSCAPES3D.min_iou)
    order = enough[np.argsort(-iou[enough], kind="stable")]
    return Edges(gt_row[order], prediction_row[order])


def _in_order_of_scores(edges: Edges, score: Float64Array) -> Edges:
    """Return each prediction's best pair alone, the greatest score first: who comes later finds the box taken."""
    _, best = np.unique(edges.prediction_index, return_index=True)
    row = edges.prediction_index[best]
    order = best[np.lexsort((row, -score[row]))]
    return Edges(edges.ground_truth_index[order], edges.prediction_index[order])


def _inside_ignore_region(
    ground_truth: GroundTruth, predictions: Predictions, boxes: Float64Array, rules: Rules
) -> NDArray[np.bool_]:
    """Return (N,) whether enough of each box lies in the ignore regions of its image."""
    pixel = np.zeros((4, 1)) if rules.plain_overlap else PIXEL
    regions = np.asarray(shapely.box(*(corners_px(ground_truth.ignore_px) + pixel)))
    inside = np.zeros(len(predictions), dtype=bool)
    for image in np.unique(ground_truth.ignore_image_index):
        own = regions[ground_truth.ignore_image_index == image]
        compared = np.array([shapely.union_all(own)]) if rules.unites_regions else own
        rows = np.flatnonzero(predictions.image_index == image)
        shapes = np.asarray(shapely.box(*(boxes[:, rows] + pixel)))
        area = shapely.area(shapes)
        covered = shapely.area(shapely.intersection(shapes[:, None], compared)).max(axis=1)
        least = LEAST_COVERED * np.where(area > 0, area, np.inf)
        inside[rows] = covered >= least if rules.plain_overlap else covered > least
    return inside
