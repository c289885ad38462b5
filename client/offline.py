"""Evaluation of files on this machine: read both sides, score, and say what was found in the predictions."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from client.report_text import report_text
from evaluator.errors import UsageError
from evaluator.evaluation import Evaluation, evaluate
from evaluator.ground_truth import GroundTruth, read_ground_truth
from evaluator.intake import read_predictions, read_predictions_leniently
from evaluator.matching import evaluated_labels
from evaluator.parallel import FileEvaluation, evaluate_file, two_processes_help
from evaluator.protocol import EVALUATED_LABELS, Protocol
from evaluator.statistics import Statistics


def evaluate_offline(
    ground_truth_source: Path, predictions_source: Path, protocol: Protocol, *, lenient: bool
) -> FileEvaluation:
    """Evaluate a folder or zip of predictions as fast as it goes.

    Args:
        ground_truth_source: Folder or zip.
        predictions_source: Folder or zip.
        protocol: The rules.
        lenient: Take what the reference takes.

    Returns:
        Scores and statistics, None when the predictions have errors; and the report.

    Raises:
        UsageError: A path does not exist.
        GroundTruthError: The ground truth cannot be used.
    """
    ground_truth, digest = _read_ground_truth(ground_truth_source, [predictions_source])
    if not lenient:
        return evaluate_file(
            predictions_source, ground_truth, protocol, ground_truth_sha256=digest, split=two_processes_help()
        )
    intake = read_predictions_leniently(
        predictions_source, images=ground_truth.image_list(), labels=evaluated_labels(protocol)
    )
    result = FileEvaluation(scores=None, statistics=None, report=intake.report, predictions_sha256=intake.sha256)
    if intake.predictions is None:
        return result
    evaluation = evaluate(
        ground_truth, intake.predictions, protocol, ground_truth_sha256=digest, predictions_sha256=intake.sha256
    )
    return replace(result, scores=evaluation.scores, statistics=evaluation.statistics)


def evaluate_fully(
    sources: Sequence[Path], ground_truth_source: Path, protocol: Protocol, *, lenient: bool
) -> list[Evaluation] | None:
    """Evaluate folders or zips of predictions with everything kept that a diagnosis needs: boxes and matches, too.

    Reports are printed to stderr.

    Args:
        sources: Of predictions.
        ground_truth_source: Folder or zip.
        protocol: The rules.
        lenient: Take what the reference takes.

    Returns:
        One evaluation for each source; None when any of them has errors.

    Raises:
        UsageError: A path does not exist.
        GroundTruthError: The ground truth cannot be used.
    """
    ground_truth, digest = _read_ground_truth(ground_truth_source, sources)
    evaluations = [_evaluate(source, ground_truth, digest, protocol, lenient=lenient) for source in sources]
    complete = [evaluation for evaluation in evaluations if evaluation is not None]
    for evaluation in complete if protocol.labels != EVALUATED_LABELS else ():
        note_unknown_labels(evaluation.statistics)
    return complete if len(complete) == len(sources) else None


def _read_ground_truth(source: Path, predictions: Sequence[Path]) -> tuple[GroundTruth, str]:
    """Read the ground truth and its digest, once all paths are known to be there."""
    for path in (source, *predictions):
        if not path.exists():
            raise UsageError(f"{path} does not exist; give a folder or a zip file.")
    ground_truth = read_ground_truth(source)
    return ground_truth, ground_truth.sha256()


def note_unknown_labels(statistics: Statistics) -> None:
    """Say on stderr which evaluated labels neither the ground truth has nor any prediction that counts."""
    cells = np.concatenate([statistics.ground_truth_cell, statistics.false_positive_cell])
    found = set((cells // statistics.grid[1]).tolist())
    for index, label in enumerate(statistics.labels):
        if index not in found:
            where = "in the ground truth, nor in the predictions outside ignore regions,"
            print(f"note: no box {where} has the label {label!r}.", file=sys.stderr)


def _evaluate(
    source: Path, ground_truth: GroundTruth, digest: str, protocol: Protocol, *, lenient: bool
) -> Evaluation | None:
    """Read and evaluate one source; print its report."""
    read = read_predictions_leniently if lenient else read_predictions
    intake = read(source, images=ground_truth.image_list(), labels=evaluated_labels(protocol))
    if notes := report_text(intake.report):
        print(f"{source}\n{notes}", file=sys.stderr)
    if intake.predictions is None:
        return None
    return evaluate(
        ground_truth, intake.predictions, protocol, ground_truth_sha256=digest, predictions_sha256=intake.sha256
    )
