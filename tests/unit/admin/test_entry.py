"""`cs3d-admin` as it is installed: with the server's packages, or with the evaluator's alone."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize(
    ("flags", "status", "printed", "complained"),
    [
        ([], 0, "usage: cs3d-admin", ""),
        (
            ["-E", "-S"],
            1,
            "",
            'cs3d-admin: the server needs packages that are not installed (pydantic): pip install ".[server]"',
        ),
    ],
    ids=["server installed", "without site-packages"],
)
def test_the_installed_command_starts_or_says_what_is_missing(
    flags: list[str], status: int, printed: str, complained: str
) -> None:
    """Without the extra `server` there is one line with the fix, and no traceback."""
    place = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]["cs3d-admin"]
    module, function = place.split(":")
    script = f"import sys; from {module} import {function}; sys.exit({function}())"

    ended = subprocess.run(
        [sys.executable, *flags, "-c", script, "--help"], cwd=ROOT, capture_output=True, text=True, check=False
    )

    assert (ended.returncode, ended.stdout[: len(printed)], ended.stderr.rstrip("\n")) == (status, printed, complained)
