"""The convention doctor: recognises the mistakes that really happen, from predictions and cameras alone.

Each costs most of the score, and the reference scores it without a word. It only ever warns, with its confidence.
"""

from collections.abc import Set as AbstractSet

import numpy as np

from evaluator.codes import Code
from evaluator.doctor.evidence import FEWEST_BOXES, Cameras, Evidence, gather_evidence
from evaluator.doctor.image import check_image
from evaluator.doctor.space import check_space
from evaluator.doctor.values import check_labels, check_scores
from evaluator.findings import Findings
from evaluator.predictions import Float64Array, Predictions

__all__ = ["Evidence", "conclude", "examine", "gather_evidence"]


def examine(
    predictions: Predictions, *, images: Cameras | None, known_labels: AbstractSet[str], findings: Findings
) -> None:
    """Look for mistakes and add a warning for each.

    Args:
        predictions: all boxes that could be read, of a submission with errors, too; any values.
        images: the cameras; without them only what needs no camera is recognised.
        known_labels: the data set's classes.
        findings: what reading found; receives the warnings.
    """
    numbers = [found.removeprefix("the number ") for found in findings.found(Code.WRONG_TYPE, pointer_end="/label")]
    check_labels([*findings.found(Code.UNKNOWN_LABEL), *numbers], known_labels, findings)
    conclude(predictions.score, gather_evidence(predictions, images), findings)


@np.errstate(all="ignore")
def conclude(score: Float64Array, evidence: Evidence, findings: Findings) -> None:
    """Look for mistakes in numbers and add a warning for each.

    Args:
        score: (N,) of all boxes that could be read.
        evidence: a sample of them.
        findings: receives the warnings.
    """
    check_scores(score, findings)
    if len(evidence) >= FEWEST_BOXES:
        check_image(evidence, findings, explained=check_space(evidence, findings))
