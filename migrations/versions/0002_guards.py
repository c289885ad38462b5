"""Guard the record in the database itself: state transitions, fences and append-only tables, by trigger."""

from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

TRANSITIONS = (
    "received>queued",
    "received>rejected",
    "received>failed",
    "received>cancelled",
    "queued>scoring",
    "queued>cancelled",
    "scoring>queued",
    "scoring>scored",
    "scoring>rejected",
    "scoring>failed",
    "failed>received",
    "failed>queued",
)
ALLOWED = ", ".join(f"'{transition}'" for transition in TRANSITIONS)

# (name, table, event, condition under which it refuses, message)
GUARDS = (
    (
        "submission_starts_received",
        "submission",
        "INSERT",
        "NEW.state <> 'received' OR NEW.attempt <> 0 OR NEW.publication <> 'private'",
        "a submission starts received, private and without attempts",
    ),
    (
        "submission_transition",
        "submission",
        "UPDATE",
        f"OLD.state <> NEW.state AND (OLD.state || '>' || NEW.state) NOT IN ({ALLOWED})",
        "illegal change of a submission''s state",
    ),
    (
        "submission_scored_has_score",
        "submission",
        "UPDATE",
        (
            "OLD.state <> 'scored' AND NEW.state = 'scored' AND NOT EXISTS (SELECT 1 FROM score"
            " WHERE score.submission_id = NEW.id AND score.attempt = NEW.attempt)"
        ),
        "a submission is scored only by a score of its latest attempt",
    ),
    (
        "submission_identity",
        "submission",
        "UPDATE",
        (
            "OLD.id <> NEW.id OR OLD.phase_id <> NEW.phase_id OR OLD.method_id <> NEW.method_id"
            " OR OLD.team_id <> NEW.team_id OR OLD.user_id <> NEW.user_id OR OLD.created_at <> NEW.created_at"
            " OR OLD.predictions_sha256 <> NEW.predictions_sha256"
        ),
        "what a submission is never changes",
    ),
    (
        "submission_counts_up",
        "submission",
        "UPDATE",
        "NEW.attempt < OLD.attempt OR NEW.attempt > OLD.attempt + 1 OR NEW.version < OLD.version",
        "a submission''s attempt and version only go up",
    ),
    (
        "attempt_ends_once",
        "attempt",
        "UPDATE",
        "OLD.outcome <> 'running'",
        "an attempt that ended never changes",
    ),
    ("ground_truth_unchanged", "ground_truth", "UPDATE", "TRUE", "a version of ground truth never changes"),
    ("score_unchanged", "score", "UPDATE", "TRUE", "scores are append-only"),
    ("quota_entry_unchanged", "quota_entry", "UPDATE", "TRUE", "the quota ledger is append-only"),
    ("audit_event_unchanged", "audit_event", "UPDATE", "TRUE", "the audit trail is append-only"),
    ("submission_kept", "submission", "DELETE", "TRUE", "submissions are never deleted"),
    ("attempt_kept", "attempt", "DELETE", "TRUE", "attempts are never deleted"),
    ("ground_truth_kept", "ground_truth", "DELETE", "TRUE", "ground truth is never deleted"),
    ("score_kept", "score", "DELETE", "TRUE", "scores are append-only"),
    ("quota_entry_kept", "quota_entry", "DELETE", "TRUE", "the quota ledger is append-only"),
    ("audit_event_kept", "audit_event", "DELETE", "TRUE", "the audit trail is append-only"),
)


def upgrade() -> None:
    """Create the triggers."""
    create = _create_sqlite if op.get_bind().dialect.name == "sqlite" else _create_postgresql
    for name, table, event, condition, message in GUARDS:
        create(name, table, event, condition, message)


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
    """Drop the triggers."""
    on_postgresql = op.get_bind().dialect.name == "postgresql"
    for name, table, *_ in GUARDS:
        if on_postgresql:
            op.execute(f"DROP TRIGGER {name} ON {table}")
            op.execute(f"DROP FUNCTION {name}()")
        else:
            op.execute(f"DROP TRIGGER {name}")
