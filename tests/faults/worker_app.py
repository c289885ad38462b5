"""`celery -A tests.faults.worker_app worker`: the real worker with the fault points around it."""

from tests.faults import hooks

hooks.install(hooks.WORKER_POINTS)

from worker import attempt  # noqa: E402 - after the points are in place
from worker.app import app  # noqa: E402 - likewise

hooks.wrap(attempt.Attempt, "_scored", before="scored")

__all__ = ["app"]
