"""Add the shards in which submissions of very large phases are scored."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None

TIME = sa.DateTime(timezone=True)


def upgrade() -> None:
    """Apply."""
    # The constraint is the column's own, because SQLite adds no constraint to a table that exists.
    within = sa.CheckConstraint("shards BETWEEN 1 AND 64", name=op.f("ck_phase_shards_in_range"))
    op.add_column("phase", sa.Column("shards", sa.Integer(), within, nullable=False, server_default="1"))
    op.create_table(
        "shard",
        sa.Column("submission_id", sa.Uuid(), nullable=False),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("first_image", sa.Integer(), nullable=False),
        sa.Column("end_image", sa.Integer(), nullable=False),
        sa.Column("predictions_sha256", sa.String(length=64), nullable=False),
        sa.Column("ground_truth_sha256", sa.String(length=64), nullable=False),
        sa.Column("protocol", sa.String(length=64), nullable=False),
        sa.Column("claims", sa.Integer(), nullable=False),
        sa.Column("returned", sa.Integer(), nullable=False),
        sa.Column("worker", sa.String(length=255), nullable=True),
        sa.Column("lease_expires_at", TIME, nullable=True),
        sa.Column("result_sha256", sa.String(length=64), nullable=True),
        sa.Column("failure_code", sa.String(length=64), nullable=True),
        sa.Column("failure_detail", sa.Text(), nullable=True),
        sa.CheckConstraint("number >= 0", name=op.f("ck_shard_number_not_negative")),
        sa.CheckConstraint("first_image >= 0 AND first_image < end_image", name=op.f("ck_shard_has_images")),
        sa.CheckConstraint("returned BETWEEN 0 AND claims", name=op.f("ck_shard_returned_claims_happened")),
        sa.CheckConstraint("lease_expires_at IS NULL OR worker IS NOT NULL", name=op.f("ck_shard_lease_has_worker")),
        sa.CheckConstraint(
            "result_sha256 IS NULL OR lease_expires_at IS NULL", name=op.f("ck_shard_result_ends_lease")
        ),
        sa.CheckConstraint(
            "(failure_code IS NULL) = (failure_detail IS NULL)", name=op.f("ck_shard_failure_is_explained")
        ),
        sa.ForeignKeyConstraint(
            ["submission_id", "attempt"],
            ["attempt.submission_id", "attempt.number"],
            name="fk_shard_submission_id_attempt",
        ),
        sa.ForeignKeyConstraint(["ground_truth_sha256"], ["blob.sha256"], name="fk_shard_ground_truth_sha256"),
        sa.PrimaryKeyConstraint("submission_id", "attempt", "number", name="pk_shard"),
    )


def downgrade() -> None:
    """Take back."""
    op.drop_table("shard")
    op.drop_column("phase", "shards")
