"""KITTI-style AP_BEV and AP_3D at 40 recall positions.

Sources: Geiger et al., "Are we ready for autonomous driving?", CVPR 2012, and its object development kit
(`evaluate_object.cpp`: overlap strictly above the minimum, greedy matching by ground-truth box); Simonelli et al.,
"Disentangling Monocular 3D Object Detection", ICCV 2019, section 5 (AP|R40).

What applies and what does not:
- Overlap: rotated footprints on the ground plane (BEV), times the common height (3D). Pitch and roll are dropped.
- Matching: at every score each ground-truth box, in the order of the file, takes the prediction still free that overlaps
  it most. Where boxes of one class overlap each other so much that a prediction fits both, their order matters, as there.
- KITTI's difficulty classes do not apply. Cityscapes 3D has neither their occlusion levels nor their limits on image
  height and truncation; every annotated box counts, and heavily occluded vehicles are ignore regions already.
- KITTI's neighbouring classes (van beside car) do not exist here. DontCare areas are the ignore regions.
- The development kit samples at most 41 score thresholds and so gives a perfect result less than 1 when a class has
  fewer than 40 boxes. Here AP|R40 is taken from its definition: the mean over r = 1/40 ... 40/40 of the best precision
  at any recall of at least r, with a point on the curve for every distinct score. (The kit also chooses its scores by another
  matching, in which a box takes the highest score.)
"""

import msgspec
import numpy as np

from evaluator.candidates import RowArray, pairs_within_groups
from evaluator.comparison.assignment import match_by_box
from evaluator.comparison.boxes import ClassBoxes
from evaluator.comparison.means import defined_mean
from evaluator.comparison.overlap import may_overlap, overlaps
from evaluator.predictions import Float64Array


class KittiParameters(msgspec.Struct, frozen=True, kw_only=True):
    """What the numbers depend on."""

    min_ious: tuple[float, ...] = (0.7, 0.5)
    """A match needs an overlap strictly above this: KITTI takes 0.7 for cars and 0.5 for two-wheelers."""
    recall_positions: int = 40


KITTI = KittiParameters()


class KittiAp(msgspec.Struct, frozen=True, kw_only=True):
    """AP of one class, or its mean over classes, at one overlap; in [0, 1], greater is better, None if undefined."""

    min_iou: float
    ap_bev: float | None
    ap_3d: float | None


class KittiClass(msgspec.Struct, frozen=True, kw_only=True):
    """One class; every AP is None without ground truth and 0 without predictions."""

    label: str
    ground_truth_count: int
    overlaps: tuple[KittiAp, ...]
    """One for each of `min_ious`."""


class KittiScores(msgspec.Struct, frozen=True, kw_only=True):
    """All classes, and the mean over those with ground truth."""

    parameters: KittiParameters
    means: tuple[KittiAp, ...]
    classes: tuple[KittiClass, ...]


def evaluate_kitti(classes: tuple[ClassBoxes, ...], parameters: KittiParameters = KITTI) -> KittiScores:
    """Score every class with KITTI's two 3D measures."""
    scores = tuple(_evaluate_class(boxes, parameters) for boxes in classes)
    means = tuple(
        KittiAp(
            min_iou=min_iou,
            ap_bev=defined_mean(score.overlaps[i].ap_bev for score in scores),
            ap_3d=defined_mean(score.overlaps[i].ap_3d for score in scores),
        )
        for i, min_iou in enumerate(parameters.min_ious)
    )
    return KittiScores(parameters=parameters, means=means, classes=scores)


def _evaluate_class(boxes: ClassBoxes, parameters: KittiParameters) -> KittiClass:
    """Score one class at every overlap; the overlaps are measured once."""
    prediction, ground_truth, bev, volume = overlapping_pairs(boxes)

    def ap(iou: Float64Array, min_iou: float) -> float | None:
        near = iou > min_iou
        found, wrong = match_by_box(prediction[near], ground_truth[near], iou[near], boxes.excused)
        return average_precision(found, wrong, boxes.score, len(boxes.ground_truth), parameters.recall_positions)

    return KittiClass(
        label=boxes.label,
        ground_truth_count=len(boxes.ground_truth),
        overlaps=tuple(
            KittiAp(min_iou=min_iou, ap_bev=ap(bev, min_iou), ap_3d=ap(volume, min_iou))
            for min_iou in parameters.min_ious
        ),
    )


def overlapping_pairs(boxes: ClassBoxes) -> tuple[RowArray, RowArray, Float64Array, Float64Array]:
    """Return the pairs of one image whose footprints touch: prediction row, ground-truth row, BEV IoU, 3D IoU."""
    found = [
        (prediction[near], ground_truth[near])
        for prediction, ground_truth in pairs_within_groups(
            boxes.predictions.image_index, boxes.ground_truth.image_index
        )
        for near in [may_overlap(boxes.predictions.take(prediction), boxes.ground_truth.take(ground_truth))]
    ]
    empty = np.empty(0, dtype=np.int64)
    prediction = np.concatenate([empty, *(pair[0] for pair in found)])
    ground_truth = np.concatenate([empty, *(pair[1] for pair in found)])
    bev, volume = overlaps(boxes.predictions.take(prediction), boxes.ground_truth.take(ground_truth))
    return prediction, ground_truth, bev, volume


def average_precision(
    found: RowArray, wrong: RowArray, score: Float64Array, ground_truth_count: int, recall_positions: int
) -> float | None:
    """Return AP at evenly spaced recall positions 1/n ... 1 (Simonelli et al., equation 8).

    Args:
        found: (N,) how many true positives there are among each prediction and those of higher scores.
        wrong: (N,) how many false positives there are among them.
        score: (N,) descending; predictions of equal score enter the curve together.
        ground_truth_count: Number of ground-truth boxes.
        recall_positions: n.

    Returns:
        In [0, 1], greater is better. None without ground truth, 0 without predictions.
    """
    if not ground_truth_count:
        return None
    if not len(score):
        return 0.0
    end_of_tie = np.append(score[1:] != score[:-1], values=True)
    found, wrong = found[end_of_tie], wrong[end_of_tie]
    precision = found / np.maximum(found + wrong, 1)
    best = np.append(np.maximum.accumulate(precision[::-1])[::-1], 0.0)
    # recall >= k/n in whole numbers: found * n >= k * count
    wanted = np.arange(1, recall_positions + 1) * ground_truth_count
    return float(best[np.searchsorted(found * recall_positions, wanted, side="left")].mean())
