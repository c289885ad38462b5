"""The fault programme notices when a safeguard is missing: with each one taken out, its run fails and says why."""

import subprocess
import sys

import pytest

from server.settings import Settings
from tests.services.worker import ROOT, environment_of

CASES = {
    # Without the fence a worker that wakes up late writes into a submission that another has scored.
    "fence": ("freeze_worker", "raised unexpected"),
    # Without the key and with a second write the score stands there twice.
    "unique_key": ("", "no_score_is_written_twice"),
    # A message sent before the commit finds no row; only the sweeper's message helps.
    "early_message": ("", "only after the sweeper"),
    # Without the sweeper what was not sent while the broker was away waits for ever.
    "sweeper": ("take_broker_away", "is stuck in"),
}


@pytest.mark.parametrize("sabotage", CASES)
def test_a_missing_safeguard_is_noticed(sabotage: str) -> None:
    """The run with the safeguard taken out ends with status 1 and names the broken promise."""
    attacks, complaint = CASES[sabotage]
    arguments = ["--seed", "1", "--shape", "scale_out", "--submissions", "4", "--kills", "0", "--recovery", "20"]
    run = subprocess.run(
        [sys.executable, "-m", "tests.faults", *arguments, "--attacks", attacks, "--sabotage", sabotage],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=environment_of(Settings()),
        check=False,
    )
    assert run.returncode == 1, run.stdout + run.stderr
    assert complaint in run.stdout, run.stderr
