"""The life of a submission: every change of state, and nothing else changes a state.

    received   -> queued, rejected, failed, cancelled
    queued     -> scoring, cancelled
    scoring    -> scored, rejected, failed; queued when the lease expires, the scoring process dies or the worker drains
    failed     -> received or queued, when a maintainer re-queues it

Each change is one compare-and-set on the row. What a worker writes also carries its attempt as a fence: once the
lease is lost and the submission taken back, no row matches any more and `LeaseLost` is raised, whatever the worker
does. Each change writes its audit event in the same transaction. The database refuses any other change by trigger.
"""

import uuid
from datetime import timedelta
from typing import Any, cast

import sqlalchemy as sa
from sqlalchemy.orm import Session

from server import audit, database, integrity, quota, ranking, shards
from server.claims import Claim, Result
from server.errors import IllegalTransition, LeaseLost
from server.models import Attempt, AttemptOutcome, Phase, Score, Submission, SubmissionState

RECEIVED, QUEUED, SCORING = SubmissionState.RECEIVED, SubmissionState.QUEUED, SubmissionState.SCORING
SCORED, REJECTED = SubmissionState.SCORED, SubmissionState.REJECTED
FAILED, CANCELLED = SubmissionState.FAILED, SubmissionState.CANCELLED

TRANSITIONS: dict[SubmissionState, frozenset[SubmissionState]] = {
    RECEIVED: frozenset({QUEUED, REJECTED, FAILED, CANCELLED}),
    QUEUED: frozenset({SCORING, CANCELLED}),
    SCORING: frozenset({QUEUED, SCORED, REJECTED, FAILED}),
    FAILED: frozenset({RECEIVED, QUEUED}),
    SCORED: frozenset(),
    REJECTED: frozenset(),
    CANCELLED: frozenset(),
}
"""What may follow what; migrations/ has the same table as a trigger, and a test holds them together."""

ATTEMPTS_EXHAUSTED = "attempts_exhausted"
"""Failure code: the worker was lost as often as the phase allows."""


def claim(session: Session, submission_id: uuid.UUID, *, worker: str, lease_s: float) -> Claim | None:
    """Take a waiting submission: raise the attempt, start the lease.

    Args:
        session: Of the transaction; once it is committed the claim holds.
        submission_id: From a message; it may be unknown, delivered twice or long done.
        worker: The worker's name.
        lease_s: Seconds until the submission is taken back unless `heartbeat` renews.

    Returns:
        None when there is nothing to do: unknown, held by another worker, or in a terminal state.
    """
    submission = _lock(session, submission_id)
    waiting = submission is not None and submission.state in (RECEIVED, QUEUED) and not submission.lease_expires_at
    if submission is None or not waiting:
        return None
    ground_truth = submission.phase.ground_truth
    if ground_truth is None:  # the phase takes submissions only once it has some, and never loses it
        return None
    at = database.now(session)
    actor = f"worker:{worker}"
    submission.attempt += 1
    submission.lease_expires_at = at + timedelta(seconds=lease_s)
    submission.stage, submission.images_done, submission.images_total = "validating", 0, 0
    session.add(Attempt(submission_id=submission_id, number=submission.attempt, worker=worker, started_at=at))
    if submission.state is QUEUED:
        _move(session, submission, SCORING, actor=actor)
    else:
        submission.version += 1
        session.flush()
    return Claim(
        submission_id=submission_id,
        attempt=submission.attempt,
        worker=worker,
        lease_s=lease_s,
        validated=submission.state is SCORING,
        predictions_sha256=submission.predictions_sha256,
        ground_truth_id=ground_truth.id,
        ground_truth_sha256=ground_truth.sha256,
        image_list_sha256=ground_truth.image_list_sha256,
        protocol=submission.phase.protocol,
        shards=submission.phase.shards,
    )


def heartbeat(session: Session, held: Claim, *, stage: str, images_done: int, images_total: int) -> None:
    """Renew the lease and write the progress.

    Raises:
        LeaseLost: The submission was taken back or cancelled; stop working on it.
    """
    changed = cast(
        "sa.CursorResult[Any]",
        session.execute(
            sa.update(Submission)
            .where(*_fence(held))
            .values(
                lease_expires_at=database.now(session) + timedelta(seconds=held.lease_s),
                stage=stage,
                images_done=images_done,
                images_total=images_total,
                version=Submission.version + 1,
            )
        ),
    )
    if changed.rowcount != 1:
        raise LeaseLost(_lost(held))


def validated(session: Session, held: Claim, *, report_sha256: str) -> None:
    """Note that the predictions are without errors; the same worker goes on to score.

    Raises:
        LeaseLost: The submission was taken back or cancelled.
    """
    submission = _lock_held(session, held)
    submission.report_sha256 = report_sha256
    submission.stage = "scoring"
    if submission.state is RECEIVED:
        _move(session, submission, QUEUED, actor=held.actor, lease_kept=False)
        submission.lease_expires_at = database.now(session) + timedelta(seconds=held.lease_s)
        _move(session, submission, SCORING, actor=held.actor)


