"""The queue: tells workers that a submission waits. The database is the truth, a message is only a hint.

A message carries ids and nothing else. Losing every message loses nothing: the sweeper sends again.
Publish after the commit, never inside the transaction: a worker must find the row the message speaks of.
"""

import contextlib
import uuid
from collections.abc import Callable
from functools import partial

import structlog
from celery import Celery, group
from kombu.exceptions import OperationalError
from redis.exceptions import RedisError

from server.settings import Settings

log = structlog.get_logger(__name__)

EVALUATE_TASK = "cs3d.evaluate"
SHARD_TASK = "cs3d.shard"
SWEEP_TASK = "cs3d.sweep"
FILE_SWEEP_TASK = "cs3d.sweep_files"
RESCORE_TASK = "cs3d.rescore"
RESAMPLE_TASK = "cs3d.resample"
QUEUE_NAME = "cs3d"

PRIORITY_URGENT = 0
"""Housekeeping that must not wait behind submissions."""
PRIORITY_NORMAL = 3
"""A submission that its team waits for."""
PRIORITY_LATER = 6
"""What follows a score, for the leaderboard: no team waits for it."""
PRIORITY_BULK = 9
"""Scoring many again: waits behind everything else."""

PRIORITY_STEPS = (PRIORITY_URGENT, PRIORITY_NORMAL, PRIORITY_LATER, PRIORITY_BULK)
PRIORITY_SEPARATOR = ":"

HARD_LIMIT_MARGIN_S = 120
"""From the end of scoring to the worker's hard limit: fetching blobs and recording."""


def hard_limit_s(settings: Settings) -> float:
    """Give the time after which a worker's process is killed, whatever it does: a job may follow on another one."""
    return settings.score_time_s * 2 + 2 * HARD_LIMIT_MARGIN_S


def celery_app(settings: Settings) -> Celery:
    """Make the Celery application that web, worker and scheduler share.

    Limits are nested: scoring time < soft limit < hard limit < visibility timeout. Each outer one is only for the
    case that the inner one failed; the lease in the database makes even the outermost harmless.
    """
    hard_s = hard_limit_s(settings)
    app = Celery("cs3d", broker=settings.broker)
    app.conf.update(
        task_default_queue=QUEUE_NAME,
        task_ignore_result=True,
        task_acks_late=True,
        task_reject_on_worker_lost=True,
        task_acks_on_failure_or_timeout=True,
        worker_prefetch_multiplier=1,
        task_soft_time_limit=hard_s - HARD_LIMIT_MARGIN_S,
        task_time_limit=hard_s,
        task_serializer="json",
        accept_content=["json"],
        task_publish_retry=True,
        task_publish_retry_policy={"max_retries": 1, "interval_start": 0, "interval_step": 0.1, "interval_max": 0.1},
        broker_connection_retry_on_startup=True,
        broker_connection_max_retries=None,
        broker_connection_timeout=settings.broker_timeout_s,
        broker_transport_options=_transport_options(settings, hard_s + HARD_LIMIT_MARGIN_S),
        beat_schedule={
            "sweep": {
                "task": SWEEP_TASK,
                "schedule": settings.sweep_s,
                "options": {"expires": settings.sweep_s, "priority": PRIORITY_URGENT},
            }
        },
    )
    return app


def _transport_options(settings: Settings, visibility_s: float) -> dict[str, object]:
    return {
        "visibility_timeout": visibility_s,
        "unacked_restore_interval": 1,
        "unacked_restore_throttle": 1,
        "socket_timeout": settings.broker_timeout_s,
        "socket_connect_timeout": settings.broker_timeout_s,
        "socket_keepalive": True,
        "health_check_interval": 10,
        "queue_order_strategy": "priority",
        "priority_steps": list(PRIORITY_STEPS),
        "sep": PRIORITY_SEPARATOR,
        "max_retries": 1,
        "interval_start": 0,
        "interval_step": 0.1,
        "interval_max": 0.1,
    }


class Queue:
    """Sends messages; the receiving side is worker/app.py."""

    def __init__(self, settings: Settings) -> None:
        """Prepare to send; the broker is connected with the first message."""
        self._app = celery_app(settings)

    def enqueue(self, submission_id: uuid.UUID) -> bool:
        """Tell the workers that a submission waits.

        Call it after the commit. It waits for a dead or hanging broker a few seconds at most and never raises.

        Returns:
            False when the broker did not take the message; the sweeper then sends it again.
        """
        return self._send(EVALUATE_TASK, str(submission_id), PRIORITY_NORMAL)

    def enqueue_item(self, item_id: int) -> bool:
        """Tell the workers that an item of a re-scoring waits, behind every submission that a team waits for.

        Returns:
            False when the broker did not take the message; the sweeper then sends it again.
        """
        return self._send(RESCORE_TASK, item_id, PRIORITY_BULK)

    def enqueue_resampling(self, score_id: int) -> bool:
        """Tell the workers that a score waits for resampling.

        Returns:
            False when the broker did not take the message; the sweeper then sends it again.
        """
        return self._send(RESAMPLE_TASK, score_id, PRIORITY_LATER)

    def enqueue_shards(self, submission_id: uuid.UUID, attempt: int, count: int) -> bool:
        """Tell the workers that the images of a submission wait in `count` shards, as one group of messages.

        They queue behind waiting submissions and ahead of resampling and re-scoring. The submission's holder does every
        shard that no idle worker takes.

        Returns:
            False when the broker did not take them; nothing sends them again.
        """
        calls = [(str(submission_id), attempt, number) for number in range(count)]
        shards = [self._app.signature(SHARD_TASK, args=call, priority=PRIORITY_NORMAL) for call in calls]
        return self._taken(group(shards, app=self._app).apply_async, SHARD_TASK, str(submission_id))

    def _send(self, task: str, argument: str | int, priority: int) -> bool:
        return self._taken(partial(self._app.send_task, task, args=[argument], priority=priority), task, argument)

    @staticmethod
    def _taken(publish: Callable[[], object], task: str, argument: str | int) -> bool:
        """Say whether the broker took what is published."""
        try:
            publish()
        # RuntimeError: kombu's pool was closed, here or by another user of it in this process.
        except (OperationalError, RedisError, OSError, RuntimeError) as error:
            log.warning("enqueue_failed", task=task, argument=argument, error=repr(error))
            return False
        return True

    def depth(self, *priorities: int) -> int | None:
        """Count the messages that wait, by default over all priorities; None when the broker does not answer."""
        steps = priorities or PRIORITY_STEPS
        keys = [QUEUE_NAME if step == 0 else f"{QUEUE_NAME}{PRIORITY_SEPARATOR}{step}" for step in steps]
        try:
            with self._app.connection_for_write() as connection:
                client = connection.default_channel.client
                return sum(int(client.llen(key)) for key in keys)
        except (OperationalError, RedisError, OSError) as error:
            log.warning("broker_unreachable", error=repr(error))
            return None

    def close(self) -> None:
        """Close the broker's connections. Another queue of this process on the same broker can go on sending.

        kombu keeps one pool for each broker's address in a process: a pool that is closed for good would refuse every
        later user of that address.
        """
        pool = self._app.pool
        with contextlib.suppress(OperationalError, RedisError, OSError):
            pool.resize(pool.limit, reset=True)
