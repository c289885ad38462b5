"""Reads a submission: every problem found, named and located, or clean arrays.

`read_predictions` is the strict reading that the server and `cs3d validate` share; `read_predictions_leniently` takes
what the reference takes. None of the functions raises for bad data.
"""

from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from evaluator.archive import check_framing, digest, open_archive, open_source
from evaluator.decoding import garbage_collection_paused
from evaluator.doctor import examine
from evaluator.findings import Findings
from evaluator.ground_truth import GroundTruth, ImageList
from evaluator.lenient import NO_LIMITS, LenientReading, LinkFollowingFolder
from evaluator.limits import DEFAULT_LIMITS, Limits
from evaluator.predictions import Predictions
from evaluator.protocol import EVALUATED_LABELS
from evaluator.report import Report
from evaluator.strict import Progress, StrictReading


@dataclass(frozen=True, slots=True, kw_only=True)
class Intake:
    """What a submission holds and what is wrong with it."""

    predictions: Predictions | None
    """None when the report has errors."""
    report: Report
    sha256: str
    """Digest of the archive's bytes; for a folder of its sorted names and contents. Empty when unreadable."""


def read_predictions(
    source: Path,
    *,
    images: ImageList | GroundTruth | None,
    labels: tuple[str, ...] = EVALUATED_LABELS,
    limits: Limits = DEFAULT_LIMITS,
    progress: Progress | None = None,
) -> Intake:
    """Read a zip or a folder of prediction files strictly.

    Args:
        source: path of a zip, or of a folder with files named alike.
        images: the images that need a file; None checks only what can be checked without knowing them.
        labels: classes to keep; boxes of the data set's other classes are counted and left out.
        limits: caps.
        progress: told how many images are done, of how many.

    Returns:
        Predictions in the order of the images, and the report. No boxes at all is valid.
    """
    findings = Findings()
    predictions = None
    found = expected = boxes = 0
    with garbage_collection_paused(), open_source(source, limits, findings) as files:
        if files is not None:
            reading = StrictReading(files, None if images is None else images.images, labels, limits, findings)
            predictions = reading.read(progress)
            reading.note_unevaluated_labels()
            examine(predictions, images=images, known_labels=reading.known_labels, findings=findings)
            found, expected, boxes = len(reading.assigned), len(reading.images), reading.boxes
        sha256 = digest(source) if files is None else files.sha256()
    report = findings.report(images_expected=expected, images_found=found, boxes=boxes)
    return Intake(predictions=predictions if report.accepted else None, report=report, sha256=sha256)


def read_predictions_leniently(
    source: Path, *, images: ImageList, labels: tuple[str, ...] = EVALUATED_LABELS
) -> Intake:
    """Read a zip or a folder as the reference reads a folder.

    Args:
        source: path of a zip, whose framing is still checked, or of a folder, whose links to files are followed.
        images: the images of the ground truth; one without a file is empty.
        labels: classes to keep.

    Returns:
        Predictions in the order of the images, unless a file that is needed cannot be read; the report's notes say
        what was skipped.
    """
    findings = Findings()
    reading = LenientReading(images.images, labels, findings)
    opened = nullcontext(LinkFollowingFolder(source)) if source.is_dir() else open_source(source, NO_LIMITS, findings)
    with opened as files:
        if files is not None:
            reading.read(files)
        sha256 = digest(source) if files is None else files.sha256()
    expected, found = len(images.images), reading.images_found
    report = findings.report(images_expected=expected, images_found=found, boxes=len(reading.rows))
    predictions = reading.predictions() if report.accepted else None
    return Intake(predictions=predictions, report=report, sha256=sha256)


def check_archive(source: Path, limits: Limits = DEFAULT_LIMITS) -> Report:
    """Check a zip's framing alone, without unpacking anything: cheap enough to do before answering an upload."""
    findings = Findings()
    with open_archive(source, findings) as archive:
        if archive is not None:
            check_framing(archive, limits, findings)
    return findings.report(images_expected=0, images_found=0, boxes=0)
