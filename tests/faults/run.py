"""The fault programme: a real installation is attacked while participants use it; afterwards every promise is checked.

    python3 do.py faults [--seed N] [--long] [--shape embedded|scale_out] [--sabotage NAME]

Short: 100 submissions and 20 kills, shared by the two shapes. Long: 1,000 and 200. Besides the kills each shape goes
through messages sent five times, a worker whose clock is an hour fast, a flushed, a frozen and a missing broker, full
disks, a frozen worker that wakes up late, and a rolling restart. The last line is one sentence with the figures; the
exit status is 0 only when every promise holds.
"""

import argparse
import random
import secrets
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import sqlalchemy as sa

from server.models import Submission, SubmissionState
from tests.faults import attacks, hooks
from tests.faults.clients import Clients
from tests.faults.deployment import TARGETS, Deployment
from tests.faults.sabotage import SABOTAGES
from tests.faults.verdict import judge
from tests.services.processes import wait_until

PATIENCE_S = 300.0
"""The participants make their submissions within this after the last attack."""

RECOVERY_S = 90.0
"""After the last fault everything has to be done within this."""


@dataclass(kw_only=True)
class Figures:
    """What happened, for the last line."""

    submissions: int = 0
    kills: int = 0
    scored: int = 0
    rejected: int = 0
    attempts_lost: int = 0
    broken: list[str] = field(default_factory=list)


def plan_kills(chance: random.Random, targets: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Pair points with targets for ever, so that each comes up about as often as any other."""
    return zip(_shuffled(chance, hooks.POINTS), _shuffled(chance, targets), strict=False)


def _shuffled(chance: random.Random, choices: tuple[str, ...]) -> Iterator[str]:
    while True:
        yield from chance.sample(choices, len(choices))


@dataclass(frozen=True, kw_only=True)
class Programme:
    """What one shape goes through."""

    seed: int
    count: int
    kills: int
    attacks: tuple[str, ...]
    sabotaged: str | None
    recovery_s: float


def attack(shape: str, programme: Programme) -> Figures:
    """Run one shape from its start to the verdict."""
    figures = Figures()
    with tempfile.TemporaryDirectory(prefix="cs3d-faults-", ignore_cleanup_errors=True) as folder:
        deployment = Deployment(shape, Path(folder), sabotaged=programme.sabotaged)
        try:
            _run(deployment, figures, programme)
        finally:
            deployment.services.close()
            deployment.close()
    return figures


def _run(deployment: Deployment, figures: Figures, programme: Programme) -> None:
    chance = random.Random(programme.seed)  # noqa: S311 - a plan, not a secret
    figures.broken += attacks.calm(deployment)
    clients = Clients(deployment, seed=programme.seed)
    try:
        targets = tuple(name for name in TARGETS if name != "database" or deployment.database)
        plan = plan_kills(chance, targets)
        while figures.kills < programme.kills:
            point, target = next(plan)
            done = attacks.kill_at(deployment, point, target, index=chance.randrange(2))
            figures.kills += done
            _say(f"{deployment.shape}: {target} {'killed' if done else 'was not there'} at {point}")
        for name in programme.attacks:
            attacks.OTHERS[name](deployment)
            _say(f"{deployment.shape}: {name}")
        enough = programme.count
        wait_until(lambda: len(clients.accepted) >= enough, timeout_s=PATIENCE_S, what=f"{enough} submissions")
    finally:
        clients.stop()
    deployment.revive()
    deployment.wait_until_ready()
    figures.broken += _settle(deployment, programme.recovery_s)
    deployment.drain()
    figures.broken += judge(deployment, clients)
    _count(deployment, figures)


def _settle(deployment: Deployment, recovery_s: float) -> Iterator[str]:
    """Wait until nothing is on its way, without helping."""
    try:
        wait_until(lambda: not deployment.unfinished(), timeout_s=recovery_s, what="the end of every submission")
    except TimeoutError:
        for submission_id, state in deployment.unfinished().items():
            yield f"{submission_id} is stuck in {state}"


def _count(deployment: Deployment, figures: Figures) -> None:
    with deployment.services.snapshot() as session:
        rows = list(session.scalars(sa.select(Submission)))
        figures.submissions = len(rows)
        figures.scored = sum(row.state is SubmissionState.SCORED for row in rows)
        figures.rejected = sum(row.state is SubmissionState.REJECTED for row in rows)
        figures.attempts_lost = sum(row.attempt for row in rows) - figures.scored - figures.rejected


def _say(text: str) -> None:
    sys.stdout.write(f"{time.strftime('%H:%M:%S')} {text}\n")
    sys.stdout.flush()


def main() -> int:
    """Attack both shapes and say what came of it."""
    arguments = _arguments()
    count, kills = (1000, 200) if arguments.long else (100, 20)
    count, kills = arguments.submissions or count, arguments.kills if arguments.kills is not None else kills
    shapes = [arguments.shape] if arguments.shape else ["embedded", "scale_out"]
    _say(f"seed {arguments.seed}")
    began_s = time.monotonic()
    programme = Programme(
        seed=arguments.seed,
        count=count // len(shapes),
        kills=kills // len(shapes),
        attacks=tuple(arguments.attacks.split(",")) if arguments.attacks else (),
        sabotaged=arguments.sabotage,
        recovery_s=arguments.recovery,
    )
    results = [attack(shape, programme) for shape in shapes]
    broken = [line for figures in results for line in figures.broken]
    for line in broken:
        _say(f"BROKEN {line}")
    total = {name: sum(getattr(figures, name) for figures in results) for name in FIGURES}
    _say(
        f"Seed {arguments.seed}: {total['submissions']} submissions, {total['kills']} kills and"
        f" {len(programme.attacks) * len(shapes)} other faults in {time.monotonic() - began_s:.0f} s on"
        f" {' and '.join(shapes)}: {total['scored']} scored once, {total['rejected']} rejected,"
        f" {total['attempts_lost']} attempts lost or returned, {len(broken)} promises broken."
    )
    return 1 if broken else 0


FIGURES = ("submissions", "kills", "scored", "rejected", "attempts_lost")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="do.py faults", description=__doc__)
    parser.add_argument("--seed", type=int, default=secrets.randbelow(1_000_000), help="repeat a run")
    parser.add_argument("--long", action="store_true", help="1,000 submissions and 200 kills")
    parser.add_argument("--shape", choices=("embedded", "scale_out"), help="only this one")
    parser.add_argument("--submissions", type=int, help="another number of submissions")
    parser.add_argument("--kills", type=int, help="another number of kills")
    parser.add_argument("--attacks", default=",".join(attacks.OTHERS), help="what is done besides killing")
    parser.add_argument("--recovery", type=float, default=RECOVERY_S, help="seconds until everything must be done")
    parser.add_argument("--sabotage", choices=sorted(SABOTAGES), help="take a safeguard out: the run has to fail")
    return parser.parse_args()
