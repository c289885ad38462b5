"""The decisions of do.py: when to install, with what, and what is passed on."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import do

SCRIPT = Path(do.__file__)


def test_help_names_every_command() -> None:
    """A newcomer who asks for help sees all commands."""
    shown = subprocess.run([sys.executable, SCRIPT, "--help"], capture_output=True, text=True, check=True).stdout
    assert all(f"do.py {run.__name__}" in shown for run, _ in do.COMMANDS)


def test_a_superfluous_argument_is_wrong_usage() -> None:
    """`lint` takes none: exit status 2, before anything is installed."""
    done = subprocess.run([sys.executable, SCRIPT, "lint", "--fast"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "--fast" in done.stderr


@pytest.fixture
def environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An environment folder of its own with an interpreter in it."""
    folder = tmp_path / ".venv"
    (folder / "bin").mkdir(parents=True)
    (folder / "bin" / "python").symlink_to(sys.executable)
    monkeypatch.setattr(do, "VENV", folder)
    return folder


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, ...]]:
    """What pip was asked for, instead of asking it."""
    calls: list[tuple[str, ...]] = []
    monkeypatch.setattr(do, "_pip", lambda _, *arguments: calls.append(arguments))
    return calls


def test_nothing_is_installed_twice(environment: Path, installed: list[tuple[str, ...]]) -> None:
    """The first call installs lock files and project, the second sees that nothing changed."""
    do._install("server")
    assert [call[0] for call in installed] == ["--require-hashes", "--no-deps"]
    do._install("server")
    assert len(installed) == 2
    assert (environment / "installed.json").exists()


def test_a_changed_lock_file_is_installed_again(environment: Path, installed: list[tuple[str, ...]]) -> None:
    """Another digest in the record means another installation."""
    do._install("server")
    stamp = environment / "installed.json"
    stamp.write_text(json.dumps({**json.loads(stamp.read_text()), "server": "0" * 64}))
    do._install("server")
    assert len(installed) == 4


def test_the_environment_for_tests_serves_the_demo_too(environment: Path, installed: list[tuple[str, ...]]) -> None:
    """After `test`, `demo` installs nothing; after `demo`, `test` does."""
    assert environment.exists()
    do._install("test")
    do._install("server")
    assert len(installed) == 2


def test_an_unreadable_record_means_install(environment: Path, installed: list[tuple[str, ...]]) -> None:
    """A record cut off by a crash is none."""
    (environment / "installed.json").write_text("{")
    do._install("server")
    assert len(installed) == 2


def test_versions_are_asked_of_the_interpreter() -> None:
    """An interpreter says its version; what does not run has none."""
    assert do._version_of(sys.executable) == sys.version_info[:2]
    assert do._version_of("/no/such/python") == ()
    assert do._version_of("/bin/false") == ()


def test_a_newer_python_gives_way_to_a_suitable_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Under an interpreter without a wheel of the broker, the newest suitable one on PATH is used."""
    python = tmp_path / "python3.12"
    python.write_text("#!/bin/sh\necho 3 12\n")
    python.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sys, "version_info", (3, 15, 0))
    assert do._find_interpreter() == str(python)


def test_an_interpreter_that_lies_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A shim on PATH that does not run leaves the running interpreter."""
    shim = tmp_path / "python3.13"
    shim.write_text("#!/bin/sh\nexit 127\n")
    shim.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sys, "version_info", (3, 15, 0))
    assert do._find_interpreter() == sys.executable


def test_system_packages_are_recognised_by_command_or_file(tmp_path: Path) -> None:
    """A command on PATH or a matching file is enough."""
    (tmp_path / "15").mkdir()
    (tmp_path / "15" / "initdb").touch()
    assert do._present("sh")
    assert do._present(f"{tmp_path}/*/initdb")
    assert not do._present("no-such-command")


def test_a_bare_debian_is_told_which_package_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without ensurepip and without root rights, the message names the package for that version."""
    python = tmp_path / "python3"
    python.write_text('#!/bin/sh\ncase "$2" in *ensurepip*) exit 1;; esac\necho 3 12\n')
    python.chmod(0o755)
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    with pytest.raises(do.CannotContinueError, match=r"apt-get install python3\.12-venv"):
        do._ensure_venv(str(python))
