"""The command `demo`: a whole benchmark with imaginary data, from nothing to a ranked leaderboard in the browser."""

import argparse
import socket
import sys
from pathlib import Path
from typing import Any

import httpx
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from evaluator.protocol import EVALUATED_LABELS
from server import database, embedded
from server.admin import demo_benchmark, demo_uploads
from server.admin.command import LAST_PORT, Outcome, Subparsers, add, port_number, table
from server.admin.installation import until_asked_to_stop
from server.services import Services
from server.settings import Settings
from server.supervision import Supervisor

HOST = "127.0.0.1"


def add_commands(subparsers: Subparsers) -> None:
    """Add the command."""
    parser = add(subparsers, "demo", demo, needs_tables=False)
    parser.set_defaults(data_dir="data/demo")
    parser.add_argument("--port", type=port_number, default=8000, help="port to listen on (default: %(default)s)")
    parser.add_argument("--exit", action="store_true", help="stop after the leaderboard instead of serving")


def demo(args: argparse.Namespace, services: Services) -> Outcome:
    """Show a benchmark at work: make one, upload three methods, rank them, serve until Ctrl-C."""
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    port = _free_port(args.port, console)
    url = f"http://{HOST}:{port}"
    # Only the data folder is taken from the environment: the demo never touches a real database or broker.
    settings = Settings(
        data_dir=Path(args.data_dir), database_url="", broker_url="", blob_url="", public_url=url, worker_concurrency=2
    )
    outcome = Outcome(data={"stopped": True})
    with until_asked_to_stop(), embedded.sole_owner(settings):
        services = Services.from_settings(settings)
        console.print(f"Data folder {settings.data_dir.absolute()}")
        database.migrate(services.engine)
        logins = demo_benchmark.prepare(services)
        logs = settings.data_dir / "logs"
        supervisor = embedded.embedded_supervisor(settings, host=HOST, port=port, log_folder=logs)
        with supervisor.running():
            outcome = _show(services, supervisor, console, url, logins)
            if args.exit:
                return outcome
            _print_now(outcome)
            console.print(f"Serving {url} (logs in {logs}). Ctrl-C stops everything.")
            supervisor.keep_running()
    return Outcome(data=outcome.data, text="Stopped.")


def _show(
    services: Services, supervisor: Supervisor, console: Console, url: str, logins: demo_benchmark.Logins
) -> Outcome:
    """Upload, wait, publish and fetch the leaderboard, all through the API."""
    with httpx.Client(base_url=url, timeout=60) as client:
        uploads = demo_uploads.plan(services, logins)
        with _Bars(console, supervisor, uploads) as bars:
            demo_uploads.send(client, uploads, bars.show)
            demo_uploads.wait_for(client, uploads, bars.show)
        demo_uploads.publish(client, uploads)
        board = demo_uploads.leaderboard(client, "test")
    address = f"{url}/benchmarks/{demo_benchmark.BENCHMARK}/test"
    login = {"email": logins.email, "password": logins.password}
    text = f"Leaderboard: {address}\nLog in at {url}/login as {logins.email} with password {logins.password}"
    return Outcome(data={"url": address, "login": login, "leaderboard": board}, text=text, tables=[_ranking(board)])


class _Bars(Progress):
    """A bar for each submission; whenever they are shown, the children are looked after too."""

    def __init__(self, console: Console, supervisor: Supervisor, uploads: list[demo_uploads.Upload]) -> None:
        state, elapsed = TextColumn("{task.fields[state]:9}"), TimeElapsedColumn()
        super().__init__(TextColumn("{task.description}"), BarColumn(), state, elapsed, console=console)
        self._supervisor = supervisor
        self._uploads = {
            self.add_task(f"{one.phase.slug:5}{one.method.title}", total=1.0, state=""): one for one in uploads
        }

    def show(self) -> None:
        """Bring the bars up to date."""
        self._supervisor.check()
        for task, upload in self._uploads.items():
            self.update(task, completed=upload.share_done, state=upload.state)


def _ranking(board: dict[str, Any]) -> Table:
    """Make the leaderboard's table: mDS and the detection score of every class."""
    rows = [
        [
            row["rank"],
            row["method_name"],
            row["team"],
            row["mds"],
            *(row["classes"].get(label, {}).get("detection_score") for label in EVALUATED_LABELS),
        ]
        for row in board["rows"]
    ]
    return table("rank", "method", "team", "mDS", *EVALUATED_LABELS, rows=rows)


def _print_now(outcome: Outcome) -> None:
    """Print before serving what would otherwise be printed at the end."""
    console = Console(file=sys.stdout, soft_wrap=True, highlight=False)
    for shown in outcome.tables:
        console.print(shown)
    console.print(outcome.text, markup=False)


def _free_port(wanted: int, console: Console) -> int:
    """Choose the port asked for, or when it is taken the next that is free."""
    for port in range(wanted, min(wanted + 100, LAST_PORT + 1)):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((HOST, port))
            except OSError:
                continue
        if port != wanted:
            console.print(f"Port {wanted} is taken; using {port}.")
        return port
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        chosen: int = probe.getsockname()[1]
    return chosen
