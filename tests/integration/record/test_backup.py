"""Backup and restore, within a shape and across the two."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
import sqlalchemy as sa

from server import accounts, database
from server.backup import BackupError, backup, restore
from server.checker import check
from server.errors import Conflict
from server.models import Benchmark, SubmissionState
from server.services import Services
from server.settings import Settings
from tests.services.installation import Installation


def _empty(folder: Path) -> Services:
    services = Services.from_settings(Settings(data_dir=folder))
    database.migrate(services.engine)
    return services


def test_a_restored_installation_is_the_same_and_goes_on(installation: Installation, tmp_path: Path) -> None:
    """Everything is there again in another database: the checker finds nothing, history stays guarded, work goes on."""
    submission_id = installation.submit()
    installation.start_worker()
    installation.wait_for(submission_id, SubmissionState.SCORED)
    rows = backup(installation.services, tmp_path / "backup")
    services = _empty(tmp_path / "other")
    assert restore(services, tmp_path / "backup") == rows
    assert check(services) == []
    other = Installation(services=services, broker=installation.broker, folder=tmp_path, case=installation.case)
    other.user = installation.user
    other.submit(enqueue=False)
    with services.transaction() as session:
        triggers = session.connection().exec_driver_sql("SELECT count(*) FROM sqlite_master WHERE type = 'trigger'")
        assert triggers.scalar_one() > 10
    services.close()


@pytest.mark.parametrize("shape", ["scale_out"])
def test_an_embedded_installation_moves_to_postgresql(installation: Installation, tmp_path: Path) -> None:
    """A backup of SQLite restores into PostgreSQL; new rows get new numbers there."""
    source = _empty(tmp_path / "source")
    with source.transaction() as session:
        accounts.create_user(session, email="bob@example.org", name="Bob", password_hash=None, actor="admin:t")
    backup(source, tmp_path / "backup")
    source.close()
    with pytest.raises(Conflict, match="empty"):
        restore(installation.services, tmp_path / "backup")
    target = _sibling(installation)
    restore(target, tmp_path / "backup")
    with target.transaction() as session:
        user = accounts.create_user(session, email="eve@example.org", name="Eve", password_hash=None, actor="admin:t")
        assert user.id == 2
    target.close()


def _sibling(installation: Installation) -> Services:
    """Empty the installation's own database by migrating it down and up."""
    database.downgrade(installation.services.engine, "base")
    database.migrate(installation.services.engine)
    return installation.services


@pytest.mark.parametrize("shape", ["embedded"])
def test_a_damaged_backup_is_refused(installation: Installation, tmp_path: Path) -> None:
    """A changed blob is found before anything is written; a folder that is no backup is said to be none."""
    backup(installation.services, tmp_path / "backup")
    with pytest.raises(Conflict, match="exists"):
        backup(installation.services, tmp_path / "backup")
    blob = next((tmp_path / "backup" / "blobs").iterdir())
    blob.write_bytes(b"something else")
    services = _empty(tmp_path / "other")
    with pytest.raises(BackupError, match="damaged"):
        restore(services, tmp_path / "backup")
    with pytest.raises(BackupError, match="holds no backup"):
        restore(services, tmp_path)
    services.close()


def _cut(folder: Path) -> None:
    file = folder / "user_account.jsonl"
    file.write_bytes(file.read_bytes()[:-10])


def _without(name: str) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        file = folder / "user_account.jsonl"
        rows = [json.loads(line) for line in file.read_text().splitlines()]
        file.write_text("".join(json.dumps({key: row[key] for key in row if key != name}) + "\n" for row in rows))

    return damage


@pytest.mark.parametrize("shape", ["embedded"])
@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda folder: (folder / "manifest.json").write_text("{}"), "does not say of which schema"),
        (lambda folder: (folder / "manifest.json").write_text("[]"), "does not say of which schema"),
        (lambda folder: (folder / "phase.jsonl").unlink(), "phase.jsonl cannot be read"),
        (lambda folder: (folder / "blob.jsonl").write_text("[]\n"), "blob.jsonl, line 1 is no row"),
        (lambda folder: (folder / "blob.jsonl").write_bytes(b"\xff\n"), "blob.jsonl, line 1 is no JSON"),
        (lambda folder: (folder / "user_account.jsonl").write_text(""), "damaged"),
        (_cut, "user_account.jsonl, line 1 is no JSON"),
        (_without("email"), "user_account.jsonl, line 1: IntegrityError"),
    ],
)
def test_every_damage_of_a_backup_is_said(
    installation: Installation, tmp_path: Path, damage: Callable[[Path], object], said: str
) -> None:
    """Whatever is missing, cut or changed is one located error, and nothing is written."""
    backup(installation.services, tmp_path / "backup")
    damage(tmp_path / "backup")
    services = _empty(tmp_path / "other")
    with pytest.raises(BackupError, match=re.escape(said)):
        restore(services, tmp_path / "backup")
    with services.snapshot() as session:
        assert session.scalar(sa.select(sa.func.count()).select_from(Benchmark)) == 0
    services.close()


@pytest.mark.parametrize("shape", ["embedded"])
def test_an_installation_in_use_is_refused_before_blobs_are_copied(installation: Installation, tmp_path: Path) -> None:
    """Whether the installation fits is asked first."""
    backup(installation.services, tmp_path / "backup")
    services = _empty(tmp_path / "other")
    with services.transaction() as session:
        accounts.create_user(session, email="bob@example.org", name="Bob", password_hash=None, actor="admin:t")
    with pytest.raises(Conflict, match="has users already"):
        restore(services, tmp_path / "backup")
    assert list(services.blobs.stored()) == []
    services.close()
