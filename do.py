#!/usr/bin/env python3
"""Everything a developer or newcomer does with this repository, with nothing but Python installed.

    python3 do.py demo [...]      install, then show a benchmark server at work (arguments go to `cs3d-admin demo`)
    python3 do.py test [...]      install, then run every test (arguments go to pytest)
    python3 do.py lint            ruff, mypy, import contracts, container and lock files
    python3 do.py bench [NAME..]  side-by-side measurements in bench/
    python3 do.py faults [...]    the fault programme: real processes, killed at named points
    python3 do.py fuzz [...]      fuzz the archive reader, the decoder and the API for a bounded time
    python3 do.py docs            build the documentation into site/, strictly
    python3 do.py lock [--check]  write (or check) the lock files in requirements/; needs uv
    python3 do.py install         only the installation

Installs into `.venv` from the hashed lock files, with uv when it is on PATH, else with venv and pip; again only when
a lock file changed. Standard library only, and readable by any Python 3, so that an old one gets a clear message.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
CACHE = ROOT / ".cache"

OLDEST, NEWEST = (3, 11), (3, 13)
"""The embedded broker comes as a wheel for these versions."""

SYSTEM_PACKAGES = {
    "chromium": ("chromium", "chromium-browser", "google-chrome"),
    "redis-server": ("redis-server",),
    "npm": ("npm",),
    "postgresql": ("/usr/lib/postgresql/*/bin/initdb", "initdb"),
}
"""Package that tests need -> commands or files, any of which shows that it is there."""


SIDE_BY_SIDE = ["--numprocesses=logical", "--maxprocesses=4", "--dist=loadfile"]
"""Tests of one file run in one process, so that they share their services; each process starts services of its own."""


class CannotContinueError(Exception):
    """Something the person at the terminal has to change; the message says what."""


def main() -> int:
    """Run one command."""
    arguments, rest = _parser().parse_known_args()
    if rest and not arguments.takes_rest:
        _parser().error(f"{arguments.command} takes no argument {rest[0]!r}")
    os.chdir(ROOT)
    try:
        return int(arguments.run(rest))
    except CannotContinueError as error:
        print(f"\n{error}", file=sys.stderr)
        return 2
    except subprocess.CalledProcessError as error:
        print(f"\nFailed with status {error.returncode}: {' '.join(map(str, error.cmd))}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130


def _parser() -> argparse.ArgumentParser:
    """Build the command line; options of the wrapped tools pass through."""
    parser = argparse.ArgumentParser(
        prog="do.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for run, takes_rest in COMMANDS:
        command = commands.add_parser(run.__name__, add_help=not takes_rest, help=(run.__doc__ or "").split("\n")[0])
        command.set_defaults(run=run, takes_rest=takes_rest)
    return parser


# Commands


def install(rest: list[str]) -> int:
    """Install the server into .venv."""
    del rest
    _install("server")
    return 0


def demo(rest: list[str]) -> int:
    """Install, then show a benchmark server at work."""
    _install("server")
    _section("demo")
    return _hand_over([_tool("cs3d-admin"), "demo", *rest])


def test(rest: list[str]) -> int:
    """Install what tests need, then run every test."""
    _install("test")
    _install_system_packages()
    _install_reference()
    _section("test")
    return _hand_over([_python(), "-m", "pytest", *SIDE_BY_SIDE, *rest])


def lint(rest: list[str]) -> int:
    """Run every static check; all of them, even when one fails."""
    del rest
    _install("test")
    checks = {
        "ruff check": [_tool("ruff"), "check", "."],
        "ruff format": [_tool("ruff"), "format", "--check", "."],
        "mypy": [_tool("mypy")],
        "import contracts": [_tool("lint-imports")],
        "compose file": [_tool("check-jsonschema"), "--builtin-schema", "vendor.compose-spec", "docker-compose.yml"],
        "Dockerfile": [_tool("hadolint"), "Dockerfile"],
    }
    if shutil.which("uv"):
        checks["lock files"] = [_python(), "requirements/lock.py", "--check"]
    else:
        _section("lock files: not checked, uv is not on PATH")
    failed = []
    for name, command in checks.items():
        _section(name)
        failed += [name] if _run(command) else []
    _section("lint: " + (f"failed: {', '.join(failed)}" if failed else "clean"))
    return 1 if failed else 0


def bench(rest: list[str]) -> int:
    """Run the measurements in bench/, or those named; options go to each."""
    _install("test")
    _install_reference()
    scripts = {path.stem: path for path in sorted((ROOT / "bench").glob("[!_]*.py"))}
    options = [part for part in rest if part not in scripts]
    status = 0
    for name in [part for part in rest if part in scripts] or scripts:
        _section(f"bench: {name}")
        status |= _run([_python(), str(scripts[name]), *options])
    return status


def faults(rest: list[str]) -> int:
    """Kill real processes at named points and check that nothing is lost."""
    _install("test")
    _install_system_packages()
    _section("faults")
    return _hand_over([_python(), "-m", "tests.faults", *rest])


def fuzz(rest: list[str]) -> int:
    """Fuzz for a bounded time."""
    _install("test")
    _pip(VENV, "--require-hashes", "--no-deps", "-r", _lock_file("fuzz"))
    _section("fuzz")
    return _hand_over([_python(), "-m", "tests.fuzz.run", *rest])


def docs(rest: list[str]) -> int:
    """Build the documentation into site/; a broken link is an error."""
    del rest
    environment = CACHE / "docs"
    _install_apart(environment, "docs")
    _section("docs")
    os.environ["NO_MKDOCS_2_WARNING"] = "1"
    return _run([str(_bin(environment) / "mkdocs"), "build", "--strict", "--quiet"])


def lock(rest: list[str]) -> int:
    """Write (or with --check, check) the lock files; needs uv."""
    _install("test")
    return _run([_python(), "requirements/lock.py", *rest])


COMMANDS = [
    (install, False),
    (demo, True),
    (test, True),
    (lint, False),
    (bench, True),
    (faults, True),
    (fuzz, True),
    (docs, False),
    (lock, True),
]
"""Command and whether it takes further arguments."""


# Installation


def _install(level: str) -> None:
    """Bring .venv up to a level, `server` or `test`, unless it is there already."""
    stamp = VENV / "installed.json"
    wanted = {name: _digest(name) for name in ("build", level)}
    present = _read_stamp(stamp)
    enough = present.items() >= wanted.items() or (level == "server" and _is_current(present))
    if enough and Path(_python()).exists():
        return
    _section(f"install into {VENV.name}" + (" with uv" if _uv() else ""))
    _make_environment(VENV)
    _pip(VENV, "--require-hashes", "-r", _lock_file("build"), "-r", _lock_file(level))
    _pip(VENV, "--no-deps", "--no-build-isolation", "--editable", str(ROOT))
    stamp.write_text(json.dumps(wanted), encoding="utf-8")


def _is_current(present: dict[str, str]) -> bool:
    """Tell whether the environment for tests, which holds the server's, is up to date."""
    return present == {name: _digest(name) for name in ("build", "test")}