def record_score(session: Session, held: Claim, result: Result) -> Score | None:
    """Write the score, the state, the quota entry and the audit event: all of them or none.

    Returns:
        None when another protocol or ground truth came in force since the claim: a score under the old one would rank
        nowhere, so the submission waits again, without a lost attempt.

    Raises:
        LeaseLost: The submission was taken back; its score comes from another attempt.
    """
    phase = session.scalar(
        sa.select(Phase)
        .join(Submission, Submission.phase_id == Phase.id)
        .where(Submission.id == held.submission_id)
        .with_for_update(read=True, of=Phase)
        .execution_options(populate_existing=True)
    )
    submission = _lock_held(session, held)
    if phase is None or (phase.protocol, phase.ground_truth_id) != (held.protocol, held.ground_truth_id):
        _end_attempt(session, submission, AttemptOutcome.RETURNED, "other scores came in force meanwhile")
        _wait_again(session, submission, actor=held.actor)
        return None
    score = new_score(session, held, result)
    integrity.keep(session, submission, score, result.integrity)
    session.add(score)
    session.flush()
    _end_attempt(session, submission, AttemptOutcome.SCORED)
    _move(session, submission, SCORED, actor=held.actor, lease_kept=False, mds=result.scores.mds)
    quota.charge(session, submission)
    return score


def new_score(session: Session, held: Claim, result: Result) -> Score:
    """Make the row of what an attempt brought back."""
    signature = result.scores.signature
    return Score(
        submission_id=held.submission_id,
        protocol=signature.protocol.name,
        protocol_version=signature.protocol.version,
        evaluator_version=signature.evaluator_version,
        ground_truth_id=held.ground_truth_id,
        attempt=held.attempt,
        mds=result.scores.mds,
        summary=ranking.summary_of(result.scores),
        scores_sha256=result.scores_sha256,
        statistics_sha256=result.statistics_sha256,
        created_at=database.now(session),
    )


def reject(session: Session, held: Claim, *, report_sha256: str) -> None:
    """End the submission as `rejected`: the predictions have errors; the report says which.

    Raises:
        LeaseLost: The submission was taken back or cancelled.
    """
    submission = _lock_held(session, held)
    submission.report_sha256 = report_sha256
    _end_attempt(session, submission, AttemptOutcome.REJECTED)
    _move(session, submission, REJECTED, actor=held.actor, lease_kept=False)
    _refund(session, submission)


def fail(session: Session, held: Claim, *, code: str, detail: str) -> None:
    """End the submission as `failed`: our fault, trying again would not help.

    Raises:
        LeaseLost: The submission was taken back or cancelled.
    """
    submission = _lock_held(session, held)
    _end_attempt(session, submission, AttemptOutcome.FAILED, detail)
    _fail(session, submission, actor=held.actor, code=code, detail=detail)


def give_back(session: Session, held: Claim, *, detail: str) -> None:
    """Let the submission wait again without counting the attempt: the worker stops, or lacks what it needs.

    Raises:
        LeaseLost: The submission was taken back or cancelled.
    """
    submission = _lock_held(session, held)
    _end_attempt(session, submission, AttemptOutcome.RETURNED, detail)
    _wait_again(session, submission, actor=held.actor)


def lose(session: Session, held: Claim, *, code: str, detail: str) -> SubmissionState:
    """End an attempt whose scoring process died; the submission waits again, or fails at the phase's cap.

    Returns:
        The state it is in now: `received`, `queued` or `failed`.

    Raises:
        LeaseLost: The submission was taken back or cancelled.
    """
    submission = _lock_held(session, held)
    return _lose(session, submission, actor=held.actor, code=code, detail=detail)


def expire(session: Session, submission_id: uuid.UUID) -> SubmissionState | None:
    """Take a submission back from a worker whose lease ran out.

    Returns:
        The state it is in now, None when its lease has not run out (any more).
    """
    submission = _lock(session, submission_id)
    at = database.now(session)
    if submission is None or submission.lease_expires_at is None or submission.lease_expires_at > at:
        return None
    detail = f"attempt {submission.attempt} was silent for longer than its lease"
    return _lose(session, submission, actor=audit.SWEEPER, code=ATTEMPTS_EXHAUSTED, detail=detail)


def cancel(session: Session, submission_id: uuid.UUID, *, actor: str) -> Submission:
    """End the submission as `cancelled`; a worker that validates it finds its lease lost.

    Raises:
        IllegalTransition: It is being scored or is done.
    """
    submission = _lock_or_refuse(session, submission_id)
    _require(submission, CANCELLED)
    if submission.lease_expires_at is not None:
        _end_attempt(session, submission, AttemptOutcome.RETURNED, "cancelled")
    _move(session, submission, CANCELLED, actor=actor, lease_kept=False)
    _refund(session, submission)
    return submission


