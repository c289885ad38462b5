"""The integrity audit: what raises a score without better detection, or lowers it by accident.

Kept with the score and shown to its owner and the maintainers; it uses ground truth, so it is never shown to others.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import msgspec
import numpy as np

from evaluator.evaluation import Evaluation, match_by_protocol, score_by_protocol, signature_of
from evaluator.fingerprint import fingerprint
from evaluator.ground_truth import GroundTruth
from evaluator.predictions import Float64Array, Predictions
from evaluator.projection import projected_corners_px
from evaluator.protocol import Protocol
from evaluator.results import Scores
from evaluator.statistics import Statistics, collect
from evaluator.thresholds import share_below_lowest_threshold
from evaluator.true_positive_metrics import SIMILARITIES

MODAL_GAP_LIMIT = 0.01
"""mDS: honest modal boxes change far less, and placing all of them in an ignore region gains five times as much."""
PLAUSIBLE_BOXES_PER_IMAGE = 300
"""The ground truth has 52 in its fullest image; detectors rarely keep more than 300."""
DUPLICATE_SHARE_LIMIT = 0.2
SIMILARITY_LIMIT = 0.5
"""Of two fingerprints; above it the submissions are nearly identical."""
_QUARTER_CIRCLE = 0.5
"""The yaw similarity of two headings at a right angle."""


Variant = Literal["official", "projected_modal", "amodal", "evenly_spread"]
Variants = Mapping[Variant, Statistics]
"""Statistics of what is compared, of all images or of some; those of disjoint parts can be joined.

`official` is the score itself. `projected_modal` tests ignore regions with the projected box instead of the submitted
modal one. `amodal` is the score without the protocol's `modal`; it is left out where that changes nothing.
`evenly_spread` has the same ranking of boxes, but scores spread evenly over (0, 1].
"""


class ScoreResolution(msgspec.Struct, frozen=True, kw_only=True):
    """How well one class's scores can be told apart by 51 fixed thresholds."""

    label: str
    boxes: int
    distinct_scores: int
    share_below_lowest_threshold: float | None
    """In [0, 1], None without boxes; these all act like score 0."""
    ap: float | None
    ap_evenly_spread: float | None
    """The AP with the same ranking, but scores spread evenly over (0, 1]: a loss here is a loss of resolution."""


class IntegrityAudit(msgspec.Struct, frozen=True, kw_only=True):
    """The findings on one score."""

    mds: float | None
    mds_with_projected_modal: float | None
    """The mDS when ignore regions are tested with the projected box instead of the submitted modal one."""
    modal_gap: float | None
    """The first less the second: what the submitted modal boxes gain."""
    held: bool
    """True when a maintainer should look before the score ranks."""
    reasons: tuple[str, ...]
    """Why it is held, one sentence each."""
    score_resolution: tuple[ScoreResolution, ...]
    duplicate_boxes: int
    """Boxes equal to an earlier one of the same image and class in all of centre, dimensions and rotation."""
    most_boxes_in_image: int
    images_with_many_boxes: int
    """Images with more boxes than `PLAUSIBLE_BOXES_PER_IMAGE`."""
    share_facing_backwards: float | None = None
    """Of the matched boxes those whose yaw is off by more than a quarter circle, in [0, 1]; None without matches.

    Without ground truth a yaw that is off by half a circle everywhere can hardly be told (`evaluator/doctor/`).
    """
    fingerprint: str
    """See `evaluator/fingerprint.py`."""


def audit(evaluation: Evaluation) -> IntegrityAudit:
    """Audit a score; evaluates the same predictions twice more.

    Args:
        evaluation: the official result, with its predictions and ground truth.
    """
    predictions = evaluation.predictions
    spread = evenly_spread(predictions)
    variants = collect_variants(evaluation.ground_truth, predictions, evaluation.statistics, spread)
    return audit_variants(variants, predictions, evaluation.scores)


def collect_variants(
    ground_truth: GroundTruth, predictions: Predictions, official: Statistics, spread_scores: Float64Array
) -> Variants:
    """Evaluate what the audit compares with the official statistics.

    Args:
        ground_truth: of all images, or of a part of them.
        predictions: of the same images.
        official: their statistics.
        spread_scores: (N,) what `evenly_spread` gives for these boxes among those of all images.
    """
    protocol = official.protocol
    amodal = msgspec.structs.replace(protocol, modal=False)
    projected = _with_projected_modal(ground_truth, predictions)
    variants: dict[Variant, Statistics] = {
        "official": official,
        "projected_modal": _statistics(ground_truth, projected, amodal),
        "evenly_spread": _statistics(ground_truth, replace(predictions, score=spread_scores), protocol),
    }
    if protocol.modal:
        variants["amodal"] = _statistics(ground_truth, predictions, amodal)
    return variants


