"""Evaluation of files with everything kept that a diagnosis needs: boxes, matches, statistics."""

import hashlib
import sys
from pathlib import Path

from client.report_text import report_text
from evaluator.errors import UsageError
from evaluator.evaluation import Evaluation, evaluate
from evaluator.ground_truth import GroundTruth, read_ground_truth
from evaluator.intake import read_predictions, read_predictions_leniently


def evaluate_fully(sources: list[Path], ground_truth_source: Path, *, lenient: bool) -> list[Evaluation] | None:
    """Evaluate several folders or zips of predictions against one ground truth.

    Reports are printed to stderr.

    Returns:
        One evaluation for each source; None when any of them has errors.

    Raises:
        UsageError: A path does not exist.
        GroundTruthError: The ground truth cannot be used.
    """
    for path in (ground_truth_source, *sources):
        if not path.exists():
            raise UsageError(f"{path} does not exist; give a folder or a zip file.")
    ground_truth = read_ground_truth(ground_truth_source)
    digest = hashlib.sha256(ground_truth.to_bytes()).hexdigest()
    evaluations = [_evaluate(source, ground_truth, digest, lenient=lenient) for source in sources]
    complete = [evaluation for evaluation in evaluations if evaluation is not None]
    return complete if len(complete) == len(sources) else None


def _evaluate(source: Path, ground_truth: GroundTruth, digest: str, *, lenient: bool) -> Evaluation | None:
    """Read and evaluate one source; print its report."""
    read = read_predictions_leniently if lenient else read_predictions
    intake = read(source, images=ground_truth.image_list())
    if notes := report_text(intake.report):
        print(f"{source}\n{notes}", file=sys.stderr)
    if intake.predictions is None:
        return None
    return evaluate(ground_truth, intake.predictions, ground_truth_sha256=digest, predictions_sha256=intake.sha256)
