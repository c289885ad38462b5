"""Acknowledging while the broker hangs or is away: the worker goes on, and the message comes again, which is harmless.

Kombu takes a message off its own list only after the broker was told. When the broker does not answer it raises,
Celery logs that, and the list stays full for good: with a prefetch of one the worker would never take a message again.
"""

import structlog
from kombu.transport import redis, virtual
from redis.exceptions import RedisError

log = structlog.get_logger(__name__)


class LastingQoS(redis.QoS):
    """Keeps its own list whatever the broker says."""

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


def install() -> None:
    """Use it for every connection of this process that is opened from now on."""
    redis.Channel.QoS = LastingQoS
