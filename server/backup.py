"""Backup and restore: the whole record and its blobs in one folder that any installation of this version can take.

    manifest.json       schema revision, time, and how many rows each table has
    <table>.jsonl       one row per line, as JSON
    blobs/<digest>      the bytes

A backup is taken while the server works: the rows are read in one snapshot, and blobs are immutable and never deleted
while a row knows them. Rows are independent of the database, so SQLite can be restored to PostgreSQL and back.
Restoring fills an empty installation only, checks every digest, and is one transaction.
"""

import base64
import hashlib
import json
import os
import shutil
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from evaluator.errors import DataError
from server import database
from server.blobs import digest_file
from server.errors import Conflict
from server.models import Base, Blob, Phase, User, UtcDateTime
from server.services import Services

MANIFEST = "manifest.json"
TABLES = [table for table in Base.metadata.sorted_tables if table.name != "shard"]
"""Parents before children, but for phase and ground truth, which refer to each other.

Shards belong to attempts that end with their worker: where the backup is restored, the next attempt makes others.
"""
_ROWS_AT_ONCE = 500
"""Rows held in memory; those of scores are large."""


class BackupError(DataError):
    """The folder holds no backup, or not a whole one, or one of another schema."""

    code = "invalid_backup"


def backup(services: Services, path: Path) -> dict[str, int]:
    """Write everything to a new folder.

    The folder appears under its name only once it is complete.

    Args:
        services: The installation; it may be at work.
        path: Must not exist.

    Returns:
        How many rows each table has.

    Raises:
        Conflict: `path` exists.
    """
    if path.exists():
        raise Conflict(f"{path} exists; name a new folder for the backup")
    draft = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    (draft / "blobs").mkdir(parents=True)
    try:
        with services.snapshot() as session:
            if session.connection().dialect.name == "postgresql":  # copying blobs takes its time
                session.execute(sa.text("SET LOCAL idle_in_transaction_session_timeout = 0"))
            counts = {table.name: _write_table(session, table, draft) for table in TABLES}
            for sha256 in session.scalars(sa.select(Blob.sha256)):
                _copy_blob(services, sha256, draft / "blobs" / sha256)
            manifest = {"revision": _revision(session), "taken_at": database.now(session).isoformat(), "rows": counts}
        (draft / MANIFEST).write_text(json.dumps(manifest, indent=2))
        os.sync()
        draft.rename(path)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        raise
    return counts


def restore(services: Services, path: Path) -> dict[str, int]:
    """Fill an empty, migrated installation from a backup.

    Args:
        services: The installation; its schema must be the backup's.
        path: What `backup` wrote.

    Returns:
        How many rows each table got.

    Raises:
        BackupError: The backup is damaged, or of another schema revision.
        Conflict: The installation is not empty.
    """
    manifest = _read_manifest(path)
    with services.snapshot() as session:
        _check_fits(session, manifest)  # before what takes long, and once more below
    for row in _rows(path, Blob.__tablename__):
        sha256 = row.get("sha256")
        _restore_blob(services, path / "blobs" / str(sha256), str(sha256))
    with services.transaction() as session:
        _check_fits(session, manifest)
        with _guards_lifted(session):
            counts = {table.name: _read_table(session, table, path) for table in TABLES}
            _tie_phases(session, path)
        if counts != manifest["rows"]:
            raise BackupError("the backup has other numbers of rows than its manifest says; it is damaged")
        _advance_sequences(session)
    return counts


def _check_fits(session: Session, manifest: dict[str, Any]) -> None:
    """Refuse an installation that is in use or of another schema."""
    if session.scalar(sa.select(sa.func.count()).select_from(User)):
        raise Conflict("the installation has users already; restore into an empty one")
    if _revision(session) != manifest["revision"]:
        message = f"the backup is of schema {manifest['revision']}, the database of {_revision(session)}"
        raise BackupError(f"{message}; restore with the program version that took it, then migrate")


def _revision(session: Session) -> str:
    revision: str = session.execute(sa.text("SELECT version_num FROM alembic_version")).scalar_one()
    return revision


def _write_table(session: Session, table: sa.Table, folder: Path) -> int:
    count = 0
    with (folder / f"{table.name}.jsonl").open("w", encoding="utf-8") as stream:
        query = sa.select(table).order_by(*table.primary_key).execution_options(yield_per=_ROWS_AT_ONCE)
        for row in session.execute(query).mappings():
            values = {name: _to_json(value) for name, value in row.items()}
            stream.write(json.dumps(values, ensure_ascii=False) + "\n")
            count += 1
    return count


def _to_json(value: object) -> object:
    """Write times, ids and bytes as text; enumerations are text already."""
    if isinstance(value, datetime):
        return value.isoformat()
    if isinstance(value, uuid.UUID):
        return str(value)
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    return value


