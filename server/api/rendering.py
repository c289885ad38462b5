"""Rows of the record as documents of the API."""

import uuid

import msgspec
from sqlalchemy.orm import Session, object_session

from evaluator.integrity import IntegrityAudit
from evaluator.report import Report
from evaluator.results import Scores
from server.api import documents
from server.blobs import Blobs
from server.errors import NotFound, NotScored
from server.models import Benchmark, Blob, Phase, Score, Submission, SubmissionState
from server.ranking import Leaderboard, LeaderboardRow, history, ranking_score, shown_scores, signature_of
from server.standings import Standing


def links_of(submission: Submission) -> documents.Links:
    """Say where a submission's documents and its page are."""
    own = f"/api/v1/submissions/{submission.id}"
    return documents.Links(
        self=own, results=f"{own}/results", events=f"{own}/events", page=f"/submissions/{submission.id}"
    )


def submission_document(submission: Submission, blobs: Blobs, *, owned: bool) -> documents.SubmissionDocument:
    """Describe a submission; the report and the cause of a failure are for its owners.

    Args:
        submission: The row, within its session.
        blobs: Where the report is.
        owned: True for members of its team and maintainers.
    """
    shown = ranking_score(submission) if submission.state is SubmissionState.SCORED else None
    return documents.SubmissionDocument(
        id=str(submission.id),
        benchmark=submission.phase.benchmark.slug,
        phase=submission.phase.slug,
        method=submission.method.slug,
        method_name=submission.method.name,
        team=submission.team.slug,
        state=submission.state.value,
        terminal=submission.state.terminal,
        created_at=submission.created_at,
        state_changed_at=submission.state_changed_at,
        attempt=submission.attempt,
        progress=_progress(submission),
        publication=submission.publication.value,
        held=submission.held_reason if owned else None,
        predictions=_predictions(submission, owned=owned),
        failure=_failure(submission) if owned else None,
        report=report_of(submission, blobs) if owned else None,
        mds=shown.mds if shown else None,
        signature=signature_of(shown.summary) if shown else None,
        links=links_of(submission),
    )


def submission_list(session: Session, submissions: list[Submission]) -> documents.SubmissionList:
    """Describe submissions, each in one line."""
    scores = shown_scores(session, submissions)
    return documents.SubmissionList(submissions=[_summary(one, scores.get(one.id)) for one in submissions])


def _summary(submission: Submission, shown: Score | None) -> documents.SubmissionSummary:
    return documents.SubmissionSummary(
        id=str(submission.id),
        benchmark=submission.phase.benchmark.slug,
        phase=submission.phase.slug,
        method=submission.method.slug,
        team=submission.team.slug,
        state=submission.state.value,
        terminal=submission.state.terminal,
        created_at=submission.created_at,
        publication=submission.publication.value,
        mds=shown.mds if shown else None,
        links=links_of(submission),
    )


def report_of(submission: Submission, blobs: Blobs) -> Report | None:
    """Read the report on a submission; None before it is validated."""
    if submission.report_sha256 is None:
        return None
    return msgspec.json.decode(blobs.read(submission.report_sha256), type=Report)


def integrity_of(submission: Submission) -> IntegrityAudit | None:
    """Give the audit of the score a submission is shown with; None before it is scored."""
    score = ranking_score(submission) if submission.state is SubmissionState.SCORED else None
    return msgspec.convert(score.integrity, IntegrityAudit) if score and score.integrity else None


def scores_of(submission: Submission, blobs: Blobs, score_id: int | None = None) -> Scores:
    """Read the scores a submission is shown with, or those of another score in its history.

    Raises:
        NotScored: There are none (yet).
        NotFound: It has no such score.
    """
    score = ranking_score(submission) if submission.state is SubmissionState.SCORED else None
    if score is None:
        raise NotScored(f"submission {submission.id} is {submission.state.value}; it has no scores")
    if score_id is not None:
        score = next((one for one in history(submission) if one.id == score_id), None)
    if score is None:
        raise NotFound(f"submission {submission.id} has no score {score_id}; its results list them as `history`")
    return msgspec.json.decode(blobs.read(score.scores_sha256), type=Scores)


