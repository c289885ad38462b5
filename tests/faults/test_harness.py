"""The fault programme notices when a safeguard is missing: with each one taken out, its run fails and says why."""

import random
import subprocess
import sys
from itertools import islice

import pytest

from server.settings import Settings
from tests.faults import plan
from tests.faults.deployment import TARGETS
from tests.services.worker import ROOT, environment_of

CASES = {
    # Without the fence a worker that wakes up late writes into a submission that another has scored.
    "fence": ("freeze_worker", "raised unexpected"),
    # Without the key and with a second write, which is put in too, the score stands there twice.
    "unique_key": ("", "no_score_is_written_twice"),
    # A message sent before the commit finds no row, when the upload that sent it stands still for a moment.
    "early_message": ("hold_upload", "came before its row"),
    # Without the sweeper what was not sent while the broker was away waits for ever.
    "sweeper": ("take_broker_away", "is stuck in"),
}


@pytest.mark.parametrize("sabotage", CASES)
def test_a_missing_safeguard_is_noticed(sabotage: str) -> None:
    """The run with the safeguard taken out ends with status 1 and names the broken promise."""
    attacks, complaint = CASES[sabotage]
    # What waits for the sweeper that was taken out waits for ever, so a short patience is enough.
    arguments = ["--seed", "1", "--shape", "scale_out", "--submissions", "4", "--kills", "0", "--stuck", "15"]
    run = _run(*arguments, "--attacks", attacks, "--sabotage", sabotage)
    assert run.returncode == 1, run.stdout + run.stderr
    assert complaint in run.stdout, run.stdout + run.stderr


def test_every_promise_is_kept() -> None:
    """The short programme, 100 submissions and 20 kills over both shapes, finds nothing broken."""
    run = _run("--seed", "20261122")
    assert run.returncode == 0, run.stdout + run.stderr
    assert "0 promises broken" in run.stdout.splitlines()[-1]


@pytest.mark.parametrize("targets", [TARGETS, tuple(name for name in TARGETS if name != "database")])
def test_the_plan_has_every_target_at_every_point(targets: tuple[str, ...]) -> None:
    """Nobody is left out: as many kills as there are pairs are one of each."""
    pairs = plan.pairs(targets)
    planned = plan.kills(random.Random(3), targets)  # noqa: S311 - a plan, not a secret
    assert set(islice(planned, len(pairs))) == pairs


def _run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "tests.faults", *arguments],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=environment_of(Settings()),
        check=False,
    )
