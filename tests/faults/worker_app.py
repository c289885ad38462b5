"""`celery -A tests.faults.worker_app worker`, or `beat`: the real worker or scheduler with the fault points around it."""

from tests.faults import clock

clock.shift()

from tests.faults import hooks  # noqa: E402 - after the clock is shifted
from tests.faults.points import SCORING_PROGRAM, WORKER_POINTS  # noqa: E402 - likewise
from worker import sandbox  # noqa: E402 - likewise

hooks.install(WORKER_POINTS)
sandbox.PROGRAM = SCORING_PROGRAM

from worker.app import app  # noqa: E402 - after the points are in place

__all__ = ["app"]
