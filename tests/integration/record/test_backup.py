"""Backup and restore, within a shape and across the two."""

from pathlib import Path

import pytest

from server import accounts, database
from server.backup import BackupError, backup, restore
from server.checker import check
from server.errors import Conflict
from server.models import SubmissionState
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
        accounts.create_user(session, email="bob@example.org", name="Bob", password=None, actor="admin:t")
    backup(source, tmp_path / "backup")
    source.close()
    with pytest.raises(Conflict, match="empty"):
        restore(installation.services, tmp_path / "backup")
    target = _sibling(installation)
    restore(target, tmp_path / "backup")
    with target.transaction() as session:
        user = accounts.create_user(session, email="eve@example.org", name="Eve", password=None, actor="admin:t")
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
