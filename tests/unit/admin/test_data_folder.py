"""The data folder holds hidden ground truth."""

from pathlib import Path

from server.services import Services
from server.settings import Settings


def test_a_new_data_folder_is_its_owners_alone(tmp_path: Path) -> None:
    """Nobody else on the machine reads blobs or the database, whatever the umask."""
    services = Services.from_settings(Settings(data_dir=tmp_path / "data"))
    services.close()
    assert (tmp_path / "data").stat().st_mode & 0o077 == 0
