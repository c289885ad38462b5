"""Migrations on both databases."""

import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from server import database
from server.errors import Unavailable
from server.settings import Settings
from tests.services.fixtures import Shape
from tests.services.postgresql import PostgresqlServer
from tests.services.worker import environment_of


@pytest.fixture
def empty_database(shape: Shape, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[str]:
    """Give the URL of a database without tables."""
    if shape == "embedded":
        yield f"sqlite:///{tmp_path / 'empty.sqlite'}"
    else:
        server: PostgresqlServer = request.getfixturevalue("postgresql")
        yield server.url(server.create_database())


def test_up_down_up_without_drift(empty_database: str) -> None:
    """Migrations can be taken back completely and applied again, and yield exactly the models."""
    engine = database.create_engine(empty_database)
    database.migrate(engine)
    database.check_drift(engine)
    database.downgrade(engine, "base")
    assert sa.inspect(engine).get_table_names() == ["alembic_version"]
    database.migrate(engine)
    database.check_drift(engine)
    engine.dispose()


@pytest.mark.parametrize("shape", ["scale_out"])
def test_a_migration_gives_up_waiting_for_a_table(empty_database: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """While a table is in use a migration of it ends with the cause, changes nothing, and succeeds afterwards."""
    engine = database.create_engine(empty_database)
    database.migrate(engine, "0003")  # the one after it adds a column to phases
    monkeypatch.setattr(database, "MIGRATION_LOCK_TIMEOUT", "50ms")
    patience: list[str] = []

    def look(connection: sa.Connection, cursor: Any, statement: str, *_: object) -> None:
        del connection
        if statement.startswith("ALTER TABLE phase"):
            cursor.execute("SHOW lock_timeout")
            patience.extend(cursor.fetchone())

    sa.event.listen(engine, "before_cursor_execute", look)
    with engine.begin() as reader:
        reader.execute(sa.text("SELECT count(*) FROM phase"))
        with pytest.raises(Unavailable, match="in use for longer than 50ms"):
            database.migrate(engine)
        assert patience == ["50ms"]
        assert reader.scalar(sa.text("SELECT version_num FROM alembic_version")) == "0003"
    database.migrate(engine)
    database.check_drift(engine)
    engine.dispose()


def test_two_processes_may_migrate_at_once(empty_database: str) -> None:
    """Starting two servers on an empty database migrates it once, without an error."""
    program = "import sys; from server import database as d; d.migrate(d.create_engine(sys.argv[1]))"
    processes = [
        subprocess.Popen([sys.executable, "-c", program, empty_database], env=environment_of(Settings()))
        for _ in range(2)
    ]
    assert [process.wait(60) for process in processes] == [0, 0]


def test_many_may_be_the_first_to_connect(tmp_path: Path) -> None:
    """Turning WAL on in a fresh file at the same moment is refused without waiting by SQLite; nobody notices."""
    for number in range(60):
        engines = [database.create_engine(f"sqlite:///{tmp_path}/{number}.sqlite") for _ in range(4)]
        together = threading.Barrier(len(engines))

        def connect(engine: sa.Engine, together: threading.Barrier = together) -> str:
            together.wait()
            with engine.connect() as connection:
                return str(connection.exec_driver_sql("PRAGMA journal_mode").scalar())

        with ThreadPoolExecutor(len(engines)) as pool:
            assert list(pool.map(connect, engines)) == ["wal"] * len(engines)
        for engine in engines:
            engine.dispose()