def _copy_blob(services: Services, sha256: str, target: Path) -> None:
    digest = hashlib.sha256()
    with target.open("xb") as stream:
        for chunk in services.blobs.stream(sha256):
            digest.update(chunk)
            stream.write(chunk)
    if digest.hexdigest() != sha256:
        raise BackupError(f"blob {sha256} has other bytes than its name says; run `cs3d-admin check`")


def _read_manifest(path: Path) -> dict[str, Any]:
    try:
        manifest = json.loads((path / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BackupError(f"{path} holds no backup: {MANIFEST} cannot be read") from error
    if not isinstance(manifest, dict) or not {"revision", "rows"} <= manifest.keys():
        raise BackupError(f"{path} holds no backup: {MANIFEST} does not say of which schema and how many rows it is")
    return manifest


def _rows(path: Path, name: str) -> Iterator[dict[str, Any]]:
    """Read a table's rows; raises BackupError where there are none to be read."""
    file = path / f"{name}.jsonl"
    number = 0
    try:
        with file.open("rb") as stream:
            for number, line in enumerate(stream, start=1):
                row = json.loads(line)
                if not isinstance(row, dict):
                    raise BackupError(f"the backup is damaged: {file.name}, line {number} is no row")
                yield row
    except OSError as error:
        raise BackupError(f"the backup is damaged: {file.name} cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise BackupError(f"the backup is damaged: {file.name}, line {number} is no JSON") from error


def _restore_blob(services: Services, source: Path, sha256: str) -> None:
    if not source.is_file() or digest_file(source) != sha256:
        raise BackupError(f"blob {sha256} is missing or damaged in the backup")
    copy = services.blobs.incoming / f"{uuid.uuid4().hex}.tmp"
    shutil.copyfile(source, copy)
    services.blobs.put_file(copy, sha256)


def _read_table(session: Session, table: sa.Table, path: Path) -> int:
    """Insert a table's rows; what a phase says about its ground truth follows once there is some."""
    later = {"ground_truth_id": None} if table.name == Phase.__tablename__ else {}
    readers = {column.name: _reader(column) for column in table.columns}
    count = 0
    for row in _rows(path, table.name):
        count += 1
        try:
            # A value that is not given becomes NULL; given as None it would become the JSON value null in a JSON column.
            values = {name: readers[name](value) for name, value in row.items() if value is not None} | later
            session.execute(sa.insert(table).values(**values))
        except (KeyError, TypeError, ValueError, IntegrityError) as error:
            raise BackupError(f"the backup is damaged: {table.name}.jsonl, line {count}: {error!r}") from error
    return count


def _tie_phases(session: Session, path: Path) -> None:
    table = Phase.__table__
    for row in _rows(path, Phase.__tablename__):
        ground_truth_id = row.get("ground_truth_id")
        session.execute(sa.update(Phase).where(table.c.id == row["id"]).values(ground_truth_id=ground_truth_id))


def _reader(column: sa.Column[Any]) -> Callable[[Any], Any]:
    """Give what turns a JSON value, not null, back into the column's."""
    kind = column.type
    if isinstance(kind, UtcDateTime):
        return datetime.fromisoformat
    if isinstance(kind, sa.Uuid):
        return uuid.UUID
    if isinstance(kind, sa.LargeBinary):
        return base64.b64decode
    if isinstance(kind, sa.Enum) and kind.enum_class is not None:
        return kind.enum_class
    return lambda value: value


@contextmanager
def _guards_lifted(session: Session) -> Iterator[None]:
    """Take the triggers away while history is written back, and put the very same ones up again."""
    if session.connection().dialect.name == "sqlite":
        triggers = session.execute(sa.text("SELECT name, sql FROM sqlite_master WHERE type = 'trigger'")).all()
        for name, _ in triggers:
            session.execute(sa.text(f'DROP TRIGGER "{name}"'))
        yield
        for _, statement in triggers:
            session.connection().exec_driver_sql(statement)
        return
    for table in TABLES:
        session.execute(sa.text(f'ALTER TABLE "{table.name}" DISABLE TRIGGER USER'))
    yield
    session.flush()
    for table in TABLES:
        session.execute(sa.text(f'ALTER TABLE "{table.name}" ENABLE TRIGGER USER'))


def _advance_sequences(session: Session) -> None:
    """Let new rows get numbers beyond the restored ones; SQLite does so by itself."""
    if session.connection().dialect.name != "postgresql":
        return
    for table in TABLES:
        column = table.autoincrement_column
        if column is not None:
            greatest = session.scalar(sa.select(sa.func.max(column)))
            if greatest is not None:
                sequence = sa.func.pg_get_serial_sequence(f'"{table.name}"', column.name)
                session.execute(sa.select(sa.func.setval(sequence, greatest)))
