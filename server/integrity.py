"""Holds a score back from ranking until a maintainer has looked, when the integrity audit gives a reason.

The audit itself is the evaluator's (`evaluator/integrity.py`); here it meets the other submissions and the record.
"""

import uuid

import msgspec
import sqlalchemy as sa
from sqlalchemy.orm import Session

from evaluator.fingerprint import similarities
from evaluator.integrity import SIMILARITY_LIMIT, IntegrityAudit
from server import audit
from server.errors import Conflict
from server.models import Score, Submission

BATCH = 1000
"""Fingerprints, of 2 kB each, that are held in memory at a time."""

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
    """Find the first submission of another team in the same phase whose predictions are nearly the same."""
    # This holds the writers' lock. A fingerprint is of the predictions, so one score of each submission will do; and no
    # more of it than that: the rest is a hundred times as large.
    latest = sa.select(sa.func.max(Score.id)).group_by(Score.submission_id)
    query = (
        sa.select(Submission.id, Score.integrity["fingerprint"].as_string())
        .join(Score.submission)
        .where(
            Submission.phase_id == submission.phase_id,
            Submission.team_id != submission.team_id,
            Score.id.in_(latest),
        )
        .order_by(Submission.created_at, Submission.id)
        .execution_options(yield_per=BATCH)
    )
    with session.execute(query) as found:
        for batch in found.partitions():
            alike = similarities(fingerprint, [other or "" for _, other in batch]) > SIMILARITY_LIMIT
            if alike.any():
                twin: uuid.UUID = batch[int(alike.argmax())][0]
                return twin
    return None
