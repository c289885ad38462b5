"""Evaluation of a submission's file with the work split by image over two processes.

Both halves are read and matched at the same time; their statistics are joined, bit for bit what one process gives.
Only clean submissions go this way to the end: whatever has errors, or looks like a mistake in either half, is read
once more in one piece, so that there is one report and one place that writes it.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection
from pathlib import Path

import msgspec
import numpy as np

from evaluator.archive import digest, open_source
from evaluator.codes import Code
from evaluator.decoding import garbage_collection_paused
from evaluator.doctor import examine
from evaluator.evaluation import evaluate, match_by_protocol, score_by_protocol, signature_of
from evaluator.findings import Findings
from evaluator.ground_truth import GroundTruth
from evaluator.intake import read_predictions
from evaluator.limits import DEFAULT_LIMITS
from evaluator.matching import evaluated_labels
from evaluator.predictions import Predictions
from evaluator.protocol import Protocol
from evaluator.report import ProblemGroup, Report
from evaluator.results import Scores
from evaluator.statistics import Statistics, collect, join
from evaluator.strict import StrictReading

_FEWEST_BOXES = 400
"""In all; with fewer, half of them may be too few to recognise a mistake by, and one process is as fast."""

_OWN_SHARE = 0.48
"""Of the images for the process that also computes the digest, so that both are done at the same time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FileEvaluation:
    """The result of one file or folder."""

    scores: Scores | None
    """None when the report has errors."""
    statistics: Statistics | None
    report: Report
    predictions_sha256: str


@dataclass(frozen=True, slots=True)
class _Half:
    """What one process found on its images."""

    statistics: Statistics
    boxes: int
    left_out: ProblemGroup | None
    """The note on boxes of classes that are not evaluated; anything else ends this way of evaluating."""


def two_processes_help() -> bool:
    """Tell whether this machine has a second processor and can fork."""
    return len(os.sched_getaffinity(0)) > 1 if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1) > 1


def evaluate_file(
    source: Path, ground_truth: GroundTruth, protocol: Protocol, *, ground_truth_sha256: str = "", split: bool
) -> FileEvaluation:
    """Read a submission strictly and evaluate it.

    Args:
        source: Path of a zip or a folder.
        ground_truth: What to evaluate against.
        protocol: The rules.
        ground_truth_sha256: For the signature.
        split: Use two processes, where the system can fork.

    Returns:
        Scores and statistics, or the report on why there are none.
    """
    if split and "fork" in get_all_start_methods():
        evaluation = _evaluate_in_halves(source, ground_truth, protocol, ground_truth_sha256)
        if evaluation is not None:
            return evaluation
    intake = read_predictions(source, images=ground_truth, labels=evaluated_labels(protocol))
    if intake.predictions is None:
        return FileEvaluation(scores=None, statistics=None, report=intake.report, predictions_sha256=intake.sha256)
    result = evaluate(
        ground_truth,
        intake.predictions,
        protocol,
        ground_truth_sha256=ground_truth_sha256,
        predictions_sha256=intake.sha256,
    )
    return FileEvaluation(
        scores=result.scores, statistics=result.statistics, report=intake.report, predictions_sha256=intake.sha256
    )


def _evaluate_in_halves(
    source: Path, ground_truth: GroundTruth, protocol: Protocol, ground_truth_sha256: str
) -> FileEvaluation | None:
    """Evaluate with a second process; None when the submission is not clean."""
    findings = Findings()
    with garbage_collection_paused(), open_source(source, DEFAULT_LIMITS, findings) as files:
        if files is None:
            return None
        reading = StrictReading(files, ground_truth.images, evaluated_labels(protocol), DEFAULT_LIMITS, findings)
        if findings.error_count:
            return None
        middle = int(len(ground_truth.images) * _OWN_SHARE)
        with _forked(reading, findings, ground_truth, protocol, slice(middle, None)) as answer:
            first = _evaluate_half(reading, findings, ground_truth, protocol, slice(0, middle))
            sha256 = digest(source)
            second = answer.receive()
            if first is None or second is None or first.boxes + second.boxes < _FEWEST_BOXES:
                return None
            # The other process takes its time to end; meanwhile there is enough to do here.
            statistics = join([first.statistics, second.statistics])
            signature = signature_of(protocol, ground_truth_sha256, sha256)
            return FileEvaluation(
                scores=score_by_protocol(statistics, signature),
                statistics=statistics,
                report=_report(findings, first, second, len(ground_truth.images)),
                predictions_sha256=sha256,
            )


