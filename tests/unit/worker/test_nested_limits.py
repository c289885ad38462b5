"""Each limit on a task is only for the case that the one within it failed, so each is beyond the one before."""

import subprocess
import sys
from pathlib import Path

import pytest

from server.queue import celery_app
from server.settings import Settings

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize("score_time_s", [0.5, 1.0, 600.0, 3600.0, 86400.0])
def test_limits_are_nested(score_time_s: float) -> None:
    """Scoring time < soft limit < hard limit < visibility timeout, and twice the scoring time fits into the soft limit.

    A holder of shards runs up to two jobs in a row that may each take the scoring time: the last shard and the joining.
    """
    conf = celery_app(Settings(score_time_s=score_time_s)).conf
    visibility_s = conf.broker_transport_options["visibility_timeout"]
    assert 2 * score_time_s < conf.task_soft_time_limit < conf.task_time_limit < visibility_s


def test_grown_pool_processes_are_replaced() -> None:
    """A pool process has a bound on its memory, in KiB, that is far below that of the scoring process."""
    # In a process of its own: importing the worker's application changes how this one would speak to brokers.
    program = "from worker.app import app; print(app.conf.worker_max_memory_per_child)"
    run = subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True, capture_output=True, text=True)
    assert 0 < int(run.stdout) * 1024 < Settings().score_memory_bytes
