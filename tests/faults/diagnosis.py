"""What is needed to find the cause of a failed run without the machine it ran on."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import psutil
import sqlalchemy as sa

from server.errors import Unavailable
from server.models import Submission, SubmissionState
from server.services import Services
from tests.faults import points
from tests.services.processes import Service

LAST_LINES = 30


def describe(services: Services, processes: Sequence[Service], faults: Path) -> str:
    """Describe how an installation stands: unfinished submissions, armed points, states of processes, ends of logs.

    Args:
        services: The installation's.
        processes: Our own processes; their children are found.
        faults: The folder in which points are armed.
    """
    lines = ["unfinished submissions:", *_unfinished(services), f"armed points: {points.armed(faults)}", "processes:"]
    for service in processes:
        lines += _states(service)
    for service in processes:
        lines += [f"last lines of {service.folder.name}:", *log_of(service)[-LAST_LINES:]]
    return "\n".join(lines)


def log_of(service: Service) -> list[str]:
    """Read everything that a service wrote, its earlier starts first."""
    files = sorted(service.folder.glob("*.log"), key=lambda file: file.stat().st_mtime)
    return [line for file in files for line in file.read_text(errors="replace").splitlines()]


def _unfinished(services: Services) -> Iterator[str]:
    terminal = [state for state in SubmissionState if state.terminal]
    query = sa.select(Submission).where(Submission.state.not_in(terminal)).order_by(Submission.created_at)
    try:
        with services.snapshot() as session:
            for row in session.scalars(query):
                times = f"sent {row.enqueued_at}, held until {row.lease_expires_at}"
                yield f"  {row.id} {row.state} {row.stage or ''} attempt {row.attempt}, {times}"
    except Unavailable as error:
        yield f"  unknown: {error}"


def _states(service: Service) -> Iterator[str]:
    """Say of a process and its children whether they run, sleep or are stopped."""
    try:
        parent = psutil.Process(service.process.pid if service.process else 0)
        family = [parent, *parent.children(recursive=True)] if service.process else []
    except psutil.NoSuchProcess:
        family = []
    if not family:
        yield f"  {service.folder.name}: ended"
    for process in family:
        with process.oneshot():
            yield f"  {service.folder.name}: {process.pid} {_state(process)}"


def _state(process: psutil.Process) -> str:
    try:
        return f"{process.status()} {' '.join(process.cmdline())[:120]}"
    except psutil.Error:
        return "ended"
