"""Evaluation of submissions' files with the work split by image over two processes.

Both open a file. One reads from the first image on, the other from the last one back, until they meet, so that both are
done at the same time though one processor may be slower; then each matches what it has read. The statistics of both parts
are joined, bit for bit what one process gives, and the doctor sees the boxes of both. Where a file of either part has
something to be said about, everything is read once more in one piece, so that there is one report and one place that
writes it.
"""

import atexit
import os
import signal
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from evaluator.archive import open_source
from evaluator.decoding import garbage_collection_paused
from evaluator.doctor import Evidence, conclude, gather_evidence
from evaluator.errors import UsageError
from evaluator.evaluation import evaluate, match_by_protocol, score_by_protocol, signature_of
from evaluator.findings import Findings
from evaluator.ground_truth import GroundTruth
from evaluator.intake import read_predictions
from evaluator.limits import DEFAULT_LIMITS
from evaluator.matching import evaluated_labels
from evaluator.memory import keep_freed_memory
from evaluator.parts import ground_truth_of, predictions_of
from evaluator.predictions import Float64Array, Predictions
from evaluator.protocol import Protocol, Signature
from evaluator.report import ProblemGroup, Report
from evaluator.results import Scores
from evaluator.statistics import Statistics, collect, join
from evaluator.strict import StrictReading
from evaluator.turns import Turns

_T = TypeVar("_T")

FEWEST_IMAGES = 200
"""With fewer a second process costs about what it saves."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FileEvaluation:
    """The result of one file or folder."""

    scores: Scores | None
    """None when the report has errors."""
    statistics: Statistics | None
    report: Report
    predictions_sha256: str


def two_processes_help() -> bool:
    """Tell whether this machine has a second processor."""
    return len(os.sched_getaffinity(0)) > 1 if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1) > 1


def evaluate_file(
    source: Path, ground_truth: GroundTruth, protocol: Protocol, *, ground_truth_sha256: str = "", split: bool
) -> FileEvaluation:
    """Read a submission strictly and evaluate it. Freed memory stays with the process (evaluator/memory.py).

    Args:
        source: Path of a zip or a folder, which must not change meanwhile.
        ground_truth: What to evaluate against.
        protocol: The rules.
        ground_truth_sha256: For the signature.
        split: Use two processes where it pays: from `FEWEST_IMAGES` on, if the system can fork. For many files on one
            ground truth `TwoProcesses` is faster.

    Returns:
        Scores and statistics, or the report on why there are none.
    """
    if split:
        with TwoProcesses(ground_truth, protocol, ground_truth_sha256=ground_truth_sha256) as both:
            return both.evaluate(source)
    keep_freed_memory()
    return _evaluate_in_one(source, ground_truth, protocol, ground_truth_sha256)


def _evaluate_in_one(
    source: Path, ground_truth: GroundTruth, protocol: Protocol, ground_truth_sha256: str
) -> FileEvaluation:
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


class TwoProcesses:
    """Evaluates files on one ground truth, part of the images here and part in a second process, which is kept.

    Kept, because a process that has just been forked asks the system for every page of memory it touches. With few
    images, where no second process can be started, and once it has died, everything is done here. For one thread.
    """

    def __init__(self, ground_truth: GroundTruth, protocol: Protocol, *, ground_truth_sha256: str = "") -> None:
        """Start the second process; leave the `with` block or call `close` to end it.

        From then on freed memory stays with both processes (evaluator/memory.py).
        """
        keep_freed_memory()
        self._ground_truth, self._protocol = ground_truth, protocol
        self._ground_truth_sha256 = ground_truth_sha256
        pays = len(ground_truth.images) >= FEWEST_IMAGES and "fork" in get_all_start_methods()
        self._other: _Other | None = None
        if pays:
            with suppress(OSError):  # no process or no memory to be had
                self._other = _Other(ground_truth, protocol)

    @property
    def is_split(self) -> bool:
        """Tell whether there is a second process."""
        return self._other is not None

    def __enter__(self) -> Self:
        """Use it in a `with` block."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the second process."""
        self.close()

    def close(self) -> None:
        """End the second process."""
        if self._other is not None:
            self._other.close()
            self._other = None

    def evaluate(self, source: Path) -> FileEvaluation:
        """Read a submission strictly and evaluate it, like `evaluate_file`."""
        evaluation = None
        if self._other is not None:
            try:
                with garbage_collection_paused():
                    evaluation = self._evaluate_in_parts(source, self._other)
            except BaseException:
                self.close()  # nobody knows what it would answer next
                raise
            if self._other.has_ended:
                self.close()
        return evaluation or _evaluate_in_one(source, self._ground_truth, self._protocol, self._ground_truth_sha256)

    def _evaluate_in_parts(self, source: Path, other: "_Other") -> FileEvaluation | None:
        """Evaluate with the second process; None when the submission is not clean."""
        other.turns.lay_out(len(self._ground_truth.images))
        other.send(source.absolute())  # it is where the first process was at the start
        own = _read_part(source, self._ground_truth, self._protocol, other.turns, backwards=False)
        boxes_after = other.receive(int)
        if boxes_after is None:
            return None
        if own is None:
            other.receive(Statistics)
            other.send(None)
            return None
        before = _Before.of(own, self._ground_truth, boxes_after=boxes_after)
        sha256 = own.sha256
        signature = signature_of(self._protocol, self._ground_truth_sha256, sha256)
        own_statistics = _match(own, self._ground_truth, signature)
        second = other.receive(Statistics)
        other.send(None if second is None else before)  # only then: it is large, and the other must be there to take it
        if second is None:
            return None
        # While the other process looks at the boxes of both and writes the report:
        statistics = join([own_statistics, second])
        scores = score_by_protocol(statistics)
        del own, own_statistics, second, before
        report = other.receive(Report)
        if report is None:
            return None
        return FileEvaluation(scores=scores, statistics=statistics, report=report, predictions_sha256=sha256)


