"""Rules that hold for the whole tree."""

import re
import subprocess
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[3]
REQUIREMENTS = ROOT / "requirements"
LONGEST_FILE = 400
LOCKS = sorted(REQUIREMENTS.glob("*.txt"))


def _tracked(pattern: str) -> list[Path]:
    listed = subprocess.run(["git", "ls-files", pattern], cwd=ROOT, capture_output=True, text=True, check=True)
    return [ROOT / name for name in listed.stdout.split() if (ROOT / name).exists()]


def _pins(lock: Path) -> dict[str, set[str]]:
    """Read name -> versions of a lock file."""
    pins: dict[str, set[str]] = {}
    for name, version in re.findall(r"^([A-Za-z0-9._-]+)(?:\[[^]]*\])?==([^ ;\\]+)", lock.read_text(), re.MULTILINE):
        pins.setdefault(name.lower().replace("_", "-"), set()).add(version)
    return pins


def test_no_python_file_is_too_long_to_find_ones_way_in() -> None:
    """Every file has at most 400 lines; a longer one wants to be split."""
    lengths = {path.relative_to(ROOT): path.read_bytes().count(b"\n") for path in _tracked("*.py")}
    assert {path: length for path, length in lengths.items() if length > LONGEST_FILE} == {}


@pytest.mark.parametrize("lock", LOCKS, ids=lambda lock: lock.stem)
def test_every_locked_version_has_hashes_and_no_place(lock: Path) -> None:
    """A lock file says what to install, by hash, and never where from."""
    text = lock.read_text()
    assert _pins(lock)
    for block in re.split(r"\n(?=[A-Za-z0-9])", text):
        assert "--hash=sha256:" in block
    assert "://" not in text
    assert "index" not in re.sub(r"# via.*|#   .*", "", text)


@pytest.mark.parametrize(
    ("lock", "extras"),
    [("base", []), ("server", ["server"]), ("test", ["server", "test"])],
    ids=["base", "server", "test"],
)
def test_lock_files_satisfy_the_project(lock: str, extras: list[str]) -> None:
    """Every requirement of pyproject.toml is locked to versions that fulfil it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = [*project["dependencies"], *(line for extra in extras for line in project["optional-dependencies"][extra])]
    pins = _pins(REQUIREMENTS / f"{lock}.txt")
    for requirement in map(Requirement, wanted):
        versions = pins[requirement.name.lower().replace("_", "-")]
        assert all(requirement.specifier.contains(version) for version in versions), requirement


def test_no_file_names_a_package_index() -> None:
    """Where packages come from is the business of the machine, not of the tree."""
    hosts = ["py" + "pi.org", "pythonhosted" + ".org", "registry.npm" + "js.org"]
    found = subprocess.run(
        ["git", "grep", "-lIF", *(part for host in hosts for part in ("-e", host))],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert found.stdout == ""


@pytest.mark.parametrize("script", ["do.py", ".ci/run"])
def test_scripts_may_be_run(script: str) -> None:
    """Both entry points are executable."""
    assert (ROOT / script).stat().st_mode & 0o111
