"""What the scoring process does for each kind of job: the evaluator called on files, nothing else.

It runs within the limits of worker/child.py. Results are files in the job's folder; events say which are complete.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import msgspec

from evaluator.errors import UsageError
from evaluator.evaluation import evaluate, signature_of
from evaluator.ground_truth import GroundTruth, ImageList
from evaluator.intake import read_predictions
from evaluator.integrity import IntegrityAudit, audit
from evaluator.limits import ANY_SIZE
from evaluator.predictions import Predictions
from evaluator.protocol import PROTOCOLS
from evaluator.results import Scores
from evaluator.score_replicates import score_replicates
from evaluator.sharding import evaluate_shard, reduce_shards, shard_from_bytes, shard_to_bytes
from evaluator.statistics import Statistics
from worker.messages import (
    AnyJob,
    Event,
    Job,
    Matched,
    Preparation,
    Prepared,
    Progress,
    Reduction,
    Rejected,
    Resampled,
    Resampling,
    Scored,
    ShardJob,
    Validated,
)

_PROGRESS_INTERVAL_S = 0.1

Send = Callable[[Event], None]


def carry_out(job: AnyJob, send: Send) -> None:
    """Do one job.

    Args:
        job: Which.
        send: Takes the events.
    """
    match job:
        case Job():
            _score(job, send)
        case Preparation():
            _prepare(job, send)
        case ShardJob():
            _match_shard(job, send)
        case Reduction():
            _reduce(job, send)
        case Resampling():
            _resample(job, send)


def _score(job: Job, send: Send) -> None:
    predictions = _validate(job, send)
    if predictions is None:
        return
    evaluation = evaluate(
        GroundTruth.from_bytes(Path(job.ground_truth).read_bytes()),
        predictions,
        PROTOCOLS[job.protocol],
        ground_truth_sha256=job.ground_truth_sha256,
        predictions_sha256=job.predictions_sha256,
        progress=_reporter("scoring", send),
    )
    _write_results(Path(job.folder), evaluation.scores, evaluation.statistics, audit(evaluation))
    send(Scored())


def _prepare(job: Preparation, send: Send) -> None:
    predictions = _validate(job, send)
    if predictions is not None:
        (Path(job.folder) / "predictions").write_bytes(predictions.to_bytes())
        send(Prepared(images=len(predictions.images)))


def _match_shard(job: ShardJob, send: Send) -> None:
    variants = evaluate_shard(
        GroundTruth.from_bytes(Path(job.ground_truth).read_bytes()),
        Predictions.from_bytes(Path(job.predictions).read_bytes()),
        PROTOCOLS[job.protocol],
        range(job.first_image, job.end_image),
    )
    (Path(job.folder) / "shard").write_bytes(shard_to_bytes(variants))
    send(Matched())


def _reduce(job: Reduction, send: Send) -> None:
    reduction = reduce_shards(
        [shard_from_bytes(Path(path).read_bytes()) for path in job.shards],
        Predictions.from_bytes(Path(job.predictions).read_bytes()),
        signature_of(PROTOCOLS[job.protocol], job.ground_truth_sha256, job.predictions_sha256),
    )
    _write_results(Path(job.folder), reduction.scores, reduction.statistics, reduction.integrity)
    send(Scored())


def _validate(job: Job | Preparation, send: Send) -> Predictions | None:
    """Read the upload and write the report; None when it is rejected."""
    images = msgspec.json.decode(Path(job.image_list).read_bytes(), type=ImageList)
    # What the server took is read, also once it takes less.
    intake = read_predictions(
        Path(job.predictions), images=images, limits=ANY_SIZE, progress=_reporter("validating", send)
    )
    (Path(job.folder) / "report.json").write_bytes(msgspec.json.encode(intake.report))
    send(Rejected() if intake.predictions is None else Validated())
    return intake.predictions


def _write_results(folder: Path, scores: Scores, statistics: Statistics, integrity: IntegrityAudit) -> None:
    (folder / "scores.json").write_bytes(msgspec.json.encode(scores))
    (folder / "statistics").write_bytes(statistics.to_bytes())
    (folder / "integrity.json").write_bytes(msgspec.json.encode(integrity))


def _resample(job: Resampling, send: Send) -> None:
    try:
        replicates = score_replicates(Statistics.from_bytes(Path(job.statistics).read_bytes())).to_bytes()
    except UsageError:  # there are too few images, or the protocol cannot be resampled
        replicates = b""
    (Path(job.folder) / "replicates").write_bytes(replicates)
    send(Resampled())


def _reporter(stage: Literal["validating", "scoring"], send: Send) -> Callable[[int, int], None]:
    """Make a progress callback that speaks at most ten times a second."""
    last_s = 0.0

    def report(done: int, total: int) -> None:
        nonlocal last_s
        now_s = time.monotonic()
        if done == total or now_s - last_s >= _PROGRESS_INTERVAL_S:
            last_s = now_s
            send(Progress(stage=stage, done=done, total=total))

    return report
