"""Add replicates of scores."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None

GUARDS = ("UPDATE", "DELETE")


def upgrade() -> None:
    """Apply."""
    op.create_table(
        "score_replicates",
        sa.Column("score_id", sa.Integer(), nullable=False),
        sa.Column("data", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(["score_id"], ["score.id"], name="fk_score_replicates_score_id"),
        sa.PrimaryKeyConstraint("score_id", name="pk_score_replicates"),
    )
    on_sqlite = op.get_bind().dialect.name == "sqlite"
    if not on_sqlite:
        op.execute(
            "CREATE FUNCTION score_replicates_kept() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN"
            " RAISE EXCEPTION 'replicates are append-only' USING ERRCODE = 'integrity_constraint_violation'; END $$"
        )
    for event in GUARDS:
        name = f"score_replicates_{event.lower()}"
        if on_sqlite:
            refuse = "BEGIN SELECT RAISE(ABORT, 'replicates are append-only'); END"
            op.execute(f"CREATE TRIGGER {name} BEFORE {event} ON score_replicates {refuse}")
        else:
            refuse = "FOR EACH ROW EXECUTE FUNCTION score_replicates_kept()"
            op.execute(f"CREATE TRIGGER {name} BEFORE {event} ON score_replicates {refuse}")


def downgrade() -> None:
    """Take back."""
    op.drop_table("score_replicates")
    if op.get_bind().dialect.name == "postgresql":
        op.execute("DROP FUNCTION score_replicates_kept()")
