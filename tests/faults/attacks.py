"""What is done to a deployment. Each attack ends with everything running again; recovery is left to the record.

Attacks wait for what they want to meet, however long that takes, and not for a time: the same on any machine.
"""

import signal
import time
from collections.abc import Callable

from tests.faults import points, scoring_process
from tests.faults.clients import PARTICIPANTS, Clients
from tests.faults.deployment import LEASE_S, Deployment, wake
from tests.faults.points import Strike
from tests.services.processes import wait_until

MET_S = 30.0
"""A target that is not there, or a point that nobody passes, within this is tried again."""

REACHED_S = 300.0
"""With participants at work everything comes about within this, however slow the machine is."""

EXTRA_S = 4.0
"""Longer than a lease and than the time after which a message is sent again."""


def kill_at(deployment: Deployment, point: str, target: str, *, index: int) -> bool:
    """Kill a target at the moment somebody passes a point; False when that did not come about in time."""
    deployment.revive()  # on a busy machine a killed process may take longer to die than we waited
    try:
        wait_until(lambda: deployment.victims(target, index), timeout_s=MET_S, what=target)
        points.arm(deployment.faults, point, Strike(kill=deployment.victims(target, index)))
        wait_until(lambda: not points.is_armed(deployment.faults, point), timeout_s=MET_S, what=point)
    except TimeoutError:
        points.disarm(deployment.faults, point)
        return False
    time.sleep(0.2)
    deployment.revive()
    return True


def flush_broker(deployment: Deployment, clients: Clients) -> None:
    """Every message is lost."""
    _wait_for(deployment.unfinished, "a submission on its way")
    deployment.broker.lose_everything()
    del clients


def freeze_broker(deployment: Deployment, clients: Clients) -> None:
    """The broker takes connections and answers nothing, while uploads go on."""
    deployment.broker.signal(signal.SIGSTOP)
    try:
        _wait_for_uploads(clients)
        time.sleep(EXTRA_S)
    finally:
        deployment.broker.signal(signal.SIGCONT)


def take_broker_away(deployment: Deployment, clients: Clients) -> None:
    """The broker is down while uploads go on; all its messages are lost."""
    deployment.broker.kill()
    _wait_for_uploads(clients)
    time.sleep(EXTRA_S)
    deployment.revive()


def take_database_away(deployment: Deployment, clients: Clients) -> None:
    """The database goes down while a submission is being scored, and uploads are told to come again."""
    if deployment.database is None or deployment.database.process is None:
        return
    before = clients.statuses[503]
    strike = Strike(kill=(deployment.database.process.pid,))
    _strike_and_wait(deployment, "parsed", strike)
    _wait_for(lambda: clients.statuses[503] > before, "an upload that is told to come again")
    time.sleep(EXTRA_S)
    deployment.revive()


def fill_disk(deployment: Deployment, clients: Clients) -> None:
    """The disk of blobs and temporary files is full for a worker that just claimed a submission, and for uploads."""
    before = clients.statuses[507]
    _strike_and_wait(deployment, "claimed", Strike(pause_s=LEASE_S / 3))
    with deployment.disk.full():
        _wait_for(lambda: clients.statuses[507] > before, "an upload that is told there is no room")


def freeze_worker(deployment: Deployment, clients: Clients) -> None:
    """A worker stands still with its scores computed, for three lease times and until others did its work; it goes on."""
    del clients
    _strike_and_wait(deployment, "scored", Strike(stop=True))
    frozen = points.last_taken_by(deployment.faults, "scored")
    waiting = set(deployment.unfinished())
    time.sleep(3 * LEASE_S)
    _wait_for(lambda: not waiting & set(deployment.unfinished()), "the end of the frozen worker's work")
    wake(frozen)


def send_poison(deployment: Deployment, clients: Clients) -> None:
    """A submission that ends every process that scores it, by a crash."""
    submission_id = clients.send_deadly(scoring_process.POISON, "scoring_died")
    _wait_for(lambda: submission_id not in map(str, deployment.unfinished()), "the end of the poison")


def exhaust_memory(deployment: Deployment, clients: Clients) -> None:
    """A submission that needs more memory than the scoring process may have."""
    submission_id = clients.send_deadly(scoring_process.HUNGER, "memory_limit")
    _wait_for(lambda: submission_id not in map(str, deployment.unfinished()), "the end of the hungry submission")


def restart_one_by_one(deployment: Deployment, clients: Clients) -> None:
    """Every process of ours is stopped in good order and started again, as for another version."""
    del clients
    for service in (*deployment.workers, deployment.web, deployment.scheduler):
        service.stop()
        service.launch()
        if service is deployment.workers[0]:
            service.wait_until_ready()


def _strike_and_wait(deployment: Deployment, point: str, strike: Strike) -> None:
    points.arm(deployment.faults, point, strike)
    _wait_for(lambda: not points.is_armed(deployment.faults, point), point)


def _wait_for_uploads(clients: Clients) -> None:
    """Wait until somebody's upload was begun and answered: with more answers than participants that is certain."""
    enough = len(clients.accepted) + len(PARTICIPANTS) + 1
    _wait_for(lambda: len(clients.accepted) >= enough, "an upload that is answered with 202")


def _wait_for(condition: Callable[[], object], what: str) -> None:
    wait_until(condition, timeout_s=REACHED_S, what=what)


OTHERS: dict[str, Callable[[Deployment, Clients], None]] = {
    attack.__name__: attack
    for attack in (
        flush_broker,
        freeze_broker,
        take_broker_away,
        take_database_away,
        fill_disk,
        freeze_worker,
        send_poison,
        exhaust_memory,
        restart_one_by_one,
    )
}
"""What is done besides killing."""

NEEDS_DATABASE_SERVER = frozenset({take_database_away.__name__})
"""What only the shape with a database server can undergo."""
