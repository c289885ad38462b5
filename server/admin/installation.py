"""Commands that set an installation up and run it."""

import argparse
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Never

from server import database, embedded
from server.admin.command import Outcome, Subparsers, add, port_number, whole_number
from server.errors import Conflict
from server.services import Services
from server.settings import Settings


def add_commands(subparsers: Subparsers) -> None:
    """Add this module's commands."""
    add(subparsers, "init", init, needs_tables=False)
    add(subparsers, "migrate", migrate, needs_tables=False)
    serving = add(subparsers, "serve", serve, needs_tables=False)
    serving.add_argument("--host", default="127.0.0.1", help="address to listen on (default: %(default)s)")
    serving.add_argument("--port", type=port_number, default=8000, help="port to listen on (default: %(default)s)")
    working = add(subparsers, "worker", worker, needs_tables=False)
    at_a_time = "submissions at a time (default: CS3D_WORKER_CONCURRENCY)"
    working.add_argument("--concurrency", type=whole_number(1), metavar="N", help=at_a_time)


def init(args: argparse.Namespace, services: Services) -> Outcome:
    """Make the data folder, the secret key and the tables; harmless when they are there."""
    del args
    settings = services.settings
    settings.signing_key()
    database.migrate(services.engine)
    data = {
        "data_dir": str(settings.data_dir.absolute()),
        "database": services.engine.url.render_as_string(hide_password=True),
        "embedded_broker": settings.embedded_broker,
    }
    text = f"{data['database']} is migrated; files go to {data['data_dir']}. Next: cs3d-admin create-user, create-team"
    return Outcome(data=data, text=text)


def migrate(args: argparse.Namespace, services: Services) -> Outcome:
    """Bring the database to the newest revision; safe to run from several processes at once."""
    del args
    database.migrate(services.engine)
    url = services.engine.url.render_as_string(hide_password=True)
    return Outcome(data={"database": url}, text=f"{url} is at the newest revision.")


def serve(args: argparse.Namespace, services: Services) -> Outcome:
    """Serve until Ctrl-C: web, broker and worker in the embedded shape, web alone when a broker is named."""
    settings = services.settings
    if embedded.listens(args.host, args.port):
        message = f"something listens on {args.host}:{args.port} already; stop it or give another --port"
        raise Conflict(message)
    if not settings.embedded_broker:
        services.close()
        _become(embedded.web_command(args.host, args.port), settings)
    with embedded.sole_owner(settings), until_asked_to_stop():
        database.migrate(services.engine)
        supervisor = embedded.embedded_supervisor(settings, host=args.host, port=args.port)
        with supervisor.running():
            supervisor.keep_running()
    return Outcome(data={"stopped": True}, text="Stopped.")


def worker(args: argparse.Namespace, services: Services) -> Outcome:
    """Run one worker until it is asked to stop; any number may run, on any machines with the same settings."""
    settings = services.settings
    services.close()
    _become(embedded.worker_command(*(["--concurrency", str(args.concurrency)] if args.concurrency else [])), settings)


@contextmanager
def until_asked_to_stop() -> Iterator[None]:
    """Run a block that Ctrl-C and SIGTERM end; both are the ordinary way to stop, not errors."""
    # SIGINT too: a shell starts background jobs with it ignored, and Python then leaves it so.
    before = {number: signal.signal(number, _interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        with suppress(KeyboardInterrupt):
            yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _interrupt(number: int, frame: object) -> Never:
    """Treat SIGTERM like Ctrl-C."""
    del number, frame
    raise KeyboardInterrupt


def _become(command: list[str], settings: Settings) -> Never:
    """Become another program with these settings."""
    os.execve(command[0], command, embedded.process_environment(settings))  # noqa: S606 (no shell is wanted)
