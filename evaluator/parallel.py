"""Evaluation of a submission's file with the work split by image over two processes.

Both halves are read and matched at the same time; their statistics are joined, bit for bit what one process gives, and
the doctor sees the boxes of both. Where a file of either half has something to be said about, everything is read once
more in one piece, so that there is one report and one place that writes it.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from evaluator.archive import digest, open_source
from evaluator.decoding import garbage_collection_paused
from evaluator.doctor import Evidence, conclude, gather_evidence
from evaluator.evaluation import evaluate, match_by_protocol, score_by_protocol, signature_of
from evaluator.findings import Findings
from evaluator.ground_truth import GroundTruth
from evaluator.intake import read_predictions
from evaluator.limits import DEFAULT_LIMITS
from evaluator.matching import evaluated_labels
from evaluator.predictions import Float64Array, Predictions
from evaluator.protocol import Protocol
from evaluator.report import ProblemGroup, Report
from evaluator.results import Scores
from evaluator.statistics import Statistics, collect, join
from evaluator.strict import StrictReading

_T = TypeVar("_T")

FEWEST_IMAGES = 200
"""With fewer a second process costs about what it saves."""

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
    score: Float64Array
    """(N,) of its boxes."""
    label_counts: NDArray[np.int64]
    """(L,) boxes of each known class."""


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
        split: Use two processes where it pays: from `FEWEST_IMAGES` on, if the system can fork.

    Returns:
        Scores and statistics, or the report on why there are none.
    """
    if split and len(ground_truth.images) >= FEWEST_IMAGES and "fork" in get_all_start_methods():
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
        with _forked(reading, findings, ground_truth, protocol, slice(middle, None)) as other:
            own = _evaluate_half(reading, findings, ground_truth, protocol, slice(0, middle))
            sha256 = digest(source)
            second = other.receive(_Half)
            if own is None or second is None:
                return None
            first, predictions = own
            other.send(len(predictions))
            # The other process has a sample to take, and takes its time to end; meanwhile there is enough to do here.
            statistics = join([first.statistics, second.statistics])
            scores = score_by_protocol(statistics, signature_of(protocol, ground_truth_sha256, sha256))
            evidence = gather_evidence(predictions, ground_truth, after=len(second.score)), other.receive(Evidence)
            if evidence[1] is None:
                return None
            reading.label_counts = first.label_counts + second.label_counts
            reading.note_unevaluated_labels()
            score = np.concatenate([first.score, second.score])
            conclude(score, Evidence.joined(evidence[0], evidence[1]), findings)
            images = len(ground_truth.images)
            report = findings.report(images_expected=images, images_found=images, boxes=len(score))
            return FileEvaluation(scores=scores, statistics=statistics, report=report, predictions_sha256=sha256)


def _evaluate_half(
    reading: StrictReading, findings: Findings, ground_truth: GroundTruth, protocol: Protocol, part: slice
) -> tuple[_Half, Predictions] | None:
    """Read and match the images of one part; None when there is anything to say about its files.

    The predictions are of all images, but hold the boxes of the part only.
    """
    before = _groups(findings)
    reading.assigned = reading.assigned[part]
    predictions = reading.read(None)
    if _groups(findings) != before:
        return None
    truth, own = ground_truth_of(ground_truth, part), predictions_of(predictions, part)
    statistics = collect(truth, own, match_by_protocol(truth, own, protocol), protocol)
    return _Half(statistics, predictions.score, reading.label_counts), predictions


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


class _Other:
    """The other process; it may die at any moment."""

    def __init__(self, connection: Connection) -> None:
        """Take this end of the line."""
        self._connection = connection

    def send(self, boxes_before: int) -> None:
        """Tell how many boxes come before those of the other half, which it answers with its evidence."""
        with suppress(OSError):
            self._connection.send(boxes_before)

    def receive(self, kind: type[_T]) -> _T | None:
        """Wait for what it sends; None also when it died."""
        try:
            result = self._connection.recv()
        except (EOFError, OSError):
            return None
        return result if isinstance(result, kind) else None


@contextmanager
def _forked(
    reading: StrictReading, findings: Findings, ground_truth: GroundTruth, protocol: Protocol, part: slice
) -> Iterator[_Other]:
    """Evaluate a part in a forked process, which shares the open archive and the ground truth."""
    context = get_context("fork")
    here, there = context.Pipe()

    def work() -> None:
        done = _evaluate_half(reading, findings, ground_truth, protocol, part)
        if done is None:
            there.send(None)
            return
        half, predictions = done
        there.send(half)
        there.send(gather_evidence(predictions, ground_truth, before=there.recv()))

    process = context.Process(target=work, daemon=True)
    process.start()
    there.close()
    try:
        yield _Other(here)
    finally:
        here.close()
        process.kill()
        process.join()
