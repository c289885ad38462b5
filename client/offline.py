"""Evaluation of files on this machine: read both sides, score, and say what was found in the predictions."""

import hashlib
from pathlib import Path

from client.report_text import report_text
from evaluator.evaluation import evaluate
from evaluator.ground_truth import read_ground_truth
from evaluator.intake import read_predictions_leniently
from evaluator.matching import evaluated_labels
from evaluator.parallel import evaluate_file, two_processes_help
from evaluator.protocol import Protocol
from evaluator.results import Scores


def evaluate_offline(
    ground_truth_source: Path, predictions_source: Path, protocol: Protocol, *, lenient: bool
) -> tuple[Scores | None, str]:
    """Evaluate a folder or zip of predictions.

    Args:
        ground_truth_source: Folder or zip.
        predictions_source: Folder or zip.
        protocol: The rules.
        lenient: Take what the reference takes.

    Returns:
        The scores, None when the predictions have errors; and the report as text, "" when there is nothing to say.

    Raises:
        GroundTruthError: The ground truth cannot be used.
    """
    ground_truth = read_ground_truth(ground_truth_source)
    digest = hashlib.sha256(ground_truth.to_bytes()).hexdigest()
    if not lenient:
        result = evaluate_file(
            predictions_source, ground_truth, protocol, ground_truth_sha256=digest, split=two_processes_help()
        )
        return result.scores, report_text(result.report)
    intake = read_predictions_leniently(
        predictions_source, images=ground_truth.image_list(), labels=evaluated_labels(protocol)
    )
    notes = report_text(intake.report)
    if intake.predictions is None:
        return None, notes
    evaluation = evaluate(
        ground_truth, intake.predictions, protocol, ground_truth_sha256=digest, predictions_sha256=intake.sha256
    )
    return evaluation.scores, notes
