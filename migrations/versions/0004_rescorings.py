"""Add re-scorings, the evaluator version in force, and versions of login sessions."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None

TIME = sa.DateTime(timezone=True)
RUNNING = sa.text("state = 'running'")

ITEM_TRANSITIONS = (
    "waiting>running",
    "waiting>excluded",
    "running>waiting",
    "running>done",
    "running>failed",
    "failed>waiting",
    "failed>excluded",
    "excluded>waiting",
)
ALLOWED = ", ".join(f"'{transition}'" for transition in ITEM_TRANSITIONS)

# (name, table, event, condition under which it refuses, message)
GUARDS = (
    ("rescoring_ends_once", "rescoring", "UPDATE", "OLD.state <> 'running'", "a re-scoring that ended never changes"),
    (
        "rescoring_identity",
        "rescoring",
        "UPDATE",
        (
            "OLD.phase_id <> NEW.phase_id OR OLD.ground_truth_id <> NEW.ground_truth_id"
            " OR OLD.protocol <> NEW.protocol OR OLD.evaluator_version <> NEW.evaluator_version"
        ),
        "what a re-scoring is never changes",
    ),
    ("rescoring_kept", "rescoring", "DELETE", "TRUE", "re-scorings are never deleted"),
    (
        "rescoring_item_transition",
        "rescoring_item",
        "UPDATE",
        f"OLD.state <> NEW.state AND (OLD.state || '>' || NEW.state) NOT IN ({ALLOWED})",
        "illegal change of an item''s state",
    ),
    (
        "rescoring_item_done_once",
        "rescoring_item",
        "UPDATE",
        "OLD.state = 'done'",
        "an item that is done never changes",
    ),
    (
        "rescoring_item_identity",
        "rescoring_item",
        "UPDATE",
        "OLD.rescoring_id <> NEW.rescoring_id OR OLD.submission_id <> NEW.submission_id",
        "what an item is never changes",
    ),
    (
        "rescoring_item_counts_up",
        "rescoring_item",
        "UPDATE",
        "NEW.attempt < OLD.attempt OR NEW.attempt > OLD.attempt + 1",
        "an item''s attempt only goes up",
    ),
    ("rescoring_item_kept", "rescoring_item", "DELETE", "TRUE", "items are never deleted"),
)


def upgrade() -> None:
    """Apply."""
    # Every score until here is of evaluator version 1.
    op.add_column("phase", sa.Column("evaluator_version", sa.String(length=16), nullable=False, server_default="1"))
    op.add_column("user_account", sa.Column("session_version", sa.Integer(), nullable=False, server_default="0"))
    _create_rescoring()
    _create_item()
    create = _create_sqlite if op.get_bind().dialect.name == "sqlite" else _create_postgresql
    for name, table, event, condition, message in GUARDS:
        create(name, table, event, condition, message)


def _create_rescoring() -> None:
    op.create_table(
        "rescoring",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("phase_id", sa.Integer(), nullable=False),
        sa.Column("ground_truth_id", sa.Integer(), nullable=False),
        sa.Column("protocol", sa.String(length=64), nullable=False),
        sa.Column("evaluator_version", sa.String(length=16), nullable=False),
        sa.Column("state", _enum("running", "published", "discarded", name="rescoring_state"), nullable=False),
        sa.Column("created_at", TIME, nullable=False),
        sa.Column("ended_at", TIME, nullable=True),
        sa.CheckConstraint("(state = 'running') = (ended_at IS NULL)", name="ended_at_matches"),
        sa.ForeignKeyConstraint(["ground_truth_id"], ["ground_truth.id"], name="fk_rescoring_ground_truth_id"),
        sa.ForeignKeyConstraint(["phase_id"], ["phase.id"], name="fk_rescoring_phase_id"),
        sa.PrimaryKeyConstraint("id", name="pk_rescoring"),
    )
    op.create_index(
        "uq_rescoring_running_phase",
        "rescoring",
        ["phase_id"],
        unique=True,
        sqlite_where=RUNNING,
        postgresql_where=RUNNING,
    )


def _create_item() -> None:
    op.create_table(
        "rescoring_item",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("rescoring_id", sa.Integer(), nullable=False),
        sa.Column("submission_id", sa.Uuid(), nullable=False),
        sa.Column(
            "state", _enum("waiting", "running", "done", "failed", "excluded", name="item_state"), nullable=False
        ),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("lost_attempts", sa.Integer(), nullable=False),
        sa.Column("lease_expires_at", TIME, nullable=True),
        sa.Column("enqueued_at", TIME, nullable=True),
        sa.Column("score_id", sa.Integer(), nullable=True),
        sa.Column("failure_code", sa.String(length=64), nullable=True),
        sa.Column("failure_detail", sa.Text(), nullable=True),
        sa.Column("exclusion_reason", sa.Text(), nullable=True),
        sa.CheckConstraint("(state = 'running') = (lease_expires_at IS NOT NULL)", name="running_has_lease"),
        sa.CheckConstraint("(state = 'done') = (score_id IS NOT NULL)", name="done_has_score"),
        sa.CheckConstraint("(state = 'failed') = (failure_code IS NOT NULL)", name="failure_code_matches"),
        sa.CheckConstraint("(state = 'excluded') = (exclusion_reason IS NOT NULL)", name="exclusion_reason_matches"),
        sa.CheckConstraint("lost_attempts BETWEEN 0 AND attempt", name="lost_attempts_happened"),
        sa.ForeignKeyConstraint(["rescoring_id"], ["rescoring.id"], name="fk_rescoring_item_rescoring_id"),
        sa.ForeignKeyConstraint(["score_id"], ["score.id"], name="fk_rescoring_item_score_id"),
        sa.ForeignKeyConstraint(["submission_id"], ["submission.id"], name="fk_rescoring_item_submission_id"),
        sa.PrimaryKeyConstraint("id", name="pk_rescoring_item"),
        sa.UniqueConstraint("rescoring_id", "submission_id", name="uq_rescoring_item_rescoring_id_submission_id"),
    )
    op.create_index("ix_rescoring_item_score_id", "rescoring_item", ["score_id"])
    op.create_index("ix_rescoring_item_state_lease_expires_at", "rescoring_item", ["state", "lease_expires_at"])
    op.create_index("ix_rescoring_item_submission_id", "rescoring_item", ["submission_id"])


def _enum(*values: str, name: str) -> sa.Enum:
    return sa.Enum(*values, name=name, native_enum=False, create_constraint=True, length=16)


def _create_sqlite(name: str, table: str, event: str, condition: str, message: str) -> None:
    op.execute(
        f"CREATE TRIGGER {name} BEFORE {event} ON {table} WHEN {condition} BEGIN SELECT RAISE(ABORT, '{message}'); END"
    )


def _create_postgresql(name: str, table: str, event: str, condition: str, message: str) -> None:
    row = "OLD" if event == "DELETE" else "NEW"
    op.execute(
        f"CREATE FUNCTION {name}() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN"
        f" IF {condition} THEN RAISE EXCEPTION '{message}' USING ERRCODE = 'integrity_constraint_violation'; END IF;"
        f" RETURN {row}; END $$"
    )
    op.execute(f"CREATE TRIGGER {name} BEFORE {event} ON {table} FOR EACH ROW EXECUTE FUNCTION {name}()")


def downgrade() -> None:
    """Take back."""
    op.drop_table("rescoring_item")
    op.drop_table("rescoring")
    if op.get_bind().dialect.name == "postgresql":
        for name, *_ in GUARDS:
            op.execute(f"DROP FUNCTION {name}()")
    op.drop_column("user_account", "session_version")
    op.drop_column("phase", "evaluator_version")
