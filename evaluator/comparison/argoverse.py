"""Argoverse-2-style composite detection score (CDS) without velocity.

Source: Wilson et al., "Argoverse 2", NeurIPS 2021 (datasets), section 4.2 and appendix, and av2 0.3.6
(`evaluation/detection/utils.py`), which it equals on the same boxes with distinct scores
(`bench/comparison_reference.py`). The Argoverse 2 CDS never had a velocity term; nothing is left out of it.

What stays as there: distances in space, 150 m, at most 100 predictions of a class in an image, and the assignment:
every prediction goes to its nearest ground-truth box, and of those only the highest score can be a true positive.
What differs: there are no lidar points and no region of interest to filter by, and unmatched predictions in ignore
regions are no false positives; one that is not near any box is left out before the assignment.
"""

import msgspec
import numpy as np

from evaluator.candidates import RowArray
from evaluator.comparison.boxes import BoolArray, Boxes, ClassBoxes
from evaluator.comparison.centers import heading_errors, near_pairs, scale_errors_by_greatest, space_distance
from evaluator.comparison.means import defined_mean
from evaluator.predictions import Float64Array

_RECALL = np.linspace(0, 1, 101)


class ArgoverseParameters(msgspec.Struct, frozen=True, kw_only=True):
    """What the numbers depend on."""

    distances_m: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)
    """A match needs centres nearer than this in space; AP is the mean over all."""
    error_distance_m: float = 2.0
    """The three errors are taken from the matches at this distance, which also scales the translation error."""
    max_range_m: float = 150.0
    max_predictions_per_image: int = 100


ARGOVERSE = ArgoverseParameters()


class ArgoverseClass(msgspec.Struct, frozen=True, kw_only=True):
    """One class; everything is None without ground truth, and the errors without a match."""

    label: str
    ground_truth_count: int
    ap: float | None
    """Mean of `ap_by_distance`, in [0, 1], greater is better."""
    ap_by_distance: tuple[float | None, ...]
    ate_m: float | None
    """Mean translation error in space, metres in [0, 2), smaller is better."""
    ase: float | None
    """Mean scale error, in [0, 1], smaller is better."""
    aoe_rad: float | None
    """Mean orientation error, radians in [0, pi], smaller is better."""
    cds: float | None
    """ap x mean of (1 - ate/2, 1 - ase, 1 - aoe/pi), in [0, 1], greater is better; 0 without a match."""


class ArgoverseScores(msgspec.Struct, frozen=True, kw_only=True):
    """All classes, and the means over those with ground truth; None when there is no such class."""

    parameters: ArgoverseParameters
    map: float | None
    mcds: float | None
    classes: tuple[ArgoverseClass, ...]


def evaluate_argoverse(classes: tuple[ClassBoxes, ...], parameters: ArgoverseParameters = ARGOVERSE) -> ArgoverseScores:
    """Score every class and take the means."""
    scores = tuple(_evaluate_class(_evaluated(boxes, parameters), parameters) for boxes in classes)
    return ArgoverseScores(
        parameters=parameters,
        map=defined_mean(score.ap for score in scores),
        mcds=defined_mean(score.cds for score in scores),
        classes=scores,
    )


def _evaluated(boxes: ClassBoxes, parameters: ArgoverseParameters) -> ClassBoxes:
    """Leave out far boxes, and all but the highest-scored predictions of each image (`compute_evaluated_*_mask`)."""
    near = [
        np.linalg.norm(side.center_m, axis=1) < parameters.max_range_m
        for side in (boxes.predictions, boxes.ground_truth)
    ]
    boxes = boxes.take_predictions(near[0]).take_ground_truth(near[1])
    kept = rank_in_image(boxes.predictions) < parameters.max_predictions_per_image
    return boxes.take_predictions(kept)


def rank_in_image(boxes: Boxes) -> RowArray:
    """Return (N,) how many earlier rows are of the same image."""
    order = np.argsort(boxes.image_index, kind="stable")
    image = boxes.image_index[order]
    rank = np.empty(len(boxes), dtype=np.int64)
    rank[order] = np.arange(len(boxes)) - np.searchsorted(image, image)
    return rank


def _evaluate_class(boxes: ClassBoxes, parameters: ArgoverseParameters) -> ArgoverseClass:
    """Score one class; the assignment is the same for every distance."""
    count = len(boxes.ground_truth)
    boxes, prediction, ground_truth, apart = assign_nearest(boxes, max(parameters.distances_m))
    aps = [
        average_precision(prediction[apart < distance_m], boxes.excused, count) for distance_m in parameters.distances_m
    ]
    near = apart < parameters.error_distance_m
    first, second = boxes.predictions.take(prediction[near]), boxes.ground_truth.take(ground_truth[near])
    errors = [
        float(error.mean()) if len(error) else None
        for error in (apart[near], scale_errors_by_greatest(first, second), heading_errors(first, second))
    ]
    ap = defined_mean(aps)
    return ArgoverseClass(
        label=boxes.label,
        ground_truth_count=count,
        ap=ap,
        ap_by_distance=tuple(aps),
        ate_m=errors[0],
        ase=errors[1],
        aoe_rad=errors[2],
        cds=None if ap is None else ap * _accuracy(errors, parameters),
    )


def _accuracy(errors: list[float | None], parameters: ArgoverseParameters) -> float:
    """Return the mean of the three errors turned into scores; a missing error counts as the worst."""
    worst = (parameters.error_distance_m, 1.0, float(np.pi))
    return sum(0.0 if error is None else 1 - error / most for error, most in zip(errors, worst, strict=True)) / 3


def assign_nearest(boxes: ClassBoxes, max_m: float) -> tuple[ClassBoxes, RowArray, RowArray, Float64Array]:
    """Send every prediction to its nearest ground-truth box; the highest score of each box stays (`assign`).

    A prediction in an ignore region that is not near any box is left out first, so that it takes no box's place.

    Returns:
        The class without those predictions, and of each assigned pair the prediction row, the ground-truth row and
        the distance in metres; pairs are ordered by prediction. Empty when either side is.
    """
    prediction, ground_truth, apart = near_pairs(boxes, space_distance, np.inf)
    nearest = np.full(len(boxes.score), np.inf)
    np.minimum.at(nearest, prediction, apart)
    kept = ~boxes.excused | (nearest < max_m)
    wanted = kept[prediction]
    row = np.cumsum(kept) - 1
    prediction, ground_truth, apart = row[prediction[wanted]], ground_truth[wanted], apart[wanted]
    order = np.lexsort((ground_truth, apart, prediction))
    _, first = np.unique(prediction[order], return_index=True)  # each prediction's nearest box
    own = order[first]
    _, winner = np.unique(ground_truth[own], return_index=True)  # each box's highest score
    chosen = own[np.sort(winner)]
    return boxes.take_predictions(kept), prediction[chosen], ground_truth[chosen], apart[chosen]


def average_precision(matched: RowArray, excused: BoolArray, ground_truth_count: int) -> float | None:
    """Return the mean of the precision envelope read at 101 recalls (`compute_average_precision`).

    In [0, 1], greater is better; None without ground truth, 0 without predictions.
    """
    if not ground_truth_count:
        return None
    found = np.zeros(len(excused), dtype=bool)
    found[matched] = True
    found = found[found | ~excused]
    if not len(found):
        return 0.0
    right = np.cumsum(found)
    precision = right / np.arange(1, len(right) + 1)
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    return float(np.interp(_RECALL, right / ground_truth_count, envelope, right=0).mean())
