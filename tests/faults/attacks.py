"""What is done to a deployment. Each attack ends with everything running again; recovery is left to the record."""

import signal
import time
from collections.abc import Callable, Iterator

from server import submissions
from server.models import Submission
from tests.faults import hooks
from tests.faults.clients import send_one
from tests.faults.deployment import LEASE_S, Deployment, wake
from tests.faults.hooks import Strike
from tests.services.processes import wait_until

REACHED_S = 30.0
"""With participants at work every point is passed within this."""

TAKEN_OVER_S = 60.0
"""What a frozen worker held is done by others within this."""


def calm(deployment: Deployment) -> Iterator[str]:
    """Before any fault: a message sent after the commit reaches a worker, and the sweeper has nothing to send again."""
    for index in range(4):
        submission_id = send_one(deployment, f"calm-{index}")
        row = _wait_for_end(deployment, submission_id)
        if index and row.enqueued_at != row.created_at:  # the first one waited for the processes to warm up
            yield f"{submission_id} was scored only after the sweeper sent its message again"


def _wait_for_end(deployment: Deployment, submission_id: str) -> Submission:
    wait_until(lambda: _row(deployment, submission_id).state.terminal, what=f"the end of {submission_id}")
    return _row(deployment, submission_id)


def _row(deployment: Deployment, submission_id: str) -> Submission:
    with deployment.services.snapshot() as session:
        return submissions.find(session, submission_id)


def kill_at(deployment: Deployment, point: str, target: str, *, index: int) -> bool:
    """Kill a target at the moment somebody passes a point; False when there was nothing to kill."""
    deployment.revive()  # on a busy machine a killed process may take longer to die than we waited
    victims = deployment.victims(target, index)
    if not victims:
        return False
    hooks.arm(deployment.faults, point, Strike(kill=victims))
    try:
        wait_until(lambda: not (deployment.faults / point).exists(), timeout_s=REACHED_S, what=point)
    except TimeoutError:
        hooks.disarm(deployment.faults, point)
        return False
    time.sleep(0.2)
    deployment.revive()
    return True


def flush_broker(deployment: Deployment) -> None:
    """Every message is lost."""
    deployment.broker.lose_everything()


def freeze_broker(deployment: Deployment) -> None:
    """The broker hangs for a while: it takes connections and answers nothing."""
    deployment.broker.signal(signal.SIGSTOP)
    time.sleep(4)
    deployment.broker.signal(signal.SIGCONT)


def take_broker_away(deployment: Deployment) -> None:
    """The broker is down while participants go on sending; all its messages are lost."""
    deployment.broker.kill()
    time.sleep(4)
    deployment.revive()


def fill_disk(deployment: Deployment) -> None:
    """The disk of the blobs is full for one upload."""
    hooks.arm(deployment.faults, "fsynced", Strike(no_space=True))
    wait_until(lambda: not (deployment.faults / "fsynced").exists(), timeout_s=REACHED_S, what="fsynced")


def freeze_worker(deployment: Deployment) -> None:
    """A worker stands still with its scores computed, for three lease times and until others did its work; it goes on."""
    before = set(hooks.taken_by(deployment.faults, "scored"))
    hooks.arm(deployment.faults, "scored", Strike(stop=True))
    wait_until(lambda: not (deployment.faults / "scored").exists(), timeout_s=REACHED_S, what="scored")
    waiting = set(deployment.unfinished())
    time.sleep(3 * LEASE_S)
    wait_until(
        lambda: not waiting & set(deployment.unfinished()), timeout_s=TAKEN_OVER_S, what="the frozen worker's work"
    )
    wake([process for process in hooks.taken_by(deployment.faults, "scored") if process not in before])


def restart_one_by_one(deployment: Deployment) -> None:
    """Every process of ours is stopped in good order and started again, as for a new version."""
    for service in (*deployment.workers, deployment.web, deployment.scheduler):
        service.stop()
        service.launch()
        if service is deployment.workers[0]:
            service.wait_until_ready()


OTHERS: dict[str, Callable[[Deployment], None]] = {
    attack.__name__: attack
    for attack in (flush_broker, freeze_broker, take_broker_away, fill_disk, freeze_worker, restart_one_by_one)
}
"""What is done besides killing."""
