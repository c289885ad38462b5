"""The record: every table, with the constraints that make illegal rows impossible.

Rows refer to bytes by digest through `Blob`; times are UTC; the quota and the audit trail are append-only.
What a submission may do next is decided in server/lifecycle.py, not here.
"""

import uuid
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any, ClassVar

import sqlalchemy as sa
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column, relationship

NAMING_CONVENTION = {
    "ix": "ix_%(table_name)s_%(column_0_N_name)s",
    "uq": "uq_%(table_name)s_%(column_0_N_name)s",
    "ck": "ck_%(table_name)s_%(constraint_name)s",
    "fk": "fk_%(table_name)s_%(column_0_N_name)s",
    "pk": "pk_%(table_name)s",
}


class UtcDateTime(sa.types.TypeDecorator[datetime]):
    """A timezone-aware UTC time on every database; SQLite has no zones, so it stores the bare UTC time."""

    impl = sa.DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: sa.Dialect) -> datetime | None:
        """Store UTC; a time without a zone is a mistake of the caller's."""
        if value is None:
            return None
        if value.tzinfo is None:
            message = f"{value!r} has no timezone; give an aware time"
            raise ValueError(message)
        value = value.astimezone(UTC)
        return value.replace(tzinfo=None) if dialect.name == "sqlite" else value

    def process_result_value(self, value: datetime | None, dialect: sa.Dialect) -> datetime | None:
        """Load UTC."""
        del dialect
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


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
    """Our fault: cause kept, quota given back, maintainers told, one click re-queues."""
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


class QuotaKind(StrEnum):
    """What an entry of the quota ledger does to a team's count in a phase."""

    RESERVE = "reserve"
    """+1 when a submission is received."""
    CHARGE = "charge"
    """0: the reservation became final, the submission is scored."""
    REFUND = "refund"
    """-1: rejected, failed or cancelled."""
    GRANT = "grant"
    """-n: a maintainer allows n more."""


def _enum(kind: type[StrEnum], name: str) -> sa.Enum:
    """Map a StrEnum to a checked string column that stores the values."""
    return sa.Enum(
        kind,
        name=name,
        native_enum=False,
        create_constraint=True,
        length=16,
        values_callable=lambda members: [member.value for member in members],
    )


class Base(DeclarativeBase):
    """The declarative base: naming convention and column types."""

    metadata = sa.MetaData(naming_convention=NAMING_CONVENTION)
    type_annotation_map: ClassVar[dict[Any, Any]] = {
        datetime: UtcDateTime(),
        dict[str, Any]: sa.JSON(),
        str: sa.Text(),
    }


Slug = sa.String(64)
Digest = sa.String(64)


class Blob(Base):
    """Bytes in the blob store, named by their SHA-256. A row exists only once the bytes are safe."""

    __tablename__ = "blob"

    sha256: Mapped[str] = mapped_column(Digest, primary_key=True)
    size_bytes: Mapped[int] = mapped_column(sa.BigInteger)
    created_at: Mapped[datetime]

    __table_args__ = (
        sa.CheckConstraint("size_bytes >= 0", name="size_not_negative"),
        sa.CheckConstraint("length(sha256) = 64", name="sha256_length"),
    )


class User(Base):
    """A person with an account."""

    __tablename__ = "user_account"

    id: Mapped[int] = mapped_column(primary_key=True)
    email: Mapped[str] = mapped_column(sa.String(254), unique=True)
    """Lower-cased."""
    name: Mapped[str] = mapped_column(sa.String(200))
    password_hash: Mapped[str | None]
    """Argon2id; None: cannot log in on the pages."""
    is_maintainer: Mapped[bool] = mapped_column(default=False)
    created_at: Mapped[datetime]
    disabled_at: Mapped[datetime | None]

    memberships: Mapped[list["Membership"]] = relationship(back_populates="user")


class Team(Base):
    """Who submits: quota, methods and submissions belong to a team."""

    __tablename__ = "team"

    id: Mapped[int] = mapped_column(primary_key=True)
    slug: Mapped[str] = mapped_column(Slug, unique=True)
    name: Mapped[str] = mapped_column(sa.String(200))
    created_at: Mapped[datetime]

    memberships: Mapped[list["Membership"]] = relationship(back_populates="team")


