"""Holds a score back from ranking until a maintainer has looked, when the integrity audit gives a reason.

The audit itself is the evaluator's (`evaluator/integrity.py`); here it meets the other submissions and the record.
"""

import uuid

import msgspec
import sqlalchemy as sa
from sqlalchemy.orm import Session

from evaluator.fingerprint import similarity
from evaluator.integrity import SIMILARITY_LIMIT, IntegrityAudit
from server import audit
from server.errors import Conflict
from server.models import Score, Submission

COPIED = "The predictions are nearly identical to a submission of another team."


def keep(session: Session, submission: Submission, score: Score, findings: IntegrityAudit) -> None:
    """Keep the audit with its score, and hold the submission when there is a reason to."""
    score.integrity = msgspec.to_builtins(findings)
    twin = _twin(session, submission, findings.fingerprint)
    reasons = [*findings.reasons, *([COPIED] if twin else [])]
    if not reasons:
        return
    # For the maintainers, who alone read the trail: whose work it resembles is not the team's to know.
    hold(session, submission, " ".join(reasons), actor="integrity", resembles=str(twin) if twin else None)


def hold(session: Session, submission: Submission, reason: str, *, actor: str, **detail: str | None) -> None:
    """Keep a submission that is not published from being published until a maintainer releases it."""
    submission.held_reason = reason
    submission.version += 1
    session.flush()
    audit.record(
        session, actor=actor, action="submission.held", subject=audit.subject_of(submission), reason=reason, **detail
    )


def release(session: Session, submission: Submission, actor: str) -> None:
    """Let a held submission be published after all; nothing happens when it is not held.

    Raises:
        Conflict: It was held anew since the caller read it, for a reason that nobody has looked at.
    """
    reason = submission.held_reason
    query = sa.select(Submission).where(Submission.id == submission.id).with_for_update()
    session.scalar(query.execution_options(populate_existing=True))
    if submission.held_reason is None:
        return
    if submission.held_reason != reason:
        message = f"it was held meanwhile: {submission.held_reason}; look at that before you release it"
        raise Conflict(message)
    submission.held_reason = None
    submission.version += 1
    session.flush()
    audit.record(
        session, actor=actor, action="submission.released", subject=audit.subject_of(submission), reason=reason
    )


def _twin(session: Session, submission: Submission, fingerprint: str) -> uuid.UUID | None:
    """Find the first scored submission of another team in the same phase whose predictions are nearly the same."""
    # The audits alone: the scores beside them are a hundred times as large, and this holds the writers' lock.
    query = (
        sa.select(Score.submission_id, Score.integrity)
        .join(Score.submission)
        .where(
            Submission.phase_id == submission.phase_id,
            Submission.team_id != submission.team_id,
            Score.integrity.is_not(None),
        )
        .order_by(Score.id)
    )
    return next(
        (
            other
            for other, findings in session.execute(query)
            if findings and similarity(fingerprint, findings["fingerprint"]) > SIMILARITY_LIMIT
        ),
        None,
    )