def _evaluate_half(
    reading: StrictReading, findings: Findings, ground_truth: GroundTruth, protocol: Protocol, part: slice
) -> _Half | None:
    """Read and match the images of one part; None when there is anything to report but boxes left out."""
    before = len(_groups(findings))
    reading.assigned = reading.assigned[part]
    predictions = predictions_of(reading.read(None), part)
    truth = ground_truth_of(ground_truth, part)
    examine(predictions, images=truth, known_labels=reading.known_labels, findings=findings)
    found = {group.code: group for group in _groups(findings)}
    left_out = found.pop(Code.UNEVALUATED_LABEL.value, None)
    if len(found) != before or findings.error_count:
        return None
    statistics = collect(truth, predictions, match_by_protocol(truth, predictions, protocol), protocol)
    return _Half(statistics, reading.boxes, left_out)


def _groups(findings: Findings) -> tuple[ProblemGroup, ...]:
    return findings.report(images_expected=0, images_found=0, boxes=0).groups


def predictions_of(predictions: Predictions, part: slice) -> Predictions:
    """Return the predictions of a part of the images, as views."""
    first, stop, _ = part.indices(len(predictions.images))
    rows = slice(*np.searchsorted(predictions.image_index, (first, stop)).tolist())
    of_boxes = ("label_index", "score", "center_m", "dimensions_m", "rotation", "amodal_px", "modal_px")
    return replace(
        predictions,
        images=predictions.images[part],
        image_index=predictions.image_index[rows] - np.int32(first),
        **{name: getattr(predictions, name)[rows] for name in of_boxes},
    )


def ground_truth_of(ground_truth: GroundTruth, part: slice) -> GroundTruth:
    """Return the ground truth of a part of the images, as views."""
    first, stop, _ = part.indices(len(ground_truth.images))
    boxes = slice(*np.searchsorted(ground_truth.image_index, (first, stop)).tolist())
    regions = slice(*np.searchsorted(ground_truth.ignore_image_index, (first, stop)).tolist())
    of_boxes = (
        "label_index", "prototype_index", "center_m", "dimensions_m", "rotation",
        "amodal_px", "modal_px", "occlusion", "truncation",
    )  # fmt: skip
    return replace(
        ground_truth,
        images=ground_truth.images[part],
        intrinsics_px=ground_truth.intrinsics_px[part],
        sensor_from_vehicle=ground_truth.sensor_from_vehicle[part],
        image_index=ground_truth.image_index[boxes] - np.int32(first),
        ignore_image_index=ground_truth.ignore_image_index[regions] - np.int32(first),
        ignore_px=ground_truth.ignore_px[regions],
        **{name: getattr(ground_truth, name)[boxes] for name in of_boxes},
    )


def _report(findings: Findings, first: _Half, second: _Half, images: int) -> Report:
    """Return the report of both halves: that of the first, with what the second left out."""
    if second.left_out is not None:
        for index, problem in enumerate(second.left_out.problems):
            count = 0 if index else second.left_out.count
            findings.add(Code.UNEVALUATED_LABEL, found=problem.found, count=count)
    report = findings.report(images_expected=images, images_found=images, boxes=first.boxes + second.boxes)
    groups = (msgspec.structs.replace(g, problems=tuple(dict.fromkeys(g.problems))) for g in report.groups)
    return msgspec.structs.replace(report, groups=tuple(groups))


class _Answer:
    """Where the other process's result arrives."""

    def __init__(self, connection: Connection) -> None:
        """Take the receiving end."""
        self._connection = connection

    def receive(self) -> _Half | None:
        """Wait for the result; None also when the process died."""
        try:
            result = self._connection.recv()
        except EOFError:
            return None
        return result if isinstance(result, _Half) else None


@contextmanager
def _forked(
    reading: StrictReading, findings: Findings, ground_truth: GroundTruth, protocol: Protocol, part: slice
) -> Iterator[_Answer]:
    """Evaluate a part in a forked process, which shares the open archive and the ground truth."""
    context = get_context("fork")
    receiving, sending = context.Pipe(duplex=False)

    def work() -> None:
        sending.send(_evaluate_half(reading, findings, ground_truth, protocol, part))

    process = context.Process(target=work, daemon=True)
    process.start()
    sending.close()
    try:
        yield _Answer(receiving)
    finally:
        receiving.close()
        process.kill()
        process.join()
