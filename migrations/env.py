"""Alembic's entry point: runs migrations on the connection given by server/database.py, else on the settings' database.

Migrations are one transaction on both databases, so a migration that fails changes nothing. Two processes that
migrate at once wait for each other: SQLite by its write lock, PostgreSQL by an advisory lock. On PostgreSQL a
migration gives up waiting for a table's lock after `MIGRATION_LOCK_TIMEOUT` instead of blocking everybody behind it.
"""

import sqlalchemy as sa
from alembic import context

from server import database
from server.models import Base
from server.settings import Settings

ADVISORY_LOCK = 0x63733364
"""Any constant of our own ("cs3d")."""


def run_on(connection: sa.Connection) -> None:
    """Run what was asked for in one transaction."""
    context.configure(
        connection=connection,
        target_metadata=Base.metadata,
        transactional_ddl=True,
        render_as_batch=False,
        compare_type=True,
    )
    with connection.begin():
        if connection.dialect.name == "postgresql":
            connection.execute(sa.text("SELECT pg_advisory_xact_lock(:key)"), {"key": ADVISORY_LOCK})
            connection.execute(sa.text(f"SET LOCAL lock_timeout = '{database.MIGRATION_LOCK_TIMEOUT}'"))
        context.run_migrations()


given: sa.Connection | None = context.config.attributes.get("connection")
if given is not None:
    run_on(given)
else:
    with database.create_engine(Settings().database).connect() as opened:
        run_on(opened)
