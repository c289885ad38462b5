"""Submissions that maintainers left without a score when their phase was scored again, and why.

An exclusion holds on its ground truth: from the publication of its re-scoring until one is published that has the
submission's score. It begins in server/rescoring_decisions.py; server/rescoring.py carries it on.
"""

import uuid
from collections.abc import Collection

import sqlalchemy as sa
from sqlalchemy.orm import Session

from server.models import Rescoring, RescoringItem, RescoringState, Submission


def reasons(session: Session, ground_truth_id: int | None, submissions: Collection[uuid.UUID]) -> dict[uuid.UUID, str]:
    """Give the reasons of those among the submissions that are excluded on a ground truth."""
    query = (
        sa.select(RescoringItem.submission_id, RescoringItem.exclusion_reason)
        .join(RescoringItem.rescoring)
        .where(
            RescoringItem.submission_id.in_(submissions),
            Rescoring.state == RescoringState.PUBLISHED,
            Rescoring.ground_truth_id == ground_truth_id,
        )
        .order_by(RescoringItem.id)  # the latest re-scoring decides; where it has a score, its item has no reason
    )
    latest = dict(session.execute(query).all())
    return {submission_id: reason for submission_id, reason in latest.items() if reason is not None}


def reason(session: Session, submission: Submission) -> str | None:
    """Say why a submission does not rank on the ground truth in force, when a maintainer excluded it there."""
    return reasons(session, submission.phase.ground_truth_id, [submission.id]).get(submission.id)