def requeue(session: Session, submission_id: uuid.UUID, *, actor: str) -> Submission:
    """Let a failed submission wait again with all its attempts; its refund stands, so the result is free.

    Raises:
        IllegalTransition: It has not failed.
    """
    submission = _lock_or_refuse(session, submission_id)
    target = RECEIVED if submission.report_sha256 is None else QUEUED
    if submission.state is not FAILED:
        message = f"submission {submission.id} is {submission.state}; only a failed submission can be re-queued"
        raise IllegalTransition(message)
    submission.forgiven_attempts = submission.attempt
    submission.failure_code = submission.failure_detail = None
    submission.enqueued_at = database.now(session)
    _move(session, submission, target, actor=actor, lease_kept=False)
    return submission


def _move(
    session: Session,
    submission: Submission,
    target: SubmissionState,
    *,
    actor: str,
    lease_kept: bool = True,
    **detail: Any,  # noqa: ANN401 - JSON for the audit trail
) -> None:
    """Change the state of a locked row and write the audit event."""
    _require(submission, target)
    source = submission.state
    submission.state = target
    submission.state_changed_at = database.now(session)
    submission.version += 1
    if not lease_kept:
        submission.lease_expires_at = None
    if target.terminal:
        submission.stage = None
    session.flush()
    audit.record(
        session,
        actor=actor,
        action=f"submission.{target}",
        subject=audit.subject_of(submission),
        source=source.value,
        attempt=submission.attempt,
        **detail,
    )


def _require(submission: Submission, target: SubmissionState) -> None:
    if target not in TRANSITIONS[submission.state]:
        message = f"submission {submission.id} is {submission.state} and cannot become {target}"
        raise IllegalTransition(message)


def _fail(session: Session, submission: Submission, *, actor: str, code: str, detail: str) -> None:
    submission.failure_code, submission.failure_detail = code, detail
    _move(session, submission, FAILED, actor=actor, lease_kept=False, code=code)
    _refund(session, submission)


def _lose(session: Session, submission: Submission, *, actor: str, code: str, detail: str) -> SubmissionState:
    _end_attempt(session, submission, AttemptOutcome.LOST, detail)
    if _lost_attempts(session, submission) >= submission.phase.max_attempts:
        _fail(session, submission, actor=actor, code=code, detail=detail)
    else:
        _wait_again(session, submission, actor=actor)
    return submission.state


def _wait_again(session: Session, submission: Submission, *, actor: str) -> None:
    """Clear the lease; the sweeper sends a new message at once."""
    submission.stage = None
    submission.enqueued_at = None
    if submission.state is SCORING:
        _move(session, submission, QUEUED, actor=actor, lease_kept=False)
    else:
        submission.lease_expires_at = None
        submission.version += 1
        session.flush()


def _lost_attempts(session: Session, submission: Submission) -> int:
    query = sa.select(sa.func.count()).where(
        Attempt.submission_id == submission.id,
        Attempt.number > submission.forgiven_attempts,
        Attempt.outcome == AttemptOutcome.LOST,
    )
    return session.scalar(query) or 0


def _end_attempt(session: Session, submission: Submission, outcome: AttemptOutcome, detail: str | None = None) -> None:
    attempt = session.get_one(Attempt, (submission.id, submission.attempt))
    attempt.outcome, attempt.detail, attempt.ended_at = outcome, detail, database.now(session)
    shards.forget(session, submission.id)
    session.flush()


def _refund(session: Session, submission: Submission) -> None:
    quota.lock_team(session, submission.team_id)
    quota.refund(session, submission, submission.state.value)


def _fence(held: Claim) -> tuple[sa.ColumnElement[bool], ...]:
    """Match the row only while this very attempt holds it."""
    return (
        Submission.id == held.submission_id,
        Submission.attempt == held.attempt,
        Submission.state.in_((RECEIVED, SCORING)),
        Submission.lease_expires_at.is_not(None),
    )


def _lock_held(session: Session, held: Claim) -> Submission:
    """Lock the row under the fence."""
    query = sa.select(Submission).where(*_fence(held)).with_for_update().execution_options(populate_existing=True)
    submission = session.scalar(query)
    if submission is None:
        raise LeaseLost(_lost(held))
    return submission


def _lost(held: Claim) -> str:
    return f"attempt {held.attempt} of submission {held.submission_id} no longer holds it"


def _lock(session: Session, submission_id: uuid.UUID) -> Submission | None:
    query = sa.select(Submission).where(Submission.id == submission_id).with_for_update()
    return session.scalar(query.execution_options(populate_existing=True))


def _lock_or_refuse(session: Session, submission_id: uuid.UUID) -> Submission:
    submission = _lock(session, submission_id)
    if submission is None:
        message = f"there is no submission {submission_id}"
        raise IllegalTransition(message)
    return submission