def history_of(submission: Submission) -> list[documents.ScoreEntry]:
    """Describe every score of a submission, oldest first; at most one of them ranks."""
    ranking = ranking_score(submission)
    in_force = (submission.phase.protocol, submission.phase.ground_truth_id)
    return [
        documents.ScoreEntry(
            id=score.id,
            mds=score.mds,
            signature_text=signature_of(score.summary),
            created_at=score.created_at,
            ranks=score is ranking and (score.protocol, score.ground_truth_id) == in_force,
        )
        for score in history(submission)
    ]


def results_document(scores: Scores, history: list[documents.ScoreEntry]) -> documents.ResultsDocument:
    """Put the printable signature and the submission's other scores beside the numbers."""
    fields = {name: getattr(scores, name) for name in scores.__struct_fields__}
    return documents.ResultsDocument(**fields, signature_text=str(scores.signature), history=history)


def leaderboard_document(board: Leaderboard, standings: dict[uuid.UUID, Standing]) -> documents.LeaderboardDocument:
    """Describe a ranking."""
    return documents.LeaderboardDocument(
        benchmark=board.phase.benchmark.slug,
        phase=board.phase.slug,
        protocol=board.phase.protocol,
        rows=[_row(row, standings[row.submission.id]) for row in board.rows],
    )


def benchmark_document(benchmark: Benchmark) -> documents.BenchmarkDocument:
    """Describe a benchmark."""
    return documents.BenchmarkDocument(
        slug=benchmark.slug,
        title=benchmark.title,
        description=benchmark.description,
        phases=[_phase(phase) for phase in benchmark.phases],
    )


def _progress(submission: Submission) -> documents.Progress | None:
    if submission.stage is None or submission.state.terminal:
        return None
    return documents.Progress(
        stage=msgspec.convert(submission.stage, documents.Stage),
        images_done=submission.images_done,
        images_total=submission.images_total,
    )


def _predictions(submission: Submission, *, owned: bool) -> documents.PredictionsFile:
    session = object_session(submission)
    if session is None:
        raise AssertionError("a submission is described within its session")
    blob = session.get_one(Blob, submission.predictions_sha256)
    return documents.PredictionsFile(
        sha256=submission.predictions_sha256,
        size_bytes=blob.size_bytes,
        file_name=submission.file_name if owned else None,
    )


def _failure(submission: Submission) -> documents.Failure | None:
    if submission.failure_code is None:
        return None
    return documents.Failure(code=submission.failure_code, detail=submission.failure_detail or "")


def _phase(phase: Phase) -> documents.PhaseDocument:
    return documents.PhaseDocument(
        slug=phase.slug,
        title=phase.title,
        protocol=phase.protocol,
        is_open=phase.is_open,
        allows_publication=phase.allows_publication,
        opens_at=phase.opens_at,
        closes_at=phase.closes_at,
        submissions_per_day=phase.submissions_per_day,
        images=phase.ground_truth.image_count if phase.ground_truth else None,
    )


def _row(row: LeaderboardRow, standing: Standing) -> documents.LeaderboardRow:
    interval = standing.interval
    means = {name: row.summary[name] for name in ("map", "mbevcd", "myaw_sim", "mpr_sim", "msize_sim")}
    return documents.LeaderboardRow(
        rank=row.rank,
        method=row.method.slug,
        method_name=row.method.name,
        paper_url=row.method.paper_url,
        code_url=row.method.code_url,
        team=row.team.slug,
        team_name=row.team.name,
        submission_id=str(row.submission.id),
        mds=row.mds,
        mds_interval=None if interval is None else (interval.lower, interval.upper),
        rank_interval=standing.ranks,
        groups=standing.groups,
        **means,
        created_at=row.submission.created_at,
        signature=signature_of(row.summary),
        classes={one["label"]: msgspec.convert(one, documents.ClassSummary) for one in row.summary["classes"]},
        links=links_of(row.submission),
    )
