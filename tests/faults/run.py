"""The fault programme: a real installation is attacked while participants use it; afterwards every promise is checked.

    python3 do.py faults [--seed N] [--long] [--shape embedded|scale_out] [--sabotage NAME]

Short: 100 submissions and 20 kills, shared by the two shapes. Long: 1,000 and 200, every target at every point. Besides
the kills each shape goes through messages sent five times, processes whose clocks are up to an hour wrong, a flushed, a
frozen and a missing broker, a missing database, a full disk, a frozen worker that wakes up late, an upload that stands
still, predictions that crash their process or exhaust its memory, a small quota, and a rolling restart. The last line
is one sentence with the figures; the exit status is 0 only when every promise holds. A run that fails also tells how
everything stood.
"""

import argparse
import random
import secrets
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import sqlalchemy as sa

from server.errors import Unavailable
from server.models import Submission, SubmissionState
from tests.faults import attacks, diagnosis, disk, plan
from tests.faults.clients import Clients
from tests.faults.deployment import TARGETS, Deployment
from tests.faults.sabotage import SABOTAGES
from tests.faults.verdict import judge

UNMET_S = 600.0
"""When no kill came about for so long, none ever will."""

STUCK_S = 120.0
"""When no submission comes to its end for so long after the last fault, those that are left never will."""

TRIES = 8
"""For a kill whose victim or moment did not come about, at one worker and the other in turn."""


@dataclass(frozen=True, kw_only=True)
class Programme:
    """What one shape goes through."""

    seed: int
    count: int
    kills: int
    attacks: tuple[str, ...]
    sabotaged: str | None
    stuck_s: float
    mount: bool
    """True: the disk that gets full is a real one."""
    kept: Path | None
    """Where the files of the installation are left, for who looks for a cause; None: they are deleted."""


@dataclass(kw_only=True)
class Figures:
    """What happened, for the last lines."""

    shape: str
    targets: tuple[str, ...]
    killed: Counter[plan.Pair] = field(default_factory=Counter)
    others: Counter[str] = field(default_factory=Counter)
    states: Counter[SubmissionState] = field(default_factory=Counter)
    statuses: Counter[int] = field(default_factory=Counter)
    attempts: int = 0
    disk_was_real: bool = False
    broken: list[str] = field(default_factory=list)


def attack(shape: str, programme: Programme) -> Figures:
    """Run one shape from its start to the verdict."""
    with _folder(shape, programme.kept) as folder:
        deployment = Deployment(shape, folder, mount=programme.mount, sabotaged=programme.sabotaged)
        targets = tuple(name for name in TARGETS if name != "database" or deployment.database)
        figures = Figures(shape=shape, targets=targets, disk_was_real=deployment.disk.is_real)
        try:
            _run(deployment, figures, programme)
        except Exception as error:
            error.add_note(_described(deployment))
            raise
        finally:
            deployment.services.close()
            deployment.close()
    _tell(figures)
    return figures


@contextmanager
def _folder(shape: str, kept: Path | None) -> Iterator[Path]:
    if kept is not None:
        yield kept / shape
        return
    with tempfile.TemporaryDirectory(prefix="cs3d-faults-", ignore_cleanup_errors=True) as name:
        yield Path(name)


def _run(deployment: Deployment, figures: Figures, programme: Programme) -> None:
    deployment.wait_until_ready()
    with Clients(deployment, seed=programme.seed) as clients:
        _kill(deployment, figures, programme)
        for name in programme.attacks:
            if deployment.database or name not in attacks.NEEDS_DATABASE_SERVER:
                attacks.OTHERS[name](deployment, clients)
                figures.others[name] += 1
                _say(f"{deployment.shape}: {name}")
        _wait_for_submissions(deployment, clients, programme.count)
    deployment.revive()
    deployment.wait_until_ready()
    figures.broken += _settle(deployment, programme.stuck_s)
    if figures.broken:  # said before the workers are stopped
        _say(_described(deployment))
    deployment.drain()
    figures.statuses = clients.statuses
    figures.broken += judge(deployment, clients)
    _count(deployment, figures)


def _described(deployment: Deployment) -> str:
    return f"{deployment.shape}: {diagnosis.describe(deployment.services, deployment.fronts, deployment.faults)}"


def _wait_for_submissions(deployment: Deployment, clients: Clients, enough: int) -> None:
    """Wait for as many submissions as the programme wants; each next one comes in time, however slow the machine is."""
    for count in range(len(clients.accepted), enough):
        attacks.wait_for(deployment, partial(_have_sent, clients, count + 1), "one more submission")


def _have_sent(clients: Clients, count: int) -> bool:
    return len(clients.accepted) >= count


