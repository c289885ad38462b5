"""The audit trail: one line per change, written in the transaction that makes the change."""

from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Session

from server import database
from server.models import AuditEvent, Base

SWEEPER = "sweeper"
"""The actor of what happens because a lease ran out."""


def subject_of(row: Base) -> str:
    """Name a row in the trail, for example `submission:<id>`."""
    (key,) = sa.inspect(row).identity or (None,)
    return f"{row.__tablename__}:{key}"


def record(session: Session, *, actor: str, action: str, subject: str, **detail: Any) -> None:  # noqa: ANN401 - JSON
    """Append one event.

    Args:
        session: Of the transaction that makes the change.
        actor: `user:<id>`, `worker:<name>`, `sweeper` or `admin:<login>`.
        action: What happened, for example `submission.queued` or `phase.created`.
        subject: What it happened to, as `subject_of` names it.
        **detail: What a reader of the trail needs beside that; JSON values.
    """
    session.add(AuditEvent(at=database.now(session), actor=actor, action=action, subject=subject, detail=detail))


def trail(session: Session, subject: str) -> list[AuditEvent]:
    """List everything that happened to `subject`, oldest first."""
    return list(session.scalars(sa.select(AuditEvent).where(AuditEvent.subject == subject).order_by(AuditEvent.id)))


def latest(session: Session, *, subject: str | None = None, action: str | None = None, limit: int) -> list[AuditEvent]:
    """List the latest events, newest first.

    Args:
        session: Reads the record.
        subject: Of this alone, as `subject_of` names it.
        action: This alone, for example `submission.held`, or a whole kind, for example `submission`.
        limit: So many at most.
    """
    query = sa.select(AuditEvent).order_by(AuditEvent.id.desc()).limit(limit)
    if subject is not None:
        query = query.where(AuditEvent.subject == subject)
    if action is not None:
        of_kind = AuditEvent.action.startswith(f"{action}.", autoescape=True)
        query = query.where(sa.or_(AuditEvent.action == action, of_kind))
    return list(session.scalars(query))