class Membership(Base):
    """A user in a team; every member may submit and publish for it."""

    __tablename__ = "membership"

    team_id: Mapped[int] = mapped_column(sa.ForeignKey(Team.id), primary_key=True)
    user_id: Mapped[int] = mapped_column(sa.ForeignKey(User.id), primary_key=True, index=True)
    created_at: Mapped[datetime]

    team: Mapped[Team] = relationship(back_populates="memberships")
    user: Mapped[User] = relationship(back_populates="memberships")


class Token(Base):
    """An API token of a user, acting for one team. Only the SHA-256 of the secret is kept."""

    __tablename__ = "token"

    id: Mapped[int] = mapped_column(primary_key=True)
    user_id: Mapped[int] = mapped_column(sa.ForeignKey(User.id), index=True)
    team_id: Mapped[int] = mapped_column(sa.ForeignKey(Team.id))
    name: Mapped[str] = mapped_column(sa.String(200))
    secret_sha256: Mapped[str] = mapped_column(Digest, unique=True)
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime | None]
    revoked_at: Mapped[datetime | None]

    user: Mapped[User] = relationship()
    team: Mapped[Team] = relationship()


class Benchmark(Base):
    """A task with its phases, for example `cityscapes3d`."""

    __tablename__ = "benchmark"

    id: Mapped[int] = mapped_column(primary_key=True)
    slug: Mapped[str] = mapped_column(Slug, unique=True)
    title: Mapped[str] = mapped_column(sa.String(200))
    description: Mapped[str] = mapped_column(default="")
    created_at: Mapped[datetime]

    phases: Mapped[list["Phase"]] = relationship(back_populates="benchmark", order_by="Phase.id")


class Phase(Base):
    """One set of ground truth with its rules, for example the hidden `test` or the open `val`."""

    __tablename__ = "phase"

    id: Mapped[int] = mapped_column(primary_key=True)
    benchmark_id: Mapped[int] = mapped_column(sa.ForeignKey(Benchmark.id))
    slug: Mapped[str] = mapped_column(Slug)
    title: Mapped[str] = mapped_column(sa.String(200))
    protocol: Mapped[str] = mapped_column(sa.String(64), default="cityscapes3d")
    """Name in `evaluator.protocol.PROTOCOLS`; it ranks."""
    is_open: Mapped[bool] = mapped_column(default=False)
    """Open ground truth: anybody may have it, so scores say little; scored before hidden phases' bulk work."""
    allows_publication: Mapped[bool] = mapped_column(default=True)
    opens_at: Mapped[datetime | None]
    closes_at: Mapped[datetime | None]
    submissions_per_day: Mapped[int] = mapped_column(default=10)
    """Scored or pending submissions of a team in any 24 hours."""
    rejections_per_day: Mapped[int] = mapped_column(default=50)
    """Rejected uploads of a team in any 24 hours."""
    max_attempts: Mapped[int] = mapped_column(default=3)
    """Claims by workers before a submission is failed."""
    ground_truth_id: Mapped[int | None] = mapped_column(
        sa.ForeignKey("ground_truth.id", use_alter=True, name="fk_phase_ground_truth_id")
    )
    """The version in force; None: the phase takes no submissions yet."""
    created_at: Mapped[datetime]

    benchmark: Mapped[Benchmark] = relationship(back_populates="phases")
    ground_truth: Mapped["GroundTruthVersion | None"] = relationship(foreign_keys=[ground_truth_id])

    __table_args__ = (
        sa.UniqueConstraint("benchmark_id", "slug"),
        sa.CheckConstraint("submissions_per_day >= 0", name="submissions_per_day_not_negative"),
        sa.CheckConstraint("rejections_per_day >= 0", name="rejections_per_day_not_negative"),
        sa.CheckConstraint("max_attempts >= 1", name="max_attempts_positive"),
    )


