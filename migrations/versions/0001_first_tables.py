"""Create every table of the record."""

from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

TIME = sa.DateTime(timezone=True)
ENUM: dict[str, Any] = {"native_enum": False, "create_constraint": True, "length": 16}
TABLES = (
    "score",
    "quota_entry",
    "attempt",
    "submission",
    "ground_truth",
    "token",
    "phase",
    "method",
    "membership",
    "user_account",
    "team",
    "blob",
    "benchmark",
    "audit_event",
)
"""In the order in which they can be dropped."""


def upgrade() -> None:
    """Apply."""
    op.create_table(
        "audit_event",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("at", TIME, nullable=False),
        sa.Column("actor", sa.String(length=255), nullable=False),
        sa.Column("action", sa.String(length=64), nullable=False),
        sa.Column("subject", sa.String(length=128), nullable=False),
        sa.Column("detail", sa.JSON(), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_audit_event"),
    )
    op.create_index("ix_audit_event_subject", "audit_event", ["subject"], unique=False)
    op.create_table(
        "benchmark",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("slug", sa.String(length=64), nullable=False),
        sa.Column("title", sa.String(length=200), nullable=False),
        sa.Column("description", sa.Text(), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_benchmark"),
        sa.UniqueConstraint("slug", name="uq_benchmark_slug"),
    )
    op.create_table(
        "blob",
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        sa.CheckConstraint("length(sha256) = 64", name="sha256_length"),
        sa.CheckConstraint("size_bytes >= 0", name="size_not_negative"),
        sa.PrimaryKeyConstraint("sha256", name="pk_blob"),
    )
    op.create_table(
        "team",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("slug", sa.String(length=64), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_team"),
        sa.UniqueConstraint("slug", name="uq_team_slug"),
    )
    op.create_table(
        "user_account",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("email", sa.String(length=254), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("password_hash", sa.Text(), nullable=True),
        sa.Column("is_maintainer", sa.Boolean(), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        sa.Column("disabled_at", TIME, nullable=True),
        sa.PrimaryKeyConstraint("id", name="pk_user_account"),
        sa.UniqueConstraint("email", name="uq_user_account_email"),
    )
    op.create_table(
        "membership",
        sa.Column("team_id", sa.Integer(), nullable=False),
        sa.Column("user_id", sa.Integer(), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        sa.ForeignKeyConstraint(["team_id"], ["team.id"], name="fk_membership_team_id"),
        sa.ForeignKeyConstraint(["user_id"], ["user_account.id"], name="fk_membership_user_id"),
        sa.PrimaryKeyConstraint("team_id", "user_id", name="pk_membership"),
    )
    op.create_index("ix_membership_user_id", "membership", ["user_id"], unique=False)
    op.create_table(
        "method",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("team_id", sa.Integer(), nullable=False),
        sa.Column("slug", sa.String(length=64), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("description", sa.Text(), nullable=False),
        sa.Column("paper_url", sa.Text(), nullable=True),
        sa.Column("code_url", sa.Text(), nullable=True),
        sa.Column("created_at", TIME, nullable=False),
        sa.ForeignKeyConstraint(["team_id"], ["team.id"], name="fk_method_team_id"),
        sa.PrimaryKeyConstraint("id", name="pk_method"),
        sa.UniqueConstraint("team_id", "slug", name="uq_method_team_id_slug"),
    )
    op.create_table(
        "phase",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("benchmark_id", sa.Integer(), nullable=False),
        sa.Column("slug", sa.String(length=64), nullable=False),
        sa.Column("title", sa.String(length=200), nullable=False),
        sa.Column("protocol", sa.String(length=64), nullable=False),
        sa.Column("is_open", sa.Boolean(), nullable=False),
        sa.Column("allows_publication", sa.Boolean(), nullable=False),
        sa.Column("opens_at", TIME, nullable=True),
        sa.Column("closes_at", TIME, nullable=True),
        sa.Column("submissions_per_day", sa.Integer(), nullable=False),
        sa.Column("rejections_per_day", sa.Integer(), nullable=False),
        sa.Column("max_attempts", sa.Integer(), nullable=False),
        sa.Column("ground_truth_id", sa.Integer(), nullable=True),
        sa.Column("created_at", TIME, nullable=False),
        sa.CheckConstraint("max_attempts >= 1", name="max_attempts_positive"),
        sa.CheckConstraint("rejections_per_day >= 0", name="rejections_per_day_not_negative"),
        sa.CheckConstraint("submissions_per_day >= 0", name="submissions_per_day_not_negative"),
        sa.ForeignKeyConstraint(["benchmark_id"], ["benchmark.id"], name="fk_phase_benchmark_id"),
        sa.ForeignKeyConstraint(
            ["ground_truth_id"], ["ground_truth.id"], name="fk_phase_ground_truth_id", use_alter=True
        ),
        sa.PrimaryKeyConstraint("id", name="pk_phase"),
        sa.UniqueConstraint("benchmark_id", "slug", name="uq_phase_benchmark_id_slug"),
    )
    op.create_table(
        "token",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("user_id", sa.Integer(), nullable=False),
        sa.Column("team_id", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("secret_sha256", sa.String(length=64), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        sa.Column("expires_at", TIME, nullable=True),
        sa.Column("revoked_at", TIME, nullable=True),
        sa.ForeignKeyConstraint(["team_id"], ["team.id"], name="fk_token_team_id"),
        sa.ForeignKeyConstraint(["user_id"], ["user_account.id"], name="fk_token_user_id"),
        sa.PrimaryKeyConstraint("id", name="pk_token"),
        sa.UniqueConstraint("secret_sha256", name="uq_token_secret_sha256"),
    )
    op.create_index("ix_token_user_id", "token", ["user_id"], unique=False)
    op.create_table(
        "ground_truth",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("phase_id", sa.Integer(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("source_sha256", sa.String(length=64), nullable=False),
        sa.Column("image_list_sha256", sa.String(length=64), nullable=False),
        sa.Column("image_count", sa.Integer(), nullable=False),
        sa.Column("box_count", sa.Integer(), nullable=False),
        sa.Column("imported_by", sa.Integer(), nullable=True),
        sa.Column("created_at", TIME, nullable=False),
        sa.CheckConstraint("version >= 1", name="version_positive"),
        sa.ForeignKeyConstraint(["image_list_sha256"], ["blob.sha256"], name="fk_ground_truth_image_list_sha256"),
        sa.ForeignKeyConstraint(["imported_by"], ["user_account.id"], name="fk_ground_truth_imported_by"),
        sa.ForeignKeyConstraint(["phase_id"], ["phase.id"], name="fk_ground_truth_phase_id"),
        sa.ForeignKeyConstraint(["sha256"], ["blob.sha256"], name="fk_ground_truth_sha256"),
        sa.ForeignKeyConstraint(["source_sha256"], ["blob.sha256"], name="fk_ground_truth_source_sha256"),
        sa.PrimaryKeyConstraint("id", name="pk_ground_truth"),
        sa.UniqueConstraint("phase_id", "version", name="uq_ground_truth_phase_id_version"),
    )
    if op.get_bind().dialect.name != "sqlite":  # there it stands in the table already
        op.create_foreign_key("fk_phase_ground_truth_id", "phase", "ground_truth", ["ground_truth_id"], ["id"])
    op.create_table(
        "submission",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("phase_id", sa.Integer(), nullable=False),
        sa.Column("method_id", sa.Integer(), nullable=False),
        sa.Column("team_id", sa.Integer(), nullable=False),
        sa.Column("user_id", sa.Integer(), nullable=False),
        sa.Column("predictions_sha256", sa.String(length=64), nullable=False),
        sa.Column("file_name", sa.String(length=255), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        sa.Column(
            "state",
            sa.Enum(
                "received",
                "queued",
                "scoring",
                "scored",
                "rejected",
                "failed",
                "cancelled",
                name="submission_state",
                **ENUM,
            ),
            nullable=False,
        ),
        sa.Column("state_changed_at", TIME, nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("forgiven_attempts", sa.Integer(), nullable=False),
        sa.Column("idempotency_key", sa.String(length=255), nullable=True),
        sa.Column("lease_expires_at", TIME, nullable=True),
        sa.Column("enqueued_at", TIME, nullable=True),
        sa.Column("stage", sa.String(length=32), nullable=True),
        sa.Column("images_done", sa.Integer(), nullable=False),
        sa.Column("images_total", sa.Integer(), nullable=False),
        sa.Column("report_sha256", sa.String(length=64), nullable=True),
        sa.Column("failure_code", sa.String(length=64), nullable=True),
        sa.Column("failure_detail", sa.Text(), nullable=True),
        sa.Column(
            "publication", sa.Enum("private", "published", "withdrawn", name="publication", **ENUM), nullable=False
        ),
        sa.Column("published_at", TIME, nullable=True),
        sa.Column("held_reason", sa.Text(), nullable=True),
        sa.CheckConstraint("(publication = 'private') = (published_at IS NULL)", name="published_at_matches"),
        sa.CheckConstraint("(state = 'failed') = (failure_code IS NOT NULL)", name="failure_code_matches"),
        sa.CheckConstraint(
            "lease_expires_at IS NULL OR state IN ('received', 'scoring')",
            name="lease_only_while_worked_on",
        ),
        sa.CheckConstraint("publication <> 'published' OR held_reason IS NULL", name="published_is_not_held"),
        sa.CheckConstraint("publication <> 'published' OR state = 'scored'", name="published_is_scored"),
        sa.CheckConstraint("state <> 'scoring' OR lease_expires_at IS NOT NULL", name="scoring_has_lease"),
        sa.CheckConstraint("state NOT IN ('rejected', 'scored') OR report_sha256 IS NOT NULL", name="report_kept"),
        sa.CheckConstraint("attempt >= 0", name="attempt_not_negative"),
        sa.CheckConstraint("forgiven_attempts BETWEEN 0 AND attempt", name="forgiven_attempts_happened"),
        sa.ForeignKeyConstraint(["method_id"], ["method.id"], name="fk_submission_method_id"),
        sa.ForeignKeyConstraint(["phase_id"], ["phase.id"], name="fk_submission_phase_id"),
        sa.ForeignKeyConstraint(["predictions_sha256"], ["blob.sha256"], name="fk_submission_predictions_sha256"),
        sa.ForeignKeyConstraint(["report_sha256"], ["blob.sha256"], name="fk_submission_report_sha256"),
        sa.ForeignKeyConstraint(["team_id"], ["team.id"], name="fk_submission_team_id"),
        sa.ForeignKeyConstraint(["user_id"], ["user_account.id"], name="fk_submission_user_id"),
        sa.PrimaryKeyConstraint("id", name="pk_submission"),
        sa.UniqueConstraint("user_id", "idempotency_key", name="uq_submission_user_id_idempotency_key"),
    )
    op.create_index("ix_submission_method_id", "submission", ["method_id"], unique=False)
    op.create_index("ix_submission_phase_id_publication", "submission", ["phase_id", "publication"], unique=False)
    op.create_index("ix_submission_state_lease_expires_at", "submission", ["state", "lease_expires_at"], unique=False)
    op.create_index("ix_submission_team_id_created_at", "submission", ["team_id", "created_at"], unique=False)
    op.create_index(
        "uq_submission_published_method",
        "submission",
        ["phase_id", "method_id"],
        unique=True,
        sqlite_where=sa.text("publication = 'published'"),
        postgresql_where=sa.text("publication = 'published'"),
    )
    op.create_table(
        "attempt",
        sa.Column("submission_id", sa.Uuid(), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("worker", sa.String(length=255), nullable=False),
        sa.Column(
            "outcome",
            sa.Enum("running", "scored", "rejected", "failed", "lost", "returned", name="attempt_outcome", **ENUM),
            nullable=False,
        ),
        sa.Column("detail", sa.Text(), nullable=True),
        sa.Column("started_at", TIME, nullable=False),
        sa.Column("ended_at", TIME, nullable=True),
        sa.CheckConstraint("(outcome = 'running') = (ended_at IS NULL)", name="ended_at_matches"),
        sa.ForeignKeyConstraint(["submission_id"], ["submission.id"], name="fk_attempt_submission_id"),
        sa.PrimaryKeyConstraint("submission_id", "number", name="pk_attempt"),
    )
    op.create_table(
        "quota_entry",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("team_id", sa.Integer(), nullable=False),
        sa.Column("phase_id", sa.Integer(), nullable=False),
        sa.Column("submission_id", sa.Uuid(), nullable=True),
        sa.Column("kind", sa.Enum("reserve", "charge", "refund", "grant", name="quota_kind", **ENUM), nullable=False),
        sa.Column("amount", sa.Integer(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        sa.CheckConstraint("(kind = 'grant') = (submission_id IS NULL)", name="submission_unless_grant"),
        sa.CheckConstraint(
            "(kind = 'reserve' AND amount = 1) OR (kind = 'charge' AND amount = 0) OR (kind = 'refund' AND amount = -1) OR (kind = 'grant' AND amount < 0)",
            name="amount_matches_kind",
        ),
        sa.ForeignKeyConstraint(["phase_id"], ["phase.id"], name="fk_quota_entry_phase_id"),
        sa.ForeignKeyConstraint(["submission_id"], ["submission.id"], name="fk_quota_entry_submission_id"),
        sa.ForeignKeyConstraint(["team_id"], ["team.id"], name="fk_quota_entry_team_id"),
        sa.PrimaryKeyConstraint("id", name="pk_quota_entry"),
        sa.UniqueConstraint("submission_id", "kind", name="uq_quota_entry_submission_id_kind"),
    )
    op.create_index(
        "ix_quota_entry_team_id_phase_id_created_at", "quota_entry", ["team_id", "phase_id", "created_at"], unique=False
    )
    op.create_table(
        "score",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("submission_id", sa.Uuid(), nullable=False),
        sa.Column("protocol", sa.String(length=64), nullable=False),
        sa.Column("protocol_version", sa.String(length=16), nullable=False),
        sa.Column("evaluator_version", sa.String(length=16), nullable=False),
        sa.Column("ground_truth_id", sa.Integer(), nullable=False),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("mds", sa.Double(), nullable=True),
        sa.Column("summary", sa.JSON(), nullable=False),
        sa.Column("scores_sha256", sa.String(length=64), nullable=False),
        sa.Column("statistics_sha256", sa.String(length=64), nullable=True),
        sa.Column("integrity", sa.JSON(), nullable=True),
        sa.Column("created_at", TIME, nullable=False),
        sa.ForeignKeyConstraint(["ground_truth_id"], ["ground_truth.id"], name="fk_score_ground_truth_id"),
        sa.ForeignKeyConstraint(["scores_sha256"], ["blob.sha256"], name="fk_score_scores_sha256"),
        sa.ForeignKeyConstraint(["statistics_sha256"], ["blob.sha256"], name="fk_score_statistics_sha256"),
        sa.ForeignKeyConstraint(["submission_id"], ["submission.id"], name="fk_score_submission_id"),
        sa.PrimaryKeyConstraint("id", name="pk_score"),
        sa.UniqueConstraint(
            "submission_id",
            "protocol",
            "protocol_version",
            "evaluator_version",
            "ground_truth_id",
            name="uq_score_signature",
        ),
    )


def downgrade() -> None:
    """Drop every table; phases and their ground truth refer to each other, so that knot is cut first."""
    op.execute("UPDATE phase SET ground_truth_id = NULL")
    if op.get_bind().dialect.name != "sqlite":
        op.drop_constraint("fk_phase_ground_truth_id", "phase", type_="foreignkey")
    for table in TABLES:
        op.drop_table(table)
