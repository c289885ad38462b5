"""Fuzzes what takes bytes from outside, for a bounded time: `python -m tests.fuzz.run [--seconds N] [--seed N] [--only PART]`.

Needs the test extra and requirements/fuzz.txt. Exit status: 0 nothing found, 1 a defect (the bytes that show it are
kept in artifacts/fuzz/; the API's are printed as a curl command), 2 atheris is not installed.
"""

import argparse
import importlib.util
import os
import secrets
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

ROOT = Path(__file__).parents[2]
DATA = ROOT / "tests" / "data"
ARTIFACTS = ROOT / "artifacts" / "fuzz"
CORPORA = {"archive": DATA / "archives", "document": DATA / "predictions"}
_LONGEST_INPUT = 4096


def main() -> int:
    """Run the parts one after the other; all of them, even when one finds something."""
    arguments = _parser().parse_args()
    chosen = [arguments.only] if arguments.only else list(PARTS)
    if set(chosen) & CORPORA.keys() and importlib.util.find_spec("atheris") is None:
        print("atheris is not installed: pip install -r requirements/fuzz.txt", file=sys.stderr)  # noqa: T201 -- a command
        return 2
    print(f"--seed {arguments.seed} repeats what is sent and tried", flush=True)  # noqa: T201 -- a command
    timed = sum(name != "schema" for name in chosen)
    statuses = [PARTS[name](max(2, arguments.seconds // max(1, timed)), arguments.seed) for name in chosen]
    return 1 if any(statuses) else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description="Fuzz archive reader, decoder and API for a bounded time.")
    parser.add_argument(
        "--seconds", type=int, default=90, help="for archive, document and api together, a third each (default: 90)"
    )
    parser.add_argument("--seed", type=int, default=secrets.randbelow(2**31), help="default: another one each time")
    parser.add_argument("--only", choices=PARTS, help="one part, with all of the time")
    return parser


def _schema(seconds: int, seed: int) -> int:
    """Run the properties of documents; their number is fixed, whatever the time."""
    del seconds
    return _pytest("--noconftest", f"--hypothesis-seed={seed}", "tests/fuzz/schema.py")


def _api(seconds: int, seed: int) -> int:
    """Send generated requests to the application, for half of the time in each shape."""
    shares = {"CS3D_FUZZ_SECONDS": str(seconds / 2), "CS3D_FUZZ_SEED": str(seed)}
    return _pytest("tests/fuzz/api.py", **shares)


def _pytest(*arguments: str, **environment: str) -> int:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments]
    return subprocess.run(command, cwd=ROOT, env={**os.environ, **environment}, check=False).returncode


def _atheris(target: str, seconds: int, seed: int) -> int:
    """Run one target, starting from the corpus."""
    ARTIFACTS.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for number, path in enumerate(sorted(CORPORA[target].glob("*/*"))):
            if path.stat().st_size <= _LONGEST_INPUT:
                shutil.copyfile(path, Path(folder, str(number)))
        bounds = [f"-max_total_time={seconds}", f"-max_len={_LONGEST_INPUT}", "-timeout=10", "-rss_limit_mb=2048"]
        prefix = f"-artifact_prefix={ARTIFACTS}{os.sep}{target}-"
        options = [*bounds, f"-seed={seed}", prefix, "-print_final_stats=1", folder]
        command = [sys.executable, "-m", "tests.fuzz.atheris_target", target, *options]
        return subprocess.run(command, cwd=ROOT, check=False).returncode


PARTS: dict[str, Callable[[int, int], int]] = {
    "schema": _schema,
    "archive": partial(_atheris, "archive"),
    "document": partial(_atheris, "document"),
    "api": _api,
}
"""Part -> what runs it for some seconds with a seed, and gives the exit status."""


if __name__ == "__main__":
    sys.exit(main())