def _kill(deployment: Deployment, figures: Figures, programme: Programme) -> None:
    chance = random.Random(programme.seed)  # noqa: S311 - a plan, not a secret
    planned = plan.kills(chance, figures.targets)
    met_s = time.monotonic()
    while figures.killed.total() < programme.kills:
        point, target = next(planned)
        index = chance.randrange(2)
        done = any(attacks.kill_at(deployment, point, target, index=index + tried) for tried in range(TRIES))
        figures.killed[point, target] += done
        _say(f"{deployment.shape}: {target} {'killed' if done else 'was not there'} at {point}")
        met_s = time.monotonic() if done else met_s
        if time.monotonic() - met_s > UNMET_S:
            message = f"no kill came about within {UNMET_S:g} s"
            raise TimeoutError(message)
    if programme.kills >= len(plan.pairs(figures.targets)):
        for point, target in sorted(plan.pairs(figures.targets) - set(+figures.killed)):
            figures.broken.append(f"the plan was not carried out: {target} was never killed at {point}")


def _settle(deployment: Deployment, stuck_s: float) -> Iterator[str]:
    """Wait until nothing is on its way, for as long as anything moves, without helping."""
    left = deployment.unfinished()
    moved_s = time.monotonic()
    while left and time.monotonic() - moved_s < stuck_s:
        time.sleep(0.2)
        before = left.keys()
        with suppress(Unavailable):  # it is asked again in a moment
            left = deployment.unfinished()
        if left.keys() != before:
            moved_s = time.monotonic()
    for submission_id, state in left.items():
        yield f"{submission_id} is stuck in {state}"


def _count(deployment: Deployment, figures: Figures) -> None:
    with deployment.services.snapshot() as session:
        for row in session.scalars(sa.select(Submission)):
            figures.states[row.state] += 1
            figures.attempts += row.attempt


def _tell(figures: Figures) -> None:
    """Say what was done, with counts."""
    _say(f"{figures.shape}: kills by target and point")
    for line in plan.table(figures.killed, figures.targets):
        _say(f"  {line}")
    disk_kind = "a real file system" if figures.disk_was_real else "imitated"
    others = ", ".join(f"{count} x {name}" for name, count in figures.others.items())
    _say(f"{figures.shape}: other faults: {others or 'none'}; the full disk is {disk_kind}")
    answers = ", ".join(f"{count} x {status}" for status, count in sorted(figures.statuses.items()))
    _say(f"{figures.shape}: answers to uploads: {answers}")


def _say(text: str) -> None:
    sys.stdout.write(f"{time.strftime('%H:%M:%S')} {text}\n")
    sys.stdout.flush()


def main() -> int:
    """Attack both shapes and say what came of it."""
    arguments = _arguments()
    count, kills, rounds = (1000, 200, 3) if arguments.long else (100, 20, 1)
    count, kills = arguments.submissions or count, arguments.kills if arguments.kills is not None else kills
    shapes = [arguments.shape] if arguments.shape else ["embedded", "scale_out"]
    _say(f"seed {arguments.seed}")
    began_s = time.monotonic()
    programme = Programme(
        seed=arguments.seed,
        count=-(-count // len(shapes)),
        kills=-(-kills // len(shapes)),
        attacks=tuple(arguments.attacks.split(",")) * rounds if arguments.attacks else (),
        sabotaged=arguments.sabotage,
        stuck_s=arguments.stuck,
        mount=disk.can_mount(),
        kept=arguments.keep,
    )
    results = [attack(shape, programme) for shape in shapes]
    broken = [line for figures in results for line in figures.broken]
    for line in broken:
        _say(f"BROKEN {line}")
    _say(f"Seed {arguments.seed}: {_sum_up(results)} in {time.monotonic() - began_s:.0f} s.")
    return 1 if broken else 0


def _sum_up(results: list[Figures]) -> str:
    states = sum((figures.states for figures in results), Counter[SubmissionState]())
    scored, rejected = states[SubmissionState.SCORED], states[SubmissionState.REJECTED]
    failed = states[SubmissionState.FAILED]
    lost = sum(figures.attempts for figures in results) - scored - rejected
    return (
        f"{states.total()} submissions, {sum(figures.killed.total() for figures in results)} kills and"
        f" {sum(figures.others.total() for figures in results)} other faults on"
        f" {' and '.join(figures.shape for figures in results)}: {scored} scored once, {rejected} rejected,"
        f" {failed} failed as they had to, {lost} attempts lost or returned,"
        f" {sum(len(figures.broken) for figures in results)} promises broken,"
    )


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="do.py faults", description=__doc__)
    parser.add_argument("--seed", type=int, default=secrets.randbelow(1_000_000), help="repeat a run")
    parser.add_argument("--long", action="store_true", help="1,000 submissions and 200 kills")
    parser.add_argument("--shape", choices=("embedded", "scale_out"), help="only this one")
    parser.add_argument("--submissions", type=int, help="another number of submissions")
    parser.add_argument("--kills", type=int, help="another number of kills")
    parser.add_argument("--attacks", default=",".join(attacks.OTHERS), help="what is done besides killing")
    parser.add_argument("--stuck", type=float, default=STUCK_S, help="seconds without progress that count as stuck")
    parser.add_argument("--keep", type=Path, help="leave everything in this folder")
    parser.add_argument("--sabotage", choices=sorted(SABOTAGES), help="take a safeguard out: the run has to fail")
    return parser.parse_args()
