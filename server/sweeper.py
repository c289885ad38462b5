"""The sweeper: takes back what lost workers held and sends again what nobody picked up.

It covers every state that is not terminal, so no submission waits for a message that was lost:

    held, lease ran out            -> waits again, or `failed` at the phase's cap of attempts
    waits, never or long ago sent  -> a new message
    scored, never resampled        -> a new message (server/resampling.py)
    scoring without a lease        -> cannot exist (a constraint of the table)

Any number of sweepers may run at once: each change is a compare-and-set of its own.
"""

import uuid
from dataclasses import dataclass
from datetime import datetime, timedelta

import sqlalchemy as sa
import structlog
from sqlalchemy.orm import Session

from server import database, file_sweeper, lifecycle, mail, resampling, rescoring_sweeper
from server.models import Submission, SubmissionState
from server.queue import PRIORITY_NORMAL, PRIORITY_URGENT
from server.services import Services

log = structlog.get_logger(__name__)

FAR_OVERDUE = 10
"""Times `resend_s`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """What one pass did."""

    taken_back: int
    failed: int
    sent: int


def sweep(services: Services) -> Sweep:
    """Take back and send again, once."""
    with services.snapshot() as session:
        at = database.now(session)
        held = _held_past(session, at)
    states = [_expire(services, submission_id) for submission_id in held]
    failed = [held[index] for index, state in enumerate(states) if state is SubmissionState.FAILED]
    for submission_id in failed:
        mail.tell_of_failure(services, submission_id)
    taken_back = sum(state is not None for state in states) - len(failed)
    sent = _send_again(services) + resampling.sweep(services) + rescoring_sweeper.sweep(services)
    done = Sweep(taken_back=taken_back, failed=len(failed), sent=sent)
    if held or done.sent:
        log.info("swept", taken_back=done.taken_back, failed=done.failed, sent=done.sent)
    return done


def _expire(services: Services, submission_id: uuid.UUID) -> SubmissionState | None:
    with services.transaction() as session:
        return lifecycle.expire(session, submission_id)


def _send_again(services: Services) -> int:
    """Send a message for every submission that waits without one.

    Messages that wait in the broker are left alone as long as there is one for each submission that waits: a long
    queue is not a lost one, and doubling it at every pass would only make it longer. But what is counted there may be
    messages that came twice, so a message that is far overdue is sent again whatever waits.
    """
    resend_s = services.settings.resend_s
    with services.snapshot() as session:
        at = database.now(session)
        unsent = _waiting(session, Submission.enqueued_at.is_(None))
        overdue = _waiting(session, Submission.enqueued_at < at - timedelta(seconds=resend_s))
        lost = _waiting(session, Submission.enqueued_at < at - timedelta(seconds=resend_s * FAR_OVERDUE))
        waiting = _waiting(session, sa.true())
    # The bulk messages of a re-scoring are not theirs.
    depth = services.queue.depth(PRIORITY_URGENT, PRIORITY_NORMAL) if unsent or overdue else None
    if depth is None:
        return 0
    due = unsent + (overdue if depth < len(waiting) else lost)
    return sum(_send(services, submission_id) for submission_id in due)


def _send(services: Services, submission_id: uuid.UUID) -> bool:
    """Send first and note it after: a crash in between sends twice, which is harmless, instead of never."""
    if not services.queue.enqueue(submission_id):
        return False
    with services.transaction() as session:
        session.execute(
            sa.update(Submission).where(Submission.id == submission_id).values(enqueued_at=database.now(session))
        )
    return True


def _waiting(session: Session, condition: sa.ColumnElement[bool]) -> list[uuid.UUID]:
    """List the submissions that wait for a worker, oldest first."""
    query = (
        sa.select(Submission.id)
        .where(
            Submission.state.in_((SubmissionState.RECEIVED, SubmissionState.QUEUED)),
            Submission.lease_expires_at.is_(None),
            condition,
        )
        .order_by(Submission.created_at)
    )
    return list(session.scalars(query))


def _held_past(session: Session, deadline: datetime) -> list[uuid.UUID]:
    """List the submissions whose lease ran out before `deadline`."""
    living = [state for state in SubmissionState if not state.terminal]  # named, as the index begins with the state
    query = sa.select(Submission.id).where(Submission.state.in_(living), Submission.lease_expires_at < deadline)
    return list(session.scalars(query.order_by(Submission.lease_expires_at)))


def sweep_files(services: Services) -> int:
    """Delete blobs without a row, abandoned temporary files and unused copies of blobs, all only after the grace time.

    Returns:
        How many files were deleted.
    """
    grace_s = services.settings.orphan_grace_s
    return file_sweeper.sweep_orphans(services, grace_s=grace_s) + file_sweeper.sweep_local(services)
