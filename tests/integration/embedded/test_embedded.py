"""The embedded shape: its broker, its data folder, and what children are told."""

from pathlib import Path

import pytest

from server import embedded
from server.errors import Conflict
from server.queue import Queue
from server.settings import LONGEST_SOCKET_PATH, Settings
from server.supervision import Supervisor


@pytest.mark.parametrize("folder", ["d", "a" * 120], ids=["short path", "long path"])
def test_the_broker_answers_on_its_socket(tmp_path: Path, folder: str) -> None:
    """Also when the data folder's path is too long for a unix socket; the socket is then in a folder of its own."""
    settings = Settings(data_dir=tmp_path / folder)
    broker = embedded.embedded_supervisor(settings, host="127.0.0.1", port=1)._children[0]
    assert len(str(settings.broker_socket)) <= LONGEST_SOCKET_PATH
    queue = Queue(settings)
    assert queue.depth() is None
    with Supervisor([broker]).running():
        assert queue.depth() == 0
        assert settings.broker_socket.is_socket()
    assert (settings.data_dir / "broker" / "appendonlydir").is_dir()


def test_one_data_folder_has_one_server(tmp_path: Path) -> None:
    """The second process is told which one holds it; the folder is free again afterwards."""
    settings = Settings(data_dir=tmp_path)
    with embedded.sole_owner(settings), pytest.raises(Conflict, match=r"served by process \d+"):
        embedded.sole_owner(settings).__enter__()
    with embedded.sole_owner(settings):
        pass


def test_children_get_these_settings_and_no_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A setting in our own environment that was overridden is not passed on; other variables are."""
    monkeypatch.setenv("CS3D_DATABASE_URL", "postgresql+psycopg://real")
    monkeypatch.setenv("UNRELATED", "kept")
    settings = Settings(data_dir=tmp_path, database_url="", upload_max_bytes=5)
    environment = embedded.process_environment(settings)
    assert "CS3D_DATABASE_URL" not in environment
    assert environment["CS3D_UPLOAD_MAX_BYTES"] == "5"
    assert environment["CS3D_DATA_DIR"] == str(tmp_path)
    assert environment["UNRELATED"] == "kept"
