"""Fuzzes the intake for a bounded time: `python -m tests.fuzz.run [--seconds N]`.

Needs the test extra and requirements/fuzz.txt. Exit status: 0 nothing found, 1 a defect (the input that shows it is
kept in artifacts/fuzz/), 2 atheris is not installed.
"""

import argparse
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
DATA = ROOT / "tests" / "data"
ARTIFACTS = ROOT / "artifacts" / "fuzz"
SEEDS = {"archive": DATA / "archives", "document": DATA / "predictions"}
_LONGEST_INPUT = 4096


def main() -> int:
    """Run hypothesis once, then atheris on both targets for half of the time each."""
    parser = argparse.ArgumentParser(description="Fuzz the archive reader and the decoder for a bounded time.")
    parser.add_argument("--seconds", type=int, default=60, help="for both atheris targets together (default: 60)")
    seconds = parser.parse_args().seconds
    if importlib.util.find_spec("atheris") is None:
        print("atheris is not installed: pip install -r requirements/fuzz.txt", file=sys.stderr)  # noqa: T201 -- a command
        return 2
    statuses = [_hypothesis(), *(_atheris(target, max(1, seconds // 2)) for target in SEEDS)]
    return 1 if any(statuses) else 0


def _hypothesis() -> int:
    """Run the schema's properties."""
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "--noconftest",
        "-o",
        "python_files=schema.py",
        "tests/fuzz",
    ]
    return subprocess.run(command, cwd=ROOT, check=False).returncode


def _atheris(target: str, seconds: int) -> int:
    """Run one target, starting from the corpus."""
    ARTIFACTS.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for number, path in enumerate(sorted(SEEDS[target].glob("*/*"))):
            if path.stat().st_size <= _LONGEST_INPUT:
                shutil.copyfile(path, Path(folder, str(number)))
        options = [f"-max_total_time={seconds}", f"-max_len={_LONGEST_INPUT}", "-timeout=10", "-rss_limit_mb=2048"]
        prefix = f"-artifact_prefix={ARTIFACTS}{os.sep}{target}-"
        command = [
            sys.executable,
            "-m",
            "tests.fuzz.atheris_target",
            target,
            *options,
            prefix,
            "-print_final_stats=1",
            folder,
        ]
        return subprocess.run(command, cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
