"""A pool process that died is replaced by one that works, whatever the worker's main process did before."""

import psutil

from server.models import SubmissionState
from tests.services.installation import Installation
from tests.services.processes import wait_until
from tests.services.worker import WorkerProcess


def _pool(worker: WorkerProcess) -> list[psutil.Process]:
    """Find a worker's pool processes: its children that are no scoring processes."""
    assert worker.process is not None
    children = psutil.Process(worker.process.pid).children()
    return [child for child in children if "celery" in child.cmdline()]


def test_a_replaced_pool_process_scores(installation: Installation) -> None:
    """After a pool process was killed, a submission is scored by the one in its place, with local blobs and a bucket."""
    worker = installation.start_worker()
    installation.wait_for(installation.submit(), SubmissionState.SCORED)
    log = worker.log_path
    wait_until(lambda: b"cs3d.sweep_files" in log.read_bytes(), what="the first sweep of files")
    for process in _pool(worker):
        process.kill()
    installation.wait_for(installation.submit(method="second"), SubmissionState.SCORED)
