"""Atheris under pytest, for `python3 do.py fuzz`; CS3D_FUZZ_SECONDS for each target, 30 by default."""

import importlib.util
import os

import pytest

from tests.fuzz.run import SEEDS, fuzz_with_atheris


@pytest.mark.parametrize("target", SEEDS)
def test_no_input_breaks_what_must_hold(target: str) -> None:
    """Whatever bytes arrive, reading ends with a report, and both of its paths agree."""
    if importlib.util.find_spec("atheris") is None:
        message = "atheris is not installed: pip install -r requirements/fuzz.txt"
        pytest.fail(message) if os.environ.get("CI") else pytest.skip(message)
    assert fuzz_with_atheris(target, int(os.environ.get("CS3D_FUZZ_SECONDS", "30"))) == 0