def _install_apart(environment: Path, level: str) -> None:
    """Install one lock file into an environment of its own, unless it is there already."""
    stamp = environment / "installed.json"
    wanted = {level: _digest(level)}
    if _read_stamp(stamp) == wanted:
        return
    _section(f"install into {environment.relative_to(ROOT)}" + (" with uv" if _uv() else ""))
    _make_environment(environment)
    _pip(environment, "--require-hashes", "--no-deps", "-r", _lock_file(level))
    stamp.write_text(json.dumps(wanted), encoding="utf-8")


def _install_reference() -> None:
    """Install the field's reference implementation, which runs in a process of its own."""
    environment = CACHE / "reference"
    _install_apart(environment, "reference")
    os.environ.setdefault("CS3D_REFERENCE_PYTHON", str(_bin(environment) / "python"))


def _digest(level: str) -> str:
    """Digest what decides an installation: the lock file, and pyproject.toml for the project itself."""
    content = Path(_lock_file(level)).read_bytes()
    if level == "build":
        content += (ROOT / "pyproject.toml").read_bytes()
    return hashlib.sha256(content).hexdigest()


def _read_stamp(stamp: Path) -> dict[str, str]:
    """Read what was installed last; nothing when there is no readable record of it."""
    try:
        record: dict[str, str] = json.loads(stamp.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return record


def _make_environment(environment: Path) -> None:
    """Make a virtual environment, or a new one when the present one does not run."""
    python = str(_bin(environment) / "python")
    if _version_of(python) >= OLDEST and (_uv() or _imports(python, "pip")):
        return
    interpreter = _find_interpreter()
    if _version_of(interpreter) < OLDEST:
        raise CannotContinueError(f"Python {_dotted(OLDEST)} or newer is needed; {interpreter} is older.")
    if _uv() is None:
        _ensure_venv(interpreter)
    shutil.rmtree(environment, ignore_errors=True)
    without_pip = ["--without-pip"] if _uv() else []
    subprocess.run([interpreter, "-m", "venv", *without_pip, str(environment)], check=True)


def _find_interpreter() -> str:
    """Choose the interpreter for .venv: the running one when it suits, else a suitable one on PATH, else the running."""
    if OLDEST <= sys.version_info[:2] <= NEWEST:
        return sys.executable
    for minor in range(NEWEST[1], OLDEST[1] - 1, -1):
        found = shutil.which(f"python3.{minor}")
        if found and _version_of(found) == (3, minor):
            return found
    return sys.executable


def _version_of(python: str) -> tuple[int, ...]:
    """Ask an interpreter for its version; () when it does not run."""
    try:
        answer = subprocess.run(
            [python, "-c", "import sys; print(*sys.version_info[:2])"], capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return ()
    return tuple(int(part) for part in answer.stdout.split())


def _ensure_venv(interpreter: str) -> None:
    """Make sure the interpreter can make environments with pip; bare Debian splits that off."""
    if _imports(interpreter, "ensurepip"):
        return
    package = f"python{_dotted(_version_of(interpreter))}-venv"
    if not _apt_install([package]) or not _imports(interpreter, "ensurepip"):
        raise CannotContinueError(
            f"{interpreter} has no ensurepip, which makes environments. Install the package {package}"
            f" (Debian, Ubuntu: sudo apt-get install {package}) or put uv on PATH, then run this again."
        )


def _imports(python: str, module: str) -> bool:
    """Tell whether an interpreter has a module."""
    return subprocess.run([python, "-c", f"import {module}"], capture_output=True, check=False).returncode == 0


def _pip(environment: Path, *arguments: str) -> None:
    """Install into an environment."""
    uv = _uv()
    python = str(_bin(environment) / "python")
    start = [uv, "pip", "install", "--python", python] if uv else [python, "-m", "pip", "install"]
    quiet = {"PIP_DISABLE_PIP_VERSION_CHECK": "1", "PIP_ROOT_USER_ACTION": "ignore"}
    subprocess.run([*start, "--quiet", *arguments], check=True, env={**os.environ, **quiet})


# System packages


def _install_system_packages() -> None:
    """Install the programs that tests start; when that is impossible, say what will be missing."""
    missing = [package for package, signs in SYSTEM_PACKAGES.items() if not any(map(_present, signs))]
    if not missing:
        return
    _section(f"system packages: {' '.join(missing)}")
    if _apt_install(missing):
        return
    print(
        f"Not installed: {', '.join(missing)}. With root rights: apt-get install {' '.join(missing)}\n"
        "Tests use Redis and PostgreSQL from wheels instead where they can; browser tests need Chromium."
    )


def _present(sign: str) -> bool:
    """Tell whether a command is on PATH or a file matches."""
    if sign.startswith("/"):
        return any(Path("/").glob(sign[1:]))
    return shutil.which(sign) is not None


def _apt_install(packages: list[str]) -> bool:
    """Install Debian packages when this is root on such a system; tell whether it worked."""
    if os.geteuid() != 0 or shutil.which("apt-get") is None:
        return False
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    install = ["apt-get", "-qq", "install", "--yes", "--no-install-recommends", *packages]
    print(" ".join(install), flush=True)
    subprocess.run(["apt-get", "-qq", "update"], env=environment, check=False)
    return subprocess.run(install, env=environment, stdout=subprocess.DEVNULL, check=False).returncode == 0


# Processes


def _run(command: list[str]) -> int:
    """Run a command to its end and return its status."""
    return subprocess.run(command, check=False).returncode


def _hand_over(command: list[str]) -> int:
    """Become the command, so that signals and the exit status are its own."""
    sys.stdout.flush()
    os.execv(command[0], command)  # noqa: S606 (no shell is wanted)


def _section(title: str) -> None:
    """Print a heading."""
    print(f"\n== {title}", flush=True)


def _uv() -> str | None:
    """Find uv."""
    return shutil.which("uv")


def _bin(environment: Path) -> Path:
    """Name an environment's folder of commands."""
    return environment / "bin"


def _python() -> str:
    """Name the interpreter of .venv."""
    return str(_bin(VENV) / "python")


def _tool(name: str) -> str:
    """Name a command of .venv."""
    return str(_bin(VENV) / name)


def _lock_file(level: str) -> str:
    """Name a lock file."""
    return str(ROOT / "requirements" / f"{level}.txt")


def _dotted(version: tuple[int, ...]) -> str:
    """Write a version down."""
    return ".".join(map(str, version))


if __name__ == "__main__":
    sys.exit(main())
