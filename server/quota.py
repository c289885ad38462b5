"""The quota: an append-only ledger per team and phase, checked and written under a lock on the team's row.

A submission reserves one when it is received. Scored: the reservation is charged. Rejected, failed or cancelled: it
is refunded. A refunded reservation never counted, so it is the reservations without a refund that are counted. A
submission that failed and was re-queued by a maintainer is free: its refund stands.
"""

from collections.abc import Sequence
from datetime import datetime, timedelta
from math import ceil

import sqlalchemy as sa
from sqlalchemy.orm import Session

from server import audit, database
from server.errors import InvalidField, QuotaExceeded, TooManyRejections
from server.models import Phase, QuotaEntry, QuotaKind, Submission, SubmissionState, Team

WINDOW = timedelta(hours=24)
"""What "a day" means: any 24 hours, so no rush at midnight."""

AMOUNTS = {QuotaKind.RESERVE: 1, QuotaKind.CHARGE: 0, QuotaKind.REFUND: -1}


def lock_team(session: Session, team_id: int) -> None:
    """Let nobody else change this team's quota until the transaction ends. SQLite locks the whole database anyway."""
    # Not against rows that merely refer to the team: a score being recorded must not wait for a publication.
    session.execute(sa.select(Team.id).where(Team.id == team_id).with_for_update(key_share=True))


def used(session: Session, *, team_id: int, phase: Phase, at: datetime) -> int:
    """Count what the team used in the 24 hours before `at`, less what maintainers granted in that time."""
    return sum(amount for _, amount in _counted(session, team_id, phase.id, at))


def remaining(session: Session, *, team_id: int, phase: Phase, at: datetime) -> int:
    """Count the submissions the team may still send now; never negative."""
    return max(0, phase.submissions_per_day - used(session, team_id=team_id, phase=phase, at=at))


def check(session: Session, *, team: Team, phase: Phase) -> None:
    """Refuse a submission that the team may not send now. The caller holds `lock_team`.

    Raises:
        QuotaExceeded: The phase's submissions for 24 hours are used up.
        TooManyRejections: The phase's rejected or cancelled uploads for 24 hours are used up.
    """
    at = database.now(session)
    if not remaining(session, team_id=team.id, phase=phase, at=at):
        wait_s = _until_fewer_than(phase.submissions_per_day, _counted(session, team.id, phase.id, at), at)
        if wait_s is None:
            message = (
                f"{phase.slug} takes what maintainers grant alone, and team {team.slug} has no grant left; ask them"
            )
            raise QuotaExceeded(message, retry_after_s=None)
        message = (
            f"team {team.slug} has sent what it may to {phase.slug} within 24 hours ({phase.submissions_per_day});"
            f" the next submission is possible at {_moment(at, wait_s)}"
        )
        raise QuotaExceeded(message, retry_after_s=wait_s)
    rejected = _rejections(session, team.id, phase.id, at)
    if len(rejected) >= phase.rejections_per_day:
        wait_s = _until_fewer_than(phase.rejections_per_day, [(time, 1) for time in rejected], at) or 1
        message = (
            f"{len(rejected)} uploads of team {team.slug} to {phase.slug} were rejected or cancelled within 24 hours;"
            f" check files with `cs3d validate` before sending them; the next upload is possible at {_moment(at, wait_s)}"
        )
        raise TooManyRejections(message, retry_after_s=wait_s)


def reserve(session: Session, submission: Submission) -> None:
    """Take one from the team's quota for a new submission."""
    _append(session, submission, QuotaKind.RESERVE, "received")


def charge(session: Session, submission: Submission) -> None:
    """Make the reservation final: the submission is scored."""
    _append(session, submission, QuotaKind.CHARGE, "scored")


def refund(session: Session, submission: Submission, reason: str) -> None:
    """Give the reservation back, once: a submission that failed before and was re-queued has its refund already."""
    known = sa.select(QuotaEntry.id).where(
        QuotaEntry.submission_id == submission.id, QuotaEntry.kind == QuotaKind.REFUND
    )
    if session.scalar(known) is None:
        _append(session, submission, QuotaKind.REFUND, reason)


def grant(session: Session, *, team: Team, phase: Phase, count: int, reason: str, actor: str) -> None:
    """Allow a team `count` more submissions within the next 24 hours.

    Raises:
        InvalidField: `count` is not positive.
    """
    if count < 1:
        raise InvalidField("count must be at least 1")
    lock_team(session, team.id)
    session.add(
        QuotaEntry(
            team_id=team.id,
            phase_id=phase.id,
            kind=QuotaKind.GRANT,
            amount=-count,
            reason=reason,
            created_at=database.now(session),
        )
    )
    audit.record(
        session, actor=actor, action="quota.granted", subject=audit.subject_of(team), phase=phase.id, count=count
    )


def _append(session: Session, submission: Submission, kind: QuotaKind, reason: str) -> None:
    session.add(
        QuotaEntry(
            team_id=submission.team_id,
            phase_id=submission.phase_id,
            submission_id=submission.id,
            kind=kind,
            amount=AMOUNTS[kind],
            reason=reason,
            created_at=database.now(session),
        )
    )
    session.flush()


def _counted(session: Session, team_id: int, phase_id: int, at: datetime) -> list[tuple[datetime, int]]:
    """List what counts: when, and 1 for a reservation without a refund, less than 0 for a grant."""
    refunded = sa.select(QuotaEntry.submission_id).where(
        QuotaEntry.team_id == team_id, QuotaEntry.phase_id == phase_id, QuotaEntry.kind == QuotaKind.REFUND
    )
    kept = sa.and_(QuotaEntry.kind == QuotaKind.RESERVE, QuotaEntry.submission_id.not_in(refunded))
    query = sa.select(QuotaEntry.created_at, QuotaEntry.amount).where(
        QuotaEntry.team_id == team_id,
        QuotaEntry.phase_id == phase_id,
        QuotaEntry.created_at > at - WINDOW,
        sa.or_(kept, QuotaEntry.kind == QuotaKind.GRANT),
    )
    return [(row.created_at, row.amount) for row in session.execute(query)]


def _rejections(session: Session, team_id: int, phase_id: int, at: datetime) -> list[datetime]:
    """List when the team's uploads were rejected or cancelled.

    Neither costs quota, but their bytes are kept: without a bound, sending and cancelling would fill the disk.
    """
    query = sa.select(Submission.state_changed_at).where(
        Submission.team_id == team_id,
        Submission.phase_id == phase_id,
        Submission.state.in_((SubmissionState.REJECTED, SubmissionState.CANCELLED)),
        Submission.state_changed_at > at - WINDOW,
    )
    return list(session.scalars(query))


def _moment(at: datetime, wait_s: int) -> str:
    """Say when a wait is over, to the minute, never too early."""
    over = at + timedelta(seconds=wait_s + 59)
    return f"{over:%Y-%m-%d %H:%M} UTC"


def _until_fewer_than(cap: int, counted: Sequence[tuple[datetime, int]], at: datetime) -> int | None:
    """Count the seconds until so much of `counted`, times and amounts, is 24 hours old that the rest is below the cap.

    Returns:
        At least 1; None when that never happens.
    """
    for end in sorted(time + WINDOW for time, _ in counted):
        if sum(amount for time, amount in counted if time + WINDOW > end) < cap:
            return max(1, ceil((end - at).total_seconds()))
    return None
