"""What the score would be if one thing were perfect: "with perfect yaw: +0.013".

Each oracle changes the outcomes and scores them again by the protocol, working point included. So it tells what the
benchmark would really give, quirks and all: a class with true positives in a single depth bin has similarities of 0 by
the protocol, and stays there with perfect boxes; a class left without ground truth is in no mean.
"""

from collections.abc import Callable
from dataclasses import replace

import msgspec

from evaluator.evaluation import Evaluation, score_by_protocol
from evaluator.matching import class_index
from evaluator.results import ClassScore
from evaluator.statistics import Statistics
from evaluator.true_positive_metrics import SIMILARITIES


class OracleClass(msgspec.Struct, frozen=True, kw_only=True):
    """What an oracle does to one class; None without ground truth, or where the oracle leaves none of it."""

    label: str
    detection_score: float | None
    gain: float | None
    """Minus the detection score as it is."""


class Oracle(msgspec.Struct, frozen=True, kw_only=True):
    """What the score would be with one thing perfect."""

    name: str
    mds: float | None
    """Mean over the classes that have ground truth left; None when none has."""
    gain: float | None
    """Mean of the gains of these classes. Where the oracle leaves a class without ground truth it is not the difference of
    the two mDS, which would be that of other classes."""
    classes: tuple[OracleClass, ...]


def oracles(evaluation: Evaluation) -> tuple[Oracle, ...]:
    """Run every oracle."""
    return tuple(_run(name, change, evaluation) for name, change in ORACLES.items())


def _run(name: str, change: Callable[[Evaluation], Statistics], evaluation: Evaluation) -> Oracle:
    """Change the outcomes, score them, and compare with the scores as they are."""
    before = evaluation.scores
    after = score_by_protocol(change(evaluation))
    classes = tuple(_of_class(*pair) for pair in zip(before.classes, after.classes, strict=True))
    gains = [one.gain for one in classes if one.gain is not None]
    return Oracle(name=name, mds=after.mds, gain=sum(gains) / len(gains) if gains else None, classes=classes)


def _of_class(before: ClassScore, after: ClassScore) -> OracleClass:
    """Compare one class."""
    return OracleClass(
        label=before.label,
        detection_score=after.detection_score,
        gain=_gain(before.detection_score, after.detection_score),
    )


def _gain(before: float | None, after: float | None) -> float | None:
    """Return the difference if both are defined."""
    return None if before is None or after is None else after - before


def with_perfect(*names: str) -> Callable[[Evaluation], Statistics]:
    """Return a change that gives every true positive the similarity 1 in the named columns."""

    def change(evaluation: Evaluation) -> Statistics:
        similarities = evaluation.statistics.pair_similarities.copy()
        similarities[:, [SIMILARITIES.index(name) for name in names]] = 1.0
        return replace(evaluation.statistics, pair_similarities=similarities)

    return change


def without_false_positives(evaluation: Evaluation) -> Statistics:
    """Take all false positives away."""
    statistics = evaluation.statistics
    return replace(
        statistics,
        false_positive_image=statistics.false_positive_image[:0],
        false_positive_cell=statistics.false_positive_cell[:0],
        false_positive_masks=statistics.false_positive_masks[:0],
        false_positive_score=statistics.false_positive_score[:0],
    )


def without_misses(evaluation: Evaluation) -> Statistics:
    """Take away the ground-truth boxes that no score threshold finds."""
    statistics, matches = evaluation.statistics, evaluation.matches
    evaluated = class_index(evaluation.ground_truth.labels, evaluation.ground_truth.label_index, statistics.protocol)
    found = matches.matched_thresholds[evaluated >= 0] > 0
    return replace(
        statistics,
        ground_truth_image=statistics.ground_truth_image[found],
        ground_truth_cell=statistics.ground_truth_cell[found],
    )


def with_perfect_detection(evaluation: Evaluation) -> Statistics:
    """Take away all false positives and the boxes that no threshold finds."""
    return without_misses(replace(evaluation, statistics=without_false_positives(evaluation)))


ORACLES: dict[str, Callable[[Evaluation], Statistics]] = {
    "perfect_position": with_perfect("bevcd"),
    "perfect_yaw": with_perfect("yaw_sim"),
    "perfect_pitch_roll": with_perfect("pr_sim"),
    "perfect_size": with_perfect("size_sim"),
    "perfect_boxes": with_perfect(*SIMILARITIES),
    "no_false_positives": without_false_positives,
    "no_misses": without_misses,
    "perfect_detection": with_perfect_detection,
}
"""Every oracle by name. A gain may be negative: the working point moves with the curve."""
