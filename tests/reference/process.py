"""The reference implementation in a process of its own."""

import json
import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = Path(__file__).with_name("run_reference.py")


def reference_python() -> Path | None:
    """Return the interpreter that has the reference installed; `python3 do.py test` makes it."""
    named = os.environ.get("CS3D_REFERENCE_PYTHON")
    path = Path(named) if named else ROOT / ".cache" / "reference" / "bin" / "python"
    return path if path.exists() else None


def required_reference() -> Path:
    """Return that interpreter; without it the test is skipped on a laptop and fails in CI, where nothing may be missing."""
    python = reference_python()
    if python is None:
        message = "The reference is not installed; run the tests with `python3 do.py test`."
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return python


def reference_results(cases: list[dict[str, Any]], python: Path) -> list[Any]:
    """Evaluate all cases in one process.

    Args:
        cases: Each with "gt", "pred" (folders) and "parameters"
            (`PARAMETERS` of run_reference.py; what is left out keeps its default).
        python: What `reference_python` found.

    Returns:
        The reference's results document of each case.
    """
    with tempfile.TemporaryDirectory() as folder:
        cases_file, results_file = Path(folder) / "cases.json", Path(folder) / "results.json"
        cases_file.write_text(json.dumps(cases), encoding="utf-8")
        command: list[str | Path] = [python, "-W", "ignore", SCRIPT, cases_file, results_file]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"The reference failed:\n{done.stderr[-4000:]}")
        return list(json.loads(results_file.read_text(encoding="utf-8")))
