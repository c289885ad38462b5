"""The connection to the database: one engine for SQLite (WAL) and PostgreSQL, its clock, and its migrations.

Sessions are synchronous everywhere, so the web and the workers share one way. Code that is given a session never
commits: `Services.transaction` does, at the edge. Reads that change nothing use `Services.snapshot`, which takes no
write lock and sees one consistent state.
"""

import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import sqlalchemy as sa
import structlog
from sqlalchemy.orm import Session

from server.errors import StorageFull, Unavailable

if TYPE_CHECKING:
    import alembic.config  # loaded below only where it is used: a third of a second that no worker should wait

log = structlog.get_logger(__name__)

BUSY_TIMEOUT_S = 30
"""How long a SQLite writer waits for another; far beyond any transaction of ours."""

_WAL_WAIT_S = 0.05

BOUNDS = {
    "lock_timeout": "30s",
    "statement_timeout": "120s",
    "idle_in_transaction_session_timeout": "60s",
}
"""PostgreSQL: nothing waits for ever, and a process that freezes within a transaction does not keep its locks."""

MIGRATION_LOCK_TIMEOUT = "5s"
"""PostgreSQL: how long a migration waits for a table; everybody who comes after it waits behind it."""

LOCK_NOT_AVAILABLE = "55P03"
"""PostgreSQL's code for a lock that was waited for in vain."""

READ_ONLY = "cs3d_read_only"
"""Execution option of the engine used for snapshots."""


def create_engine(url: str) -> sa.Engine:
    """Open an engine for `url`; nothing is connected yet.

    Args:
        url: `sqlite:///path` or `postgresql+psycopg://...`.
    """
    if sa.make_url(url).get_backend_name() == "sqlite":
        return _create_sqlite_engine(url)
    return sa.create_engine(
        url,
        pool_pre_ping=True,
        pool_size=10,
        max_overflow=20,
        json_deserializer=_read_json,
        connect_args={
            "connect_timeout": 5,
            "options": " ".join(f"-c {name}={value}" for name, value in BOUNDS.items()),
        },
    )


def _read_json(text: str | bytes) -> Any:  # noqa: ANN401 - JSON
    """Decode a JSON column; a leaderboard reads many, and this takes a fraction of the standard library's time."""
    return msgspec.json.decode(text)


def _create_sqlite_engine(url: str) -> sa.Engine:
    path = sa.make_url(url).database
    if path:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
    engine = sa.create_engine(url, json_deserializer=_read_json, connect_args={"timeout": BUSY_TIMEOUT_S})
    sa.event.listen(engine, "connect", _configure_sqlite)
    sa.event.listen(engine, "begin", _begin_sqlite)
    return engine


def _configure_sqlite(connection: Any, record: object) -> None:  # noqa: ANN401 - the driver's connection
    """Set what SQLite needs per connection.

    WAL lets readers and one writer work at once; `synchronous=FULL` makes a commit survive a power cut, as the
    answer 202 promises.
    """
    del record
    connection.isolation_level = None  # transactions are begun in `_begin_sqlite`, not by the driver
    for pragma in (f"busy_timeout={BUSY_TIMEOUT_S * 1000}", "synchronous=FULL", "foreign_keys=ON"):
        connection.execute(f"PRAGMA {pragma}")
    _write_ahead(connection)


def _write_ahead(connection: Any) -> None:  # noqa: ANN401 - the driver's connection
    """Turn WAL on. When several processes are the first to do so at once, SQLite refuses without waiting: we wait."""
    deadline_s = time.monotonic() + BUSY_TIMEOUT_S
    while True:
        try:
            connection.execute("PRAGMA journal_mode=WAL")
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode != sqlite3.SQLITE_BUSY or time.monotonic() > deadline_s:
                raise
            time.sleep(_WAL_WAIT_S)
        else:
            return


