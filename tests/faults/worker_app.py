"""`celery -A tests.faults.worker_app worker`: the real worker with the fault points around it."""

from tests.faults import clock

clock.shift()

from tests.faults import hooks, scoring_process  # noqa: E402 - after the clock is shifted
from tests.faults.points import WORKER_POINTS  # noqa: E402 - likewise
from worker import sandbox  # noqa: E402 - likewise

hooks.install(WORKER_POINTS)
sandbox.PROGRAM = scoring_process.__name__

from worker.app import app  # noqa: E402 - after the points are in place

__all__ = ["app"]
