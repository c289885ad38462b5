"""What is done to a deployment. Each attack ends with everything running again; recovery is left to the record.

Attacks wait for what they want to meet, however long that takes, and not for a time: the same on any machine.
"""

import contextlib
import os
import signal
import time
from collections.abc import Callable

from redis.exceptions import RedisError

from server.errors import Unavailable
from tests.faults import points, scoring_process
from tests.faults.clients import PARTICIPANTS, Clients
from tests.faults.deployment import LEASE_S, Deployment
from tests.faults.points import Strike, Struck
from tests.services.broker import Broker
from tests.services.processes import wait_until

MET_S = 30.0
"""A target that is not there, or a point that nobody passes, within this is tried again."""

REACHED_S = 300.0
"""With participants at work everything comes about within this, however slow the machine is."""

EXTRA_S = 6.0
"""Longer than a lease and than the time after which a message is sent again."""


def kill_at(deployment: Deployment, point: str, target: str, *, index: int) -> bool:
    """Kill a target at the moment somebody passes a point; False when that did not come about."""
    deployment.revive()
    planned = deployment.killing(target, index)
    try:
        wait_until(lambda: points.victims(planned), timeout_s=MET_S, what=target)
        struck = strike(deployment, point, planned, timeout_s=MET_S)
    except TimeoutError:
        return False
    # What a busy machine is slow to end must not be taken for running, by whatever comes next.
    wait_for(deployment, lambda: not any(map(points.is_alive, struck.killed)), f"the end of {struck.killed}")
    deployment.revive()
    return bool(struck.killed)


def strike(deployment: Deployment, point: str, planned: Strike, *, timeout_s: float = REACHED_S) -> Struck:
    """Strike the next one that passes a point.

    Raises:
        TimeoutError: Nobody passed it in time; it is not armed any more.
    """
    before = len(points.strikes(deployment.faults, point))
    points.arm(deployment.faults, point, planned)
    try:
        wait_until(
            lambda: len(points.strikes(deployment.faults, point)) > before,
            timeout_s=timeout_s,
            what=f"a strike at {point}",
        )
    finally:
        points.disarm(deployment.faults, point)
    return points.strikes(deployment.faults, point)[-1]


def wait_for(deployment: Deployment, condition: Callable[[], object], what: str) -> None:
    """Wait while everything goes on; our own processes are started again when they end, as a supervisor does.

    Raises:
        TimeoutError: It did not come about.
    """

    def has_come() -> object:
        deployment.revive_fronts()
        try:
            return condition()
        except Unavailable:  # a database on a busy machine may take longer to answer than a client waits
            return False

    wait_until(has_come, timeout_s=REACHED_S, what=what)


def flush_broker(deployment: Deployment, clients: Clients) -> None:
    """Every message is lost."""
    del clients
    wait_for(deployment, deployment.unfinished, "a submission on its way")
    wait_for(deployment, lambda: _has_lost_everything(deployment.broker), "a broker that loses its messages")


def _has_lost_everything(broker: Broker) -> bool:
    try:
        broker.lose_everything()
    except RedisError:  # on a busy machine it may take longer to answer than a client waits
        return False
    return True


def freeze_broker(deployment: Deployment, clients: Clients) -> None:
    """The broker takes connections and answers nothing, while uploads go on."""
    deployment.broker.signal(signal.SIGSTOP)
    try:
        _wait_for_uploads(deployment, clients)
        time.sleep(EXTRA_S)
    finally:
        deployment.broker.signal(signal.SIGCONT)


def take_broker_away(deployment: Deployment, clients: Clients) -> None:
    """The broker is down while uploads go on; all its messages are lost."""
    deployment.broker.kill()
    _wait_for_uploads(deployment, clients)
    time.sleep(EXTRA_S)
    deployment.revive()


def take_database_away(deployment: Deployment, clients: Clients) -> None:
    """The database goes down while a submission is being scored, and uploads are told to come again."""
    before = clients.statuses[503]
    strike(deployment, "parsed", deployment.killing("database", 0))
    wait_for(deployment, lambda: clients.statuses[503] > before, "an upload that is told to come again")
    time.sleep(EXTRA_S)
    deployment.revive()


def fill_disk(deployment: Deployment, clients: Clients) -> None:
    """The disk of blobs and temporary files is full for a worker that just claimed a submission, and for uploads."""
    before = clients.statuses[507]
    strike(deployment, "claimed", Strike(pause_s=LEASE_S / 3))
    with deployment.disk.full():
        wait_for(deployment, lambda: clients.statuses[507] > before, "an upload that is told there is no room")


def freeze_worker(deployment: Deployment, clients: Clients) -> None:
    """A worker stands still with its scores computed, for three lease times and until others did its work; it goes on."""
    del clients
    frozen = strike(deployment, "scored", Strike(stop=True)).process
    try:
        waiting = set(deployment.unfinished())
        time.sleep(3 * LEASE_S)
        wait_for(deployment, lambda: not waiting & set(deployment.unfinished()), "the end of the frozen worker's work")
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(frozen, signal.SIGCONT)


def hold_upload(deployment: Deployment, clients: Clients) -> None:
    """One upload stands still once its message is sent, until a worker has taken that message; the others go on."""
    del clients
    held = strike(deployment, "enqueued", Strike(hold=True))
    try:
        wait_for(deployment, lambda: deployment.was_taken(held.about), "a worker that takes the message")
    finally:
        points.let_go(held)


def send_poison(deployment: Deployment, clients: Clients) -> None:
    """A submission that ends every process that scores it, by a crash."""
    submission_id = clients.send_deadly(scoring_process.POISON, "scoring_died")
    wait_for(deployment, lambda: submission_id not in map(str, deployment.unfinished()), "the end of the poison")


def exhaust_memory(deployment: Deployment, clients: Clients) -> None:
    """A submission that needs more memory than the scoring process may have."""
    submission_id = clients.send_deadly(scoring_process.HUNGER, "memory_limit")
    wait_for(deployment, lambda: submission_id not in map(str, deployment.unfinished()), "the end of the hungry one")


def restart_one_by_one(deployment: Deployment, clients: Clients) -> None:
    """Every process of ours is stopped in good order and started again, as for another version."""
    del clients
    for service in (*deployment.workers, deployment.web, deployment.scheduler):
        service.stop()
        service.launch()
        if service is deployment.workers[0]:
            service.wait_until_ready()


def _wait_for_uploads(deployment: Deployment, clients: Clients) -> None:
    """Wait until somebody's upload was begun and answered: with more answers than participants that is certain."""
    enough = len(clients.accepted) + len(PARTICIPANTS) + 1
    wait_for(deployment, lambda: len(clients.accepted) >= enough, "an upload that is answered with 202")


OTHERS: dict[str, Callable[[Deployment, Clients], None]] = {
    attack.__name__: attack
    for attack in (
        flush_broker,
        freeze_broker,
        take_broker_away,
        take_database_away,
        fill_disk,
        freeze_worker,
        hold_upload,
        send_poison,
        exhaust_memory,
        restart_one_by_one,
    )
}
"""What is done besides killing."""

NEEDS_DATABASE_SERVER = frozenset({take_database_away.__name__})
"""What only the shape with a database server can undergo."""
