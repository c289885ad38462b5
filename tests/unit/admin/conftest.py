"""An installation that `init` made, `cs3d-admin` on it, and what it holds."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import structlog

from server.admin.main import main
from server.services import Services
from server.settings import Settings
from tests.unit.admin.filled import Admin, Refused, Says
from worker.sandbox import Sandbox


@pytest.fixture(autouse=True)
def _usual_logging() -> Iterator[None]:
    """Leave logging to other tests as it was: a command sends it to standard error."""
    yield
    structlog.reset_defaults()


@pytest.fixture(scope="session")
def _initialised(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make an installation to copy: migrating takes longer than most tests."""
    folder = tmp_path_factory.mktemp("initialised") / "data"
    assert main(["init", "--data-dir", str(folder)]) == 0
    return folder


@pytest.fixture
def data_dir(_initialised: Path, tmp_path: Path) -> Path:
    """An installation that `init` made."""
    return Path(shutil.copytree(_initialised, tmp_path / "data"))


@pytest.fixture
def admin(data_dir: Path, capsys: pytest.CaptureFixture[str]) -> Admin:
    """Run a command with --json and return what it prints; it must succeed."""

    def run(*arguments: str) -> dict[str, Any]:
        capsys.readouterr()
        status = main([*arguments, "--data-dir", str(data_dir), "--json"])
        printed = capsys.readouterr()
        assert status == 0, printed.err
        document: dict[str, Any] = json.loads(printed.out)
        return document

    return run


@pytest.fixture
def says(data_dir: Path, capsys: pytest.CaptureFixture[str]) -> Says:
    """Run a command and return what it prints for people; it must succeed."""

    def run(*arguments: str) -> str:
        capsys.readouterr()
        status = main([*arguments, "--data-dir", str(data_dir)])
        printed = capsys.readouterr()
        assert status == 0, printed.err
        return printed.out

    return run


@pytest.fixture
def refused(data_dir: Path, capsys: pytest.CaptureFixture[str]) -> Refused:
    """Run a command that must not succeed; give its status and what it says."""

    def run(*arguments: str) -> tuple[int, str]:
        capsys.readouterr()
        try:
            status = main([*arguments, "--data-dir", str(data_dir)])
        except SystemExit as ended:  # how argparse ends
            status = int(ended.code or 0)
        printed = capsys.readouterr()
        assert status != 0
        assert printed.out == ""
        return status, printed.err

    return run


@pytest.fixture
def services(data_dir: Path) -> Iterator[Services]:
    """The installation as the server sees it."""
    services = Services.from_settings(Settings(data_dir=data_dir))
    yield services
    services.close()


@pytest.fixture(scope="module")
def sandbox() -> Iterator[Sandbox]:
    """Give the worker's scoring process."""
    sandbox = Sandbox()
    sandbox.start()
    yield sandbox
    sandbox.kill()
