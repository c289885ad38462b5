"""Methods and submissions: uploads, attempts and scores.

What a submission may do next is decided in server/lifecycle.py, not here.
"""

import uuid
from datetime import datetime
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column, relationship

from server.models.base import Base, Blob, Digest, Slug, checked_enum
from server.models.benchmarks import GroundTruthVersion, Phase
from server.models.people import Team, User

if TYPE_CHECKING:  # it is made of scores
    from server.models.replicates import ScoreReplicates


class SubmissionState(StrEnum):
    """Where a submission is in its life (docs/architecture.md)."""

    RECEIVED = "received"
    """Its bytes are safe; they are not validated."""
    QUEUED = "queued"
    """Validated; waits for scoring."""
    SCORING = "scoring"
    """A worker holds the lease."""
    SCORED = "scored"
    REJECTED = "rejected"
    """The predictions have errors: the participant's fault, full report, quota given back."""
    FAILED = "failed"
    """Our fault: cause kept, quota given back, maintainers told; `cs3d-admin requeue` tries again."""
    CANCELLED = "cancelled"
    """Withdrawn by its owner before scoring."""

    @property
    def terminal(self) -> bool:
        """True when nothing happens to the submission by itself any more."""
        return self in TERMINAL_STATES


TERMINAL_STATES = frozenset(
    {SubmissionState.SCORED, SubmissionState.REJECTED, SubmissionState.FAILED, SubmissionState.CANCELLED}
)


class Publication(StrEnum):
    """Who sees a submission's scores. Never a state of scoring."""

    PRIVATE = "private"
    PUBLISHED = "published"
    WITHDRAWN = "withdrawn"


class Method(Base):
    """What is ranked: a team's approach, shown in one row of a leaderboard by its published submission."""

    __tablename__ = "method"

    id: Mapped[int] = mapped_column(primary_key=True)
    team_id: Mapped[int] = mapped_column(sa.ForeignKey(Team.id))
    slug: Mapped[str] = mapped_column(Slug)
    name: Mapped[str] = mapped_column(sa.String(200))
    description: Mapped[str] = mapped_column(default="")
    paper_url: Mapped[str | None]
    code_url: Mapped[str | None]
    created_at: Mapped[datetime]

    team: Mapped[Team] = relationship()

    __table_args__ = (sa.UniqueConstraint("team_id", "slug"),)


class Submission(Base):
    """One upload and its life. The row says what is true, whatever crashes."""

    __tablename__ = "submission"

    id: Mapped[uuid.UUID] = mapped_column(primary_key=True, default=uuid.uuid4)
    phase_id: Mapped[int] = mapped_column(sa.ForeignKey(Phase.id))
    method_id: Mapped[int] = mapped_column(sa.ForeignKey(Method.id), index=True)
    team_id: Mapped[int] = mapped_column(sa.ForeignKey(Team.id))
    user_id: Mapped[int] = mapped_column(sa.ForeignKey(User.id))
    predictions_sha256: Mapped[str] = mapped_column(sa.ForeignKey(Blob.sha256))
    file_name: Mapped[str] = mapped_column(sa.String(255))
    """As the uploader named it; shown, never used as a path."""
    created_at: Mapped[datetime]

    state: Mapped[SubmissionState] = mapped_column(
        checked_enum(SubmissionState, "submission_state"), default=SubmissionState.RECEIVED
    )
    state_changed_at: Mapped[datetime]
    version: Mapped[int] = mapped_column(default=1)
    """Raised by every visible change; the ETag."""
    attempt: Mapped[int] = mapped_column(default=0)
    """Number of the latest claim: the fence every write of a worker carries."""
    forgiven_attempts: Mapped[int] = mapped_column(default=0)
    """Attempts up to this number no longer count against the phase's cap: a maintainer re-queued."""
    idempotency_key: Mapped[str | None] = mapped_column(sa.String(255))
    """Chosen by the uploader; the same key again gives the same submission."""
    lease_expires_at: Mapped[datetime | None]
    """Set exactly while a worker holds the submission; the database's clock."""
    enqueued_at: Mapped[datetime | None]
    """When a message was last sent; the sweeper sends again what stays unclaimed."""
    stage: Mapped[str | None] = mapped_column(sa.String(32))
    """What the worker is doing: `validating` or `scoring`; None while no worker holds it."""
    images_done: Mapped[int] = mapped_column(default=0)
    images_total: Mapped[int] = mapped_column(default=0)

    report_sha256: Mapped[str | None] = mapped_column(sa.ForeignKey(Blob.sha256))
    """`evaluator.report.Report` as JSON, once validated."""
    failure_code: Mapped[str | None] = mapped_column(sa.String(64))
    failure_detail: Mapped[str | None]

    publication: Mapped[Publication] = mapped_column(
        checked_enum(Publication, "publication"), default=Publication.PRIVATE
    )
    published_at: Mapped[datetime | None]
    held_reason: Mapped[str | None]
    """Why a maintainer must look before it may be published; None: there is no reason, or it was released."""

    phase: Mapped[Phase] = relationship()
    method: Mapped[Method] = relationship()
    team: Mapped[Team] = relationship()
    user: Mapped[User] = relationship()
    scores: Mapped[list["Score"]] = relationship(back_populates="submission", order_by="Score.id")
    attempts: Mapped[list["Attempt"]] = relationship(back_populates="submission", order_by="Attempt.number")

    __table_args__ = (
        sa.Index(None, "state", "lease_expires_at"),
        sa.Index(None, "phase_id", "publication"),
        sa.Index(None, "team_id", "created_at"),
        # A method has one row on a leaderboard.
        sa.Index(
            "uq_submission_published_method",
            "phase_id",
            "method_id",
            unique=True,
            sqlite_where=sa.text("publication = 'published'"),
            postgresql_where=sa.text("publication = 'published'"),
        ),
        sa.CheckConstraint("publication <> 'published' OR state = 'scored'", name="published_is_scored"),
        sa.CheckConstraint("publication <> 'published' OR held_reason IS NULL", name="published_is_not_held"),
        sa.CheckConstraint("(publication = 'private') = (published_at IS NULL)", name="published_at_matches"),
        sa.CheckConstraint("state <> 'scoring' OR lease_expires_at IS NOT NULL", name="scoring_has_lease"),
        sa.CheckConstraint(
            "lease_expires_at IS NULL OR state IN ('received', 'scoring')", name="lease_only_while_worked_on"
        ),
        sa.CheckConstraint("(state = 'failed') = (failure_code IS NOT NULL)", name="failure_code_matches"),
        sa.CheckConstraint("state NOT IN ('rejected', 'scored') OR report_sha256 IS NOT NULL", name="report_kept"),
        sa.CheckConstraint("attempt >= 0", name="attempt_not_negative"),
        sa.CheckConstraint("forgiven_attempts BETWEEN 0 AND attempt", name="forgiven_attempts_happened"),
        sa.UniqueConstraint("user_id", "idempotency_key"),
    )


