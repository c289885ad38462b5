#!/usr/bin/env python3
"""Write the lock files beside this script, or check them: `python3 do.py lock [--check]`. Needs uv on PATH.

No lock file names a package index: hashes decide what is installed, wherever it comes from.
"""

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

FOLDER = Path(__file__).resolve().parent

OLDEST_PYTHON = "3.11"

SOURCES = {
    "base": ["pyproject.toml"],
    "server": ["pyproject.toml", "--extra", "server"],
    "test": ["pyproject.toml", "--extra", "server", "--extra", "test"],
    "build": ["requirements/build.in"],
    "docs": ["requirements/docs.in"],
    "fuzz": ["requirements/fuzz.in"],
    # Without dependencies: the reference asks for a desktop toolkit that its evaluation does not use.
    "reference": ["requirements/reference.in", "--no-deps"],
}
"""Name of a lock file -> what uv resolves it from."""


def main() -> int:
    """Lock or check; 1 when something is stale, 2 for wrong usage."""
    if sys.argv[1:] not in ([], ["--check"]):
        print("usage: lock.py [--check]", file=sys.stderr)
        return 2
    if shutil.which("uv") is None:
        print("Locking needs uv on PATH; install it, then run this again.", file=sys.stderr)
        return 2
    return check() if sys.argv[1:] else write()


def write() -> int:
    """Resolve again, keeping present versions where they still fit."""
    for name in SOURCES:
        print(f"locking {name}", flush=True)
        _resolve(name, FOLDER / f"{name}.txt").check_returncode()
    return 0


def check() -> int:
    """Tell which lock files no longer follow from their sources."""
    stale = [problem for name in SOURCES if (problem := _problem(name))]
    print("\n".join(stale) or "Every lock file follows from its source.")
    return 1 if stale else 0


def _problem(name: str) -> str | None:
    """Resolve a copy of one lock file and compare."""
    locked = FOLDER / f"{name}.txt"
    with tempfile.TemporaryDirectory() as folder:
        again = Path(shutil.copy(locked, folder))
        resolved = _resolve(name, again)
        if resolved.returncode:
            return f"{locked.name}: uv cannot resolve it: {resolved.stderr.strip()}"
        if _pins(again) != _pins(locked):
            return f"{locked.name} does not follow from {SOURCES[name][0]}; run python3 do.py lock"
    return None


def _pins(locked: Path) -> set[str]:
    """Read the names and versions of a lock file."""
    return set(re.findall(r"^[A-Za-z0-9][^ \\]*==[^ \\;]+", locked.read_text(encoding="utf-8"), re.MULTILINE))


def _resolve(name: str, output: Path) -> subprocess.CompletedProcess[str]:
    """Let uv resolve one lock file."""
    options = [
        "--universal",
        "--python-version",
        OLDEST_PYTHON,
        "--generate-hashes",
        "--no-emit-index-url",
        "--no-header",
    ]
    command = ["uv", "pip", "compile", "--quiet", *SOURCES[name], *options, "--output-file", str(output)]
    return subprocess.run(command, cwd=FOLDER.parent, stderr=subprocess.PIPE, text=True, check=False)


if __name__ == "__main__":
    sys.exit(main())