class GroundTruthVersion(Base):
    """One imported version of a phase's hidden ground truth."""

    __tablename__ = "ground_truth"

    id: Mapped[int] = mapped_column(primary_key=True)
    phase_id: Mapped[int] = mapped_column(sa.ForeignKey(Phase.id))
    version: Mapped[int]
    sha256: Mapped[str] = mapped_column(sa.ForeignKey(Blob.sha256))
    """Prepared arrays (`GroundTruth.to_bytes`); deterministic, so this digest names the ground truth in signatures."""
    source_sha256: Mapped[str] = mapped_column(sa.ForeignKey(Blob.sha256))
    """The imported files as one canonical zip."""
    image_list_sha256: Mapped[str] = mapped_column(sa.ForeignKey(Blob.sha256))
    """Public part, JSON: image names and their cameras. All that leaves the worker's side."""
    image_count: Mapped[int]
    box_count: Mapped[int]
    imported_by: Mapped[int | None] = mapped_column(sa.ForeignKey(User.id))
    created_at: Mapped[datetime]

    phase: Mapped[Phase] = relationship(foreign_keys=[phase_id])

    __table_args__ = (
        sa.UniqueConstraint("phase_id", "version"),
        sa.CheckConstraint("version >= 1", name="version_positive"),
    )


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
        _enum(SubmissionState, "submission_state"), default=SubmissionState.RECEIVED
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
    """What the worker is doing: `validating`, `scoring`, `recording`."""
    images_done: Mapped[int] = mapped_column(default=0)
    images_total: Mapped[int] = mapped_column(default=0)

    report_sha256: Mapped[str | None] = mapped_column(sa.ForeignKey(Blob.sha256))
    """`evaluator.report.Report` as JSON, once validated."""
    failure_code: Mapped[str | None] = mapped_column(sa.String(64))
    failure_detail: Mapped[str | None]

    publication: Mapped[Publication] = mapped_column(_enum(Publication, "publication"), default=Publication.PRIVATE)
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
        _enum(AttemptOutcome, "attempt_outcome"), default=AttemptOutcome.RUNNING
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


class QuotaEntry(Base):
    """One line of a team's ledger in a phase; append-only."""

    __tablename__ = "quota_entry"

    id: Mapped[int] = mapped_column(primary_key=True)
    team_id: Mapped[int] = mapped_column(sa.ForeignKey(Team.id))
    phase_id: Mapped[int] = mapped_column(sa.ForeignKey(Phase.id))
    submission_id: Mapped[uuid.UUID | None] = mapped_column(sa.ForeignKey(Submission.id))
    kind: Mapped[QuotaKind] = mapped_column(_enum(QuotaKind, "quota_kind"))
    amount: Mapped[int]
    reason: Mapped[str]
    created_at: Mapped[datetime]

    __table_args__ = (
        sa.Index(None, "team_id", "phase_id", "created_at"),
        sa.CheckConstraint(
            "(kind = 'reserve' AND amount = 1) OR (kind = 'charge' AND amount = 0)"
            " OR (kind = 'refund' AND amount = -1) OR (kind = 'grant' AND amount < 0)",
            name="amount_matches_kind",
        ),
        sa.CheckConstraint("(kind = 'grant') = (submission_id IS NULL)", name="submission_unless_grant"),
        # Reserved once, charged once, refunded once, whatever is delivered twice.
        sa.UniqueConstraint("submission_id", "kind"),
    )


class AuditEvent(Base):
    """One change, who made it and when; append-only."""

    __tablename__ = "audit_event"

    id: Mapped[int] = mapped_column(primary_key=True)
    at: Mapped[datetime]
    actor: Mapped[str] = mapped_column(sa.String(255))
    """`user:<id>`, `worker:<name>`, `sweeper`, `admin:<login>`."""
    action: Mapped[str] = mapped_column(sa.String(64))
    """For a change of state: `submission.<new state>`."""
    subject: Mapped[str] = mapped_column(sa.String(128), index=True)
    """`submission:<id>`, `phase:<id>`, ..."""
    detail: Mapped[dict[str, Any]]
