"""Listening to a broker that hangs, goes away and comes back, without becoming deaf to it.

Messages are only hints, so whatever the broker loses comes again. What may not happen is a worker that lives on and takes no
task any more. Celery and Kombu have three ways there, and each is closed here.
"""

from typing import Any

import structlog
from celery import Celery
from celery.worker.consumer import Consumer
from kombu.transport import redis, virtual
from redis.exceptions import RedisError

log = structlog.get_logger(__name__)

_NOTHING_BUT_TASKS = {"without_gossip": True, "without_mingle": True, "without_heartbeat": True}


class LastingQoS(redis.QoS):
    """Keeps its own list whatever the broker says.

    Kombu takes a message off its own list only after the broker was told. When the broker does not answer it raises, Celery
    logs that, and the list stays full for good: with a prefetch of one the worker would never take a message again.
    """

    def ack(self, delivery_tag: str) -> None:
        """Take a message off the list, and off the broker's if it answers."""
        try:
            super().ack(delivery_tag)  # type: ignore[no-untyped-call]  # kombu has no types
        except (RedisError, OSError) as error:
            self._forget(delivery_tag, error)

    def reject(self, delivery_tag: str, requeue: bool = False) -> None:  # noqa: FBT001, FBT002 - kombu's signature
        """Do the same for a message that is not worked on; the broker gives it again by itself."""
        try:
            super().reject(delivery_tag, requeue)  # type: ignore[no-untyped-call]  # likewise
        except (RedisError, OSError) as error:
            self._forget(delivery_tag, error)

    def _forget(self, delivery_tag: str, error: Exception) -> None:
        log.warning("not_acknowledged", error=repr(error))
        virtual.QoS.ack(self, delivery_tag)  # type: ignore[no-untyped-call]  # likewise


class TaskConsumer(Consumer):
    """Neither watches other workers nor sends events, which nobody here reads.

    The main loop would wait for a broker that is away until an event is sent, and do nothing else meanwhile.
    """

    def __init__(self, *args: Any, worker_options: dict[str, Any], **options: Any) -> None:  # noqa: ANN401 - celery's
        """Take Celery's arguments."""
        super().__init__(*args, worker_options={**worker_options, **_NOTHING_BUT_TASKS}, **options)


def install(app: Celery) -> None:
    """Let the workers of an application, and every connection that this process opens from now on, be like that."""
    redis.Channel.QoS = LastingQoS
    app.conf.worker_consumer = TaskConsumer
    # Nobody commands workers through the broker. When a subscription breaks and is opened again, the main loop may take the
    # old socket's last event for a message on the new one, and read that without a time limit.
    app.conf.worker_enable_remote_control = False
