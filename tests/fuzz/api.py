"""The OpenAPI document against the running application, in both shapes, for the time in CS3D_FUZZ_SECONDS.

The same checks as tests/integration/api/test_contract.py. What is sent follows from CS3D_FUZZ_SEED.
"""

import itertools
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, settings

from server import benchmarks
from tests.integration.api.contract import Caller, check_operation, make_existing, operations
from tests.integration.site import Site

EXAMPLES = 20
"""Requests generated for an operation, a caller and a round."""

BOUNDS = settings(
    max_examples=EXAMPLES,
    deadline=None,
    database=None,
    phases=[Phase.explicit, Phase.generate, Phase.shrink],
    suppress_health_check=list(HealthCheck),
)


def test_every_answer_is_documented_for_long(
    site: Site, archive: bytes, score: Callable[[str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    """Whoever asks and whatever they ask, they get only what the document promises, round after round."""
    seed, end_s = os.environ["CS3D_FUZZ_SEED"], time.monotonic() + float(os.environ["CS3D_FUZZ_SECONDS"])
    _lift_quota(site)
    statuses: list[int] = []
    for turn, caller, operation in _turns(site, archive, score, statuses):
        check_operation(operation, caller, BOUNDS, seed=f"{seed}, {turn}")
        if time.monotonic() > end_s:
            break
    with capsys.disabled():
        print(f"\nseed {seed}, to {turn}: {len(statuses)} answers, {dict(sorted(Counter(statuses).items()))}")  # noqa: T201 -- the result of a command


def _lift_quota(site: Site) -> None:
    """Let the team send submissions for hours."""
    with site.services.transaction() as session:
        benchmarks.find_phase(session, "cs3d", "test").submissions_per_day = 1_000_000


def _turns(
    site: Site, archive: bytes, score: Callable[[str], None], statuses: list[int]
) -> Iterator[tuple[str, Caller, Any]]:
    """Give one operation after the other to each caller, without end: the turn's name, the caller, the operation.

    For each caller there is an upload and a published submission that no other one changed. Only what cancels meets a
    submission that waits for a worker: whoever asked for the state of such a one would be kept waiting, too.
    """
    member = site.token()
    maintainer = site.stranger(email="max@example.org", team="maintainers", is_maintainer=True)
    tokens = {"member": member, "maintainer": maintainer, "nobody": None}
    for number in itertools.count(1):
        for name, token in tokens.items():
            caller = Caller(token=token, existing=make_existing(site, member, archive, score), statuses=statuses)
            for operation in operations(site):
                turn = f"round {number}, {name}, {operation.label}"
                if operation.path.endswith("/cancel"):
                    yield turn, replace(caller, existing=make_existing(site, member, archive, None)), operation
                else:
                    yield turn, caller, operation