@dataclass(frozen=True, slots=True)
class _Read:
    """A part of a submission that was read without anything to be said of its files."""

    images: slice
    """Which, all of them with their boxes in `predictions`, which has no boxes of the others."""
    predictions: Predictions
    reading: StrictReading
    findings: Findings
    """What there is to say of the archive as a whole."""
    sha256: str
    """Of the whole archive; empty in the second process."""


@dataclass(frozen=True, slots=True)
class _Before:
    """What the second process must know of the boxes before its own to write the report on all."""

    score: Float64Array
    """(N,) of each."""
    label_counts: NDArray[np.int64]
    """(L,) boxes of each known class."""
    evidence: Evidence

    @classmethod
    def of(cls, own: _Read, ground_truth: GroundTruth, *, boxes_after: int) -> Self:
        """Tell of the first process's boxes."""
        evidence = gather_evidence(own.predictions, ground_truth, after=boxes_after)
        return cls(own.predictions.score, own.reading.label_counts, evidence)


def _read_part(
    source: Path, ground_truth: GroundTruth, protocol: Protocol, turns: Turns, *, backwards: bool
) -> _Read | None:
    """Read images until none is left; the process that reads backwards leaves checking the archive to the other.

    Returns:
        None for a broken archive, and when there is anything to say of its files.
    """
    findings = Findings()
    with open_source(source, DEFAULT_LIMITS, findings, checked_elsewhere=backwards) as files:
        if files is None:
            turns.end()
            return None
        reading = StrictReading(files, ground_truth.images, evaluated_labels(protocol), DEFAULT_LIMITS, findings)
        if findings.error_count:
            turns.end()
            return None
        sha256 = "" if backwards else files.sha256()
        before = _groups(findings)
        taken: list[int] = []
        predictions = reading.read_part(turns.take(reading.assigned, taken, backwards=backwards), backwards=backwards)
        if _groups(findings) != before:
            return None
        count = sum(taken)
        images = slice(len(reading.assigned) - count, None) if backwards else slice(0, count)
        return _Read(images, predictions, reading, findings, sha256)


def _match(own: _Read, ground_truth: GroundTruth, signature: Signature) -> Statistics:
    """Match the images of a part."""
    truth, predictions = ground_truth_of(ground_truth, own.images), predictions_of(own.predictions, own.images)
    return collect(truth, predictions, match_by_protocol(truth, predictions, signature.protocol), signature)


def _report(before: _Before, own: _Read, ground_truth: GroundTruth) -> Report:
    """Write the report on the boxes of both processes."""
    own.reading.label_counts += before.label_counts
    own.reading.note_unevaluated_labels()
    score = np.concatenate([before.score, own.predictions.score])
    evidence = gather_evidence(own.predictions, ground_truth, before=len(before.score))
    conclude(score, Evidence.joined(before.evidence, evidence), own.findings)
    images = len(ground_truth.images)
    return own.findings.report(images_expected=images, images_found=images, boxes=len(score))


def _groups(findings: Findings) -> tuple[ProblemGroup, ...]:
    return findings.report(images_expected=0, images_found=0, boxes=0).groups


class _Other:
    """The second process; it may die at any moment."""

    def __init__(self, ground_truth: GroundTruth, protocol: Protocol) -> None:
        """Start it; it shares the ground truth."""
        context = get_context("fork")
        here, there = context.Pipe()  # before the turns: it is closed with its last reference
        self.turns = Turns()

        def work() -> None:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both; this one is ended by the first
            here.close()  # so that the end of the first process is noticed
            with suppress(EOFError, OSError):
                while True:
                    _serve(there, ground_truth, protocol, self.turns)

        self._connection = here
        self.has_ended = False
        """Noticed at the next word with it."""
        self._process = context.Process(target=work, daemon=True)
        with there:
            try:
                self._process.start()
            except OSError:
                here.close()
                self.turns.close()
                raise
        # Before multiprocessing, which would send SIGTERM, ignored where the first process does so, and wait for ever.
        atexit.register(self.close)

    def send(self, message: Path | _Before | None) -> None:
        """Tell what to evaluate, then of the boxes before its own, None when that file is done with."""
        try:
            self._connection.send(message)
        except OSError:
            self.has_ended = True

    def receive(self, kind: type[_T]) -> _T | None:
        """Wait for what it sends; None also when it died."""
        try:
            result = self._connection.recv()
        except (EOFError, OSError):
            self.has_ended = True
            return None
        return result if isinstance(result, kind) else None

    def close(self) -> None:
        """End it."""
        atexit.unregister(self.close)
        self._connection.close()
        self._process.kill()
        self._process.join()
        self.turns.close()


def _serve(connection: Connection, ground_truth: GroundTruth, protocol: Protocol, turns: Turns) -> None:
    """Answer the first process: boxes in the last part of a file, then their statistics, then the report on the whole."""
    source = connection.recv()
    with garbage_collection_paused():
        try:
            own = _read_part(source, ground_truth, protocol, turns, backwards=True)
        except (UsageError, OSError):  # the first process says it
            own = None
        connection.send(None if own is None else len(own.predictions))
        if own is None:
            return
        try:
            statistics = _match(own, ground_truth, signature_of(protocol))
        except (UsageError, OSError):  # likewise
            statistics = None
        connection.send(statistics)
        before = connection.recv()
        if statistics is not None and before is not None:
            connection.send(_report(before, own, ground_truth))
