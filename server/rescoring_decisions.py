"""What maintainers decide about a re-scoring (server/rescoring.py): try again, exclude, publish, discard."""

import uuid
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Session

from server import database, submissions
from server.errors import Conflict, InvalidField, NotFound
from server.models import (
    ItemState,
    Phase,
    Publication,
    Rescoring,
    RescoringItem,
    RescoringState,
    Submission,
    SubmissionState,
)
from server.ranking import Basis
from server.rescoring import Progress, cover, describe, get_running, lock_phase, progress, record
from server.rescoring_items import EXCLUDED, FAILED, WAITING


def retry(session: Session, rescoring: Rescoring, actor: str, submission_id: uuid.UUID | None = None) -> list[int]:
    """Let failed items wait again with all their attempts. After the commit, send them.

    Args:
        session: Of the transaction.
        rescoring: A running one.
        actor: Who says so, for the audit trail.
        submission_id: This one alone, also when it is excluded; by default all that failed.

    Returns:
        The items that wait again.

    Raises:
        Conflict: It has ended meanwhile.
    """
    _lock_running(session, rescoring)
    states = (FAILED,) if submission_id is None else (FAILED, EXCLUDED)
    query = sa.select(RescoringItem).where(RescoringItem.rescoring_id == rescoring.id, RescoringItem.state.in_(states))
    if submission_id is not None:
        query = query.where(RescoringItem.submission_id == submission_id)
    items = list(session.scalars(query.order_by(RescoringItem.id).with_for_update()))
    for item in items:
        _wait_afresh(session, item)
    record(session, rescoring, "retried", actor, submissions=[str(item.submission_id) for item in items])
    return [item.id for item in items]


def _wait_afresh(session: Session, item: RescoringItem) -> None:
    item.state, item.enqueued_at, item.lost_attempts = WAITING, database.now(session), 0
    item.failure_code = item.failure_detail = item.exclusion_reason = None
    session.flush()


def exclude(session: Session, rescoring: Rescoring, submission_id: uuid.UUID, reason: str, actor: str) -> None:
    """Let a submission go without a score on the new basis: once that is in force, it has no rank.

    Raises:
        NotFound: The re-scoring is not about it.
        InvalidField: No reason is given.
        Conflict: It has its score, or a worker holds it, or the re-scoring has ended meanwhile.
    """
    if not reason.strip():
        raise InvalidField("reason: say why it shall not rank; its team reads it")
    _lock_running(session, rescoring)
    query = sa.select(RescoringItem).where(
        RescoringItem.rescoring_id == rescoring.id, RescoringItem.submission_id == submission_id
    )
    item = session.scalar(query.with_for_update())
    if item is None:
        message = f"the re-scoring has no item for submission {submission_id}"
        raise NotFound(message)
    if item.state not in (WAITING, FAILED):
        message = f"it is {item.state}; only what waits or failed can be excluded"
        raise Conflict(message)
    item.state, item.exclusion_reason = EXCLUDED, reason.strip()
    item.failure_code = item.failure_detail = None
    session.flush()
    record(session, rescoring, "excluded", actor, submission=str(submission_id), reason=reason.strip())


def publish(session: Session, phase: Phase, actor: str, **detail: Any) -> Rescoring:  # noqa: ANN401 - JSON
    """Put a complete re-scoring in force: the whole leaderboard ranks by it from this commit on.

    Published submissions that are excluded from it are withdrawn in the same transaction.

    Raises:
        NotFound: There is none.
        Conflict: A submission lacks its score.
    """
    lock_phase(session, phase)
    rescoring = get_running(session, phase)
    cover(session, rescoring, sent=False)
    _require_complete(progress(session, rescoring))
    old, new = Basis.of(phase), Basis.of(rescoring)
    _withdraw_excluded(session, rescoring, actor)
    phase.protocol, phase.evaluator_version = new.protocol, new.evaluator_version
    phase.ground_truth = rescoring.ground_truth
    # What a page shows of a submission may be another score now.
    shown = sa.update(Submission).where(Submission.phase_id == phase.id, Submission.state == SubmissionState.SCORED)
    session.execute(shown.values(version=Submission.version + 1))
    _end(session, rescoring, RescoringState.PUBLISHED)
    record(session, rescoring, "published", actor, old=describe(session, old), new=describe(session, new), **detail)
    return rescoring


def _require_complete(state: Progress) -> None:
    if state.complete:
        return
    failed = state.counts[FAILED]
    message = f"{state.total - state.settled} of {state.total} submissions are not scored again yet"
    if failed:
        message += f"; {failed} failed: `cs3d-admin rescore retry` or `rescore exclude` them"
    raise Conflict(message)


def _withdraw_excluded(session: Session, rescoring: Rescoring, actor: str) -> None:
    query = (
        sa.select(Submission)
        .join(RescoringItem, RescoringItem.submission_id == Submission.id)
        .where(
            RescoringItem.rescoring_id == rescoring.id,
            RescoringItem.state == EXCLUDED,
            Submission.publication == Publication.PUBLISHED,
        )
    )
    for submission in session.scalars(query):
        submissions.withdraw(session, submission, actor)


def discard(session: Session, phase: Phase, actor: str) -> Rescoring:
    """End a re-scoring without effect; its scores stay in the record and are shown to nobody.

    Raises:
        NotFound: There is none.
    """
    lock_phase(session, phase)
    rescoring = get_running(session, phase)
    _end(session, rescoring, RescoringState.DISCARDED)
    held = sa.update(RescoringItem).where(
        RescoringItem.rescoring_id == rescoring.id, RescoringItem.state == ItemState.RUNNING
    )
    session.execute(held.values(state=WAITING, lease_expires_at=None))
    record(session, rescoring, "discarded", actor)
    return rescoring


def _lock_running(session: Session, rescoring: Rescoring) -> None:
    """Keep a re-scoring from ending: what is decided about its items counts only until it ends."""
    query = sa.select(Rescoring).where(Rescoring.id == rescoring.id).with_for_update()
    session.scalar(query.execution_options(populate_existing=True))
    if rescoring.state is not RescoringState.RUNNING:
        message = f"the re-scoring was {rescoring.state} meanwhile; nothing was changed"
        raise Conflict(message)


def _end(session: Session, rescoring: Rescoring, state: RescoringState) -> None:
    session.scalar(sa.select(Rescoring.id).where(Rescoring.id == rescoring.id).with_for_update())
    rescoring.state, rescoring.ended_at = state, database.now(session)
    session.flush()