def _begin_sqlite(connection: sa.Connection) -> None:
    """Begin writers with the write lock: a transaction that reads first and writes later could otherwise deadlock."""
    read_only = connection.get_execution_options().get(READ_ONLY, False)
    connection.exec_driver_sql("BEGIN" if read_only else "BEGIN IMMEDIATE")


def snapshot_engine(engine: sa.Engine) -> sa.Engine:
    """Give a view of `engine`, sharing its connections, whose transactions read one consistent state."""
    if engine.dialect.name == "sqlite":
        return engine.execution_options(**{READ_ONLY: True})
    return engine.execution_options(isolation_level="REPEATABLE READ", postgresql_readonly=True)


@contextmanager
def outages_are_said() -> Iterator[None]:
    """Turn what a database that is down, restarting, locked for too long or full raises into our errors."""
    try:
        yield
    except (sa.exc.OperationalError, sa.exc.InterfaceError, sa.exc.TimeoutError) as error:
        if "full" in str(error).lower() and "disk" in str(error).lower():
            raise StorageFull("the database has no room left; the maintainers are needed") from error
        log.warning("database_away", error=repr(error))
        raise Unavailable("the database does not answer; try again in a moment") from error


def now(session: Session) -> datetime:
    """Read the database's clock: the one clock that leases, quotas and phases go by, whatever the machines think.

    It asks the connection, not the session, so that rows that are half changed are not flushed by it.

    Returns:
        The present time in UTC, at least to the millisecond.
    """
    connection = session.connection()
    if connection.dialect.name == "sqlite":
        text = connection.execute(sa.text("SELECT strftime('%Y-%m-%d %H:%M:%f', 'now')")).scalar_one()
        return datetime.strptime(str(text), "%Y-%m-%d %H:%M:%S.%f").replace(tzinfo=UTC)
    value: datetime = connection.execute(sa.text("SELECT clock_timestamp()")).scalar_one()
    return value.astimezone(UTC)


def migrations_folder() -> Path:
    """Find the migrations: inside the installed package, else beside it in the source tree."""
    package = Path(__file__).parent
    candidates = (package / "migrations", package.parent / "migrations")
    return next(folder for folder in candidates if (folder / "env.py").is_file())


def alembic_config(connection: sa.Connection) -> "alembic.config.Config":
    """Configure Alembic in code, on a given connection; there is no ini file."""
    import alembic.config  # noqa: PLC0415 - see above

    config = alembic.config.Config()
    config.set_main_option("script_location", str(migrations_folder()).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    config.attributes["connection"] = connection
    return config


def migrate(engine: sa.Engine, revision: str = "head") -> None:
    """Bring the schema to `revision`; safe to run from several processes at once.

    Raises:
        Unavailable: On PostgreSQL others use a table for longer than a migration waits; nothing was changed.
    """
    import alembic.command  # noqa: PLC0415 - see above

    try:
        with engine.connect() as connection:
            alembic.command.upgrade(alembic_config(connection), revision)
    except sa.exc.OperationalError as error:
        if getattr(error.orig, "sqlstate", None) != LOCK_NOT_AVAILABLE:
            raise
        message = (
            f"a table was in use for longer than {MIGRATION_LOCK_TIMEOUT}; nothing was changed. Wait for backups, checks"
            " and other migrations to end, or stop the server, and migrate again"
        )
        raise Unavailable(message) from error


def downgrade(engine: sa.Engine, revision: str) -> None:
    """Take the schema back to `revision` (`base`: no tables)."""
    import alembic.command  # noqa: PLC0415 - see above

    with engine.connect() as connection:
        alembic.command.downgrade(alembic_config(connection), revision)


def check_drift(engine: sa.Engine) -> None:
    """Raise `alembic.util.AutogenerateDiffsDetected` unless the migrated schema equals the models."""
    import alembic.command  # noqa: PLC0415 - see above

    with engine.connect() as connection:
        alembic.command.check(alembic_config(connection))