def audit_variants(variants: Variants, predictions: Predictions, scores: Scores) -> IntegrityAudit:
    """Audit a score by what `collect_variants` gave.

    Args:
        variants: of all images.
        predictions: of all images.
        scores: the official ones.
    """
    mds = scores.mds
    projected = score_by_protocol(variants["projected_modal"]).mds
    official = score_by_protocol(variants["amodal"]).mds if "amodal" in variants else mds
    gap = None if official is None or projected is None else official - projected
    duplicates = _count_duplicates(predictions)
    per_image = np.bincount(predictions.image_index, minlength=1)
    reasons = _reasons(gap, duplicates, predictions)
    return IntegrityAudit(
        mds=mds,
        mds_with_projected_modal=projected,
        modal_gap=gap,
        held=bool(reasons),
        reasons=reasons,
        score_resolution=_score_resolution(predictions, scores, score_by_protocol(variants["evenly_spread"])),
        duplicate_boxes=duplicates,
        most_boxes_in_image=int(per_image.max()),
        images_with_many_boxes=int((per_image > PLAUSIBLE_BOXES_PER_IMAGE).sum()),
        share_facing_backwards=_share_facing_backwards(variants["official"]),
        fingerprint=fingerprint(predictions),
    )


def _statistics(ground_truth: GroundTruth, predictions: Predictions, protocol: Protocol) -> Statistics:
    """Evaluate other predictions, or by other rules."""
    return collect(
        ground_truth, predictions, match_by_protocol(ground_truth, predictions, protocol), signature_of(protocol)
    )


def _with_projected_modal(ground_truth: GroundTruth, predictions: Predictions) -> Predictions:
    """Replace the submitted modal boxes, with which the reference tests ignore regions, by the projected ones."""
    corners = projected_corners_px(
        predictions.center_m,
        predictions.dimensions_m,
        predictions.rotation,
        intrinsics_px=ground_truth.intrinsics_px,
        sensor_from_vehicle=ground_truth.sensor_from_vehicle,
        camera_index=predictions.image_index,
    )
    modal_px = np.concatenate([corners[:2], corners[2:] - corners[:2]]).T
    return replace(predictions, modal_px=np.ascontiguousarray(modal_px))


def _score_resolution(predictions: Predictions, scores: Scores, respread: Scores) -> tuple[ScoreResolution, ...]:
    """Look at each class's scores, and at its AP with the same ranking spread evenly."""
    resolutions = []
    for official, evenly in zip(scores.classes, respread.classes, strict=True):
        of_class = predictions.label_index == predictions.labels.index(official.label)
        values = predictions.score[of_class]
        below = share_below_lowest_threshold(values)
        resolutions.append(
            ScoreResolution(
                label=official.label,
                boxes=len(values),
                distinct_scores=len(np.unique(values)),
                share_below_lowest_threshold=below,
                ap=official.ap,
                ap_evenly_spread=evenly.ap,
            )
        )
    return tuple(resolutions)


def evenly_spread(predictions: Predictions) -> Float64Array:
    """Replace each score by its rank within the class over the number of distinct ones, in (0, 1]; ties stay ties."""
    spread = np.zeros(len(predictions))
    for number in range(len(predictions.labels)):
        of_class = predictions.label_index == number
        values, rank = np.unique(predictions.score[of_class], return_inverse=True)
        spread[of_class] = (rank + 1) / max(1, len(values))
    return spread


def _share_facing_backwards(statistics: Statistics) -> float | None:
    """Count matched boxes that face away from what they match."""
    yaw_similarity = statistics.pair_similarities[:, SIMILARITIES.index("yaw_sim")]
    return float(np.mean(yaw_similarity < _QUARTER_CIRCLE)) if len(yaw_similarity) else None


def _count_duplicates(predictions: Predictions) -> int:
    """Count boxes that repeat an earlier one; none without boxes."""
    if not len(predictions):
        return 0
    # Comparing whole rows is slow; a box whose first coordinate is unlike all others repeats none.
    order = np.argsort(predictions.center_m[:, 0], kind="stable")
    first_m = predictions.center_m[order, 0]
    equal_to_next = first_m[1:] == first_m[:-1]
    in_question = order[np.concatenate([equal_to_next, [False]]) | np.concatenate([[False], equal_to_next])]
    table = np.concatenate(
        [
            predictions.image_index[in_question, None],
            predictions.label_index[in_question, None],
            predictions.center_m[in_question],
            predictions.dimensions_m[in_question],
            predictions.rotation[in_question],
        ],
        axis=1,
    )
    return len(table) - len(np.unique(table, axis=0))


def _reasons(gap: float | None, duplicates: int, predictions: Predictions) -> tuple[str, ...]:
    """Say why a maintainer should look."""
    reasons = []
    if gap is not None and gap > MODAL_GAP_LIMIT:
        reasons.append(f"The submitted modal boxes raise the mDS by {gap:.4f} through ignore regions.")
    if duplicates > DUPLICATE_SHARE_LIMIT * len(predictions):
        reasons.append(f"{duplicates} of {len(predictions)} boxes repeat another one.")
    return tuple(reasons)
