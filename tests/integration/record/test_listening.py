"""A worker takes the next message whatever became of the broker meanwhile."""

import signal
import uuid
from collections.abc import Iterator

import pytest
from kombu.transport import redis
from kombu.transport.virtual import Channel

from server.queue import QUEUE_NAME, Queue, celery_app
from server.settings import Settings
from tests.services.broker import Broker
from tests.services.installation import Installation
from tests.services.processes import wait_until
from worker import listening


@pytest.fixture
def settings(broker: Broker) -> Settings:
    """Name the broker, which is given up on quickly."""
    return Settings(broker_url=broker.url, broker_timeout_s=0.3)


@pytest.fixture
def channel(settings: Settings, monkeypatch: pytest.MonkeyPatch) -> Iterator[Channel]:
    """Give a worker's channel, which takes one message at a time."""
    monkeypatch.setattr(redis.Channel, "QoS", redis.Channel.QoS)  # so that the change ends with the test
    app = celery_app(settings)
    listening.install(app)
    with app.connection_for_read() as connection:
        channel = connection.channel()
        channel.basic_qos(0, 1)
        yield channel


@pytest.mark.parametrize("end", ["ack", "reject", "requeue"])
def test_a_hanging_broker_does_not_make_a_worker_deaf(
    channel: Channel, settings: Settings, broker: Broker, end: str
) -> None:
    """While the broker hangs a message is given up quietly, and its place is free for the next one."""
    queue = Queue(settings)
    queue.enqueue(uuid.uuid4())
    message = channel.basic_get(QUEUE_NAME)  # type: ignore[no-untyped-call]  # kombu has no types
    assert message is not None
    assert not channel.qos.can_consume()
    broker.signal(signal.SIGSTOP)
    try:
        getattr(message, end)()
    finally:
        broker.signal(signal.SIGCONT)
    assert channel.qos.can_consume()
    queue.close()


def test_a_worker_waits_for_tasks_alone(installation: Installation) -> None:
    """It subscribes to no channel: when the broker was away Celery could read one without a time limit, deaf to all tasks."""
    installation.start_worker()
    client = installation.broker.client()
    try:
        wait_until(
            lambda: "brpop" in [connection["cmd"] for connection in client.client_list()], what="the wait for tasks"
        )
        assert client.client_list(_type="pubsub") == []
        assert client.pubsub_numpat() == 0
    finally:
        client.close()
