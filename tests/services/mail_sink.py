"""A real SMTP server that keeps what it gets."""

from collections.abc import Iterator
from contextlib import contextmanager
from email import message_from_bytes
from email.message import Message
from typing import Any

from aiosmtpd.controller import Controller

from tests.services.processes import free_port


class MailSink:
    """Takes every mail."""

    def __init__(self) -> None:
        """Start without mails."""
        self.port = free_port()
        self.mails: list[Message] = []

    async def handle_DATA(self, server: Any, session: Any, envelope: Any) -> str:  # noqa: N802 - aiosmtpd's name
        """Keep one mail."""
        del server, session
        self.mails.append(message_from_bytes(envelope.content))
        return "250 kept"


@contextmanager
def running_mail_sink() -> Iterator[MailSink]:
    """Run a sink on its own port."""
    sink = MailSink()
    controller = Controller(sink, hostname="127.0.0.1", port=sink.port)
    controller.start()
    try:
        yield sink
    finally:
        controller.stop()
