"""${message}.

Keep it one transaction that runs on SQLite and PostgreSQL. Add a column as nullable first and fill it in a later step;
on PostgreSQL take no lock that blocks writers for long (see env.py); write the downgrade and run the migration tests.
"""

import sqlalchemy as sa
from alembic import op
${imports if imports else ""}
revision = ${repr(up_revision)}
down_revision = ${repr(down_revision)}
branch_labels = ${repr(branch_labels)}
depends_on = ${repr(depends_on)}


def upgrade() -> None:
    """Apply."""
    ${upgrades if upgrades else "pass"}


def downgrade() -> None:
    """Take back."""
    ${downgrades if downgrades else "pass"}
