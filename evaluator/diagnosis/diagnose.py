"""Everything that can be told about one evaluation: `diagnose`."""

import msgspec

from evaluator.diagnosis.annotator_noise import ANNOTATOR_NOISE, AnnotatorNoise
from evaluator.diagnosis.calibration import Calibration, calibrate
from evaluator.diagnosis.causes import Causes, causes
from evaluator.diagnosis.errors import (
    ErrorCurves,
    ErrorSummary,
    PairErrors,
    error_curves,
    pair_errors,
    summarize_errors,
)
from evaluator.diagnosis.loss import Parts, loss
from evaluator.diagnosis.nearest import nearest
from evaluator.diagnosis.oracles import Oracle, oracles
from evaluator.diagnosis.subsets import Grouping, Membership, group, memberships
from evaluator.diagnosis.working_point import WorkingPoint, at_working_point
from evaluator.errors import UsageError
from evaluator.evaluation import Evaluation
from evaluator.protocol import PAPER, Protocol, Signature


class Accuracy(msgspec.Struct, frozen=True, kw_only=True):
    """How well the objects found are measured, and which objects are found."""

    errors: ErrorSummary
    """Of all true positives."""
    curves: ErrorCurves
    groupings: tuple[Grouping, ...]


class ClassDiagnosis(msgspec.Struct, frozen=True, kw_only=True):
    """One class; everything is None without ground truth."""

    label: str
    accuracy: Accuracy | None
    causes: Causes | None
    loss: Parts | None
    """What is missing from the detection score to 1, split exactly."""
    calibration: Calibration | None


class Diagnosis(msgspec.Struct, frozen=True, kw_only=True):
    """Why a submission scores what it scores. Nothing in it ranks."""

    signature: Signature
    accuracy: Accuracy
    """Over all evaluated classes together."""
    classes: tuple[ClassDiagnosis, ...]
    """In the protocol's order."""
    oracles: tuple[Oracle, ...]
    annotator_noise: tuple[AnnotatorNoise, ...]
    """To read `up_to_distance` against."""


def diagnose(evaluation: Evaluation) -> Diagnosis:
    """Explain an evaluation.

    Every value can be written as JSON; what is undefined is None.

    Raises:
        UsageError: The protocol is `paper`, whose thresholds are all scores.
    """
    if evaluation.scores.signature.protocol.name == PAPER.name:
        raise UsageError("Only evaluations by the protocol cityscapes3d can be diagnosed; evaluate by that one.")
    point = at_working_point(evaluation)
    errors = pair_errors(evaluation, point)
    groups = memberships(evaluation.ground_truth)
    sorted_causes = causes(evaluation, point, nearest(evaluation))
    protocol = evaluation.scores.signature.protocol
    return Diagnosis(
        signature=evaluation.scores.signature,
        accuracy=_accuracy(point, errors, groups, protocol, None),
        classes=tuple(
            _class_diagnosis(
                evaluation, point, index, _accuracy(point, errors, groups, protocol, index), sorted_causes[index]
            )
            for index in range(len(point.labels))
        ),
        oracles=oracles(evaluation),
        annotator_noise=ANNOTATOR_NOISE,
    )


def _class_diagnosis(
    evaluation: Evaluation, point: WorkingPoint, index: int, accuracy: Accuracy, sorted_causes: Causes
) -> ClassDiagnosis:
    """Put one class together, or leave it undefined."""
    score = evaluation.scores.classes[index]
    if not score.ground_truth_count:
        return ClassDiagnosis(label=score.label, accuracy=None, causes=None, loss=None, calibration=None)
    return ClassDiagnosis(
        label=score.label,
        accuracy=accuracy,
        causes=sorted_causes,
        loss=loss(score),
        calibration=calibrate(evaluation, point, index),
    )


def _accuracy(
    point: WorkingPoint, errors: PairErrors, groups: tuple[Membership, ...], protocol: Protocol, index: int | None
) -> Accuracy:
    """Measure one class, or all together for None."""
    own = errors.of_class(index)
    edges_m = (*protocol.depth_bins_m, protocol.max_depth_m)
    return Accuracy(
        errors=summarize_errors(own),
        curves=error_curves(own, edges_m),
        groupings=tuple(group(membership, point, errors, index) for membership in groups),
    )