class Upload(Base):
    """A resumable upload: an archive that arrives in parts. It has its own life and ends as a submission or expires."""

    __tablename__ = "upload"

    id: Mapped[uuid.UUID] = mapped_column(primary_key=True, default=uuid.uuid4)
    user_id: Mapped[int] = mapped_column(sa.ForeignKey(User.id))
    team_id: Mapped[int] = mapped_column(sa.ForeignKey(Team.id), index=True)
    fields: Mapped[dict[str, Any]]
    """What the sender wants done with the archive: phase, method and their like."""
    length_bytes: Mapped[int] = mapped_column(sa.BigInteger)
    offset_bytes: Mapped[int] = mapped_column(sa.BigInteger, default=0)
    """So many bytes are on the disk; what the part file holds beyond is not safe and is cut off."""
    sha256: Mapped[str | None] = mapped_column(Digest)
    """Announced by the sender for the whole archive."""
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime] = mapped_column(index=True)
    submission_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey(Submission.id))
    """What it became."""

    team: Mapped[Team] = relationship()
    user: Mapped[User] = relationship()

    __table_args__ = (
        sa.CheckConstraint("offset_bytes BETWEEN 0 AND length_bytes", name="offset_within_length"),
        sa.CheckConstraint("submission_id IS NULL OR offset_bytes = length_bytes", name="submission_of_whole"),
    )


class AttemptOutcome(StrEnum):
    """How a worker's hold on a submission ended."""

    RUNNING = "running"
    SCORED = "scored"
    REJECTED = "rejected"
    FAILED = "failed"
    LOST = "lost"
    """The lease expired or the scoring process died; counts against the phase's cap."""
    RETURNED = "returned"
    """The worker gave the submission back unharmed (it was told to stop), or the owner cancelled; does not count."""


class Attempt(Base):
    """One claim of a submission by a worker."""

    __tablename__ = "attempt"

    submission_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey(Submission.id), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True)
    worker: Mapped[str] = mapped_column(sa.String(255))
    outcome: Mapped[AttemptOutcome] = mapped_column(
        checked_enum(AttemptOutcome, "attempt_outcome"), default=AttemptOutcome.RUNNING
    )
    detail: Mapped[str | None]
    started_at: Mapped[datetime]
    ended_at: Mapped[datetime | None]

    submission: Mapped[Submission] = relationship(back_populates="attempts")

    __table_args__ = (sa.CheckConstraint("(outcome = 'running') = (ended_at IS NULL)", name="ended_at_matches"),)


class Score(Base):
    """The result of one submission under one protocol, evaluator version and ground truth. Never overwritten."""

    __tablename__ = "score"

    id: Mapped[int] = mapped_column(primary_key=True)
    submission_id: Mapped[uuid.UUID] = mapped_column(sa.ForeignKey(Submission.id))
    protocol: Mapped[str] = mapped_column(sa.String(64))
    protocol_version: Mapped[str] = mapped_column(sa.String(16))
    evaluator_version: Mapped[str] = mapped_column(sa.String(16))
    ground_truth_id: Mapped[int] = mapped_column(sa.ForeignKey(GroundTruthVersion.id))
    attempt: Mapped[int]
    """Of the submission, or of the re-scoring's item that made it."""
    mds: Mapped[float | None] = mapped_column(sa.Double)
    """None: undefined, ranked last."""
    summary: Mapped[dict[str, Any]]
    """The `Scores` without recall and precision lists: what leaderboards show."""
    scores_sha256: Mapped[str] = mapped_column(sa.ForeignKey(Blob.sha256))
    """The whole `evaluator.results.Scores` as JSON."""
    statistics_sha256: Mapped[str | None] = mapped_column(sa.ForeignKey(Blob.sha256))
    """Per-image statistics, for uncertainty and diagnosis. Never leaves the worker's side."""
    integrity: Mapped[dict[str, Any] | None]
    """The `evaluator.integrity.IntegrityAudit`: for the team and the maintainers only."""
    created_at: Mapped[datetime]

    submission: Mapped[Submission] = relationship(back_populates="scores")
    ground_truth: Mapped[GroundTruthVersion] = relationship()
    replicates: Mapped["ScoreReplicates | None"] = relationship(back_populates="score")

    __table_args__ = (
        sa.UniqueConstraint(
            "submission_id",
            "protocol",
            "protocol_version",
            "evaluator_version",
            "ground_truth_id",
            name="uq_score_signature",
        ),
    )
