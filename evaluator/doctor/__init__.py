"""The convention doctor: recognises the mistakes that really happen, from predictions and cameras alone.

Each costs most of the score, and the reference scores it without a word. It only ever warns, with its confidence.
"""

from collections.abc import Set as AbstractSet

import numpy as np

from evaluator.codes import Code
from evaluator.doctor.evidence import FEWEST_BOXES, Cameras, gather_evidence
from evaluator.doctor.image import check_image
from evaluator.doctor.space import check_space
from evaluator.doctor.values import check_labels, check_scores
from evaluator.findings import Findings
from evaluator.predictions import Predictions

__all__ = ["examine"]


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
    with np.errstate(all="ignore"):
        check_scores(predictions.score, findings)
        evidence = gather_evidence(predictions, images)
        if len(evidence) >= FEWEST_BOXES:
            check_image(evidence, findings, explained=check_space(evidence, findings))
