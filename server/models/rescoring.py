"""Re-scorings: the scored submissions of a phase, scored again beside what ranks, then put in force all at once.

What happens to them is decided in server/rescoring.py and server/rescoring_items.py, not here.
"""

import uuid
from datetime import datetime
from enum import StrEnum

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column, relationship

from server.models.base import Base, checked_enum
from server.models.benchmarks import GroundTruthVersion, Phase
from server.models.submissions import Score, Submission


class RescoringState(StrEnum):
    """What became of a re-scoring."""

    RUNNING = "running"
    PUBLISHED = "published"
    """Its protocol, evaluator version and ground truth were put in force."""
    DISCARDED = "discarded"
    """Its scores stay in the record and are shown to nobody."""


class Rescoring(Base):
    """One re-scoring of a phase: what its submissions are to be scored under."""

    __tablename__ = "rescoring"

    id: Mapped[int] = mapped_column(primary_key=True)
    phase_id: Mapped[int] = mapped_column(sa.ForeignKey(Phase.id))
    ground_truth_id: Mapped[int] = mapped_column(sa.ForeignKey(GroundTruthVersion.id))
    protocol: Mapped[str] = mapped_column(sa.String(64))
    evaluator_version: Mapped[str] = mapped_column(sa.String(16))
    """Only workers with this evaluator take its items."""
    state: Mapped[RescoringState] = mapped_column(
        checked_enum(RescoringState, "rescoring_state"), default=RescoringState.RUNNING
    )
    created_at: Mapped[datetime]
    ended_at: Mapped[datetime | None]

    phase: Mapped[Phase] = relationship()
    ground_truth: Mapped[GroundTruthVersion] = relationship()

    __table_args__ = (
        # A phase is scored again in one way at a time.
        sa.Index(
            "uq_rescoring_running_phase",
            "phase_id",
            unique=True,
            sqlite_where=sa.text("state = 'running'"),
            postgresql_where=sa.text("state = 'running'"),
        ),
        sa.CheckConstraint("(state = 'running') = (ended_at IS NULL)", name="ended_at_matches"),
    )


class ItemState(StrEnum):
    """Where one submission is in a re-scoring. Its own state stays `scored`."""

    WAITING = "waiting"
    RUNNING = "running"
    """A worker holds the lease."""
    DONE = "done"
    FAILED = "failed"
    """Not scored; the cause is kept. A maintainer lets it be tried again or excludes it."""
    EXCLUDED = "excluded"
    """A maintainer decided that it does not rank under the new scores, with a reason."""


class RescoringItem(Base):
    """One submission of a re-scoring."""

    __tablename__ = "rescoring_item"

    id: Mapped[int] = mapped_column(primary_key=True)
    rescoring_id: Mapped[int] = mapped_column(sa.ForeignKey(Rescoring.id))
    submission_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey(Submission.id), index=True)
    state: Mapped[ItemState] = mapped_column(checked_enum(ItemState, "item_state"), default=ItemState.WAITING)
    attempt: Mapped[int] = mapped_column(default=0)
    """Number of the latest claim, the fence. A done item without any: the score was there before."""
    lost_attempts: Mapped[int] = mapped_column(default=0)
    """Attempts that count against the phase's cap."""
    lease_expires_at: Mapped[datetime | None]
    """Set exactly while a worker holds the item; the database's clock."""
    enqueued_at: Mapped[datetime | None]
    """When a message was last sent."""
    score_id: Mapped[int | None] = mapped_column(sa.ForeignKey(Score.id), index=True)
    failure_code: Mapped[str | None] = mapped_column(sa.String(64))
    failure_detail: Mapped[str | None]
    exclusion_reason: Mapped[str | None]

    rescoring: Mapped[Rescoring] = relationship()
    submission: Mapped[Submission] = relationship()
    score: Mapped[Score | None] = relationship()

    __table_args__ = (
        sa.UniqueConstraint("rescoring_id", "submission_id"),
        sa.Index(None, "state", "lease_expires_at"),
        sa.CheckConstraint("(state = 'running') = (lease_expires_at IS NOT NULL)", name="running_has_lease"),
        sa.CheckConstraint("(state = 'done') = (score_id IS NOT NULL)", name="done_has_score"),
        sa.CheckConstraint("(state = 'failed') = (failure_code IS NOT NULL)", name="failure_code_matches"),
        sa.CheckConstraint("(state = 'excluded') = (exclusion_reason IS NOT NULL)", name="exclusion_reason_matches"),
        sa.CheckConstraint("lost_attempts BETWEEN 0 AND attempt", name="lost_attempts_happened"),
    )
