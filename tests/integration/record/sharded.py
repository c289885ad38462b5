"""What tests of sharded scoring share: a scoring process they may interrupt, and a look at the rows."""

import os
from collections.abc import Callable, Generator
from pathlib import Path

import msgspec
import psutil
import sqlalchemy as sa

from server import benchmarks
from server.models import Shard
from tests.services.installation import Installation
from worker.messages import AnyJob, Event, ShardJob
from worker.sandbox import Sandbox

Before = Callable[[AnyJob], AnyJob]


class WatchedSandbox(Sandbox):
    """A real scoring process; tests act before its jobs, and kill its children."""

    def __init__(self, before: Before = lambda job: job) -> None:
        """Call `before` ahead of each job; it may give another one."""
        super().__init__()
        self.before = before
        self.kills = 0
        """So many jobs on shards are killed."""

    def events(self, job: AnyJob, *, tick_s: float) -> Generator[Event | None, None, None]:
        """Run the job, or kill it for certain before it ends: nobody ever writes what it waits for."""
        job = self.before(job)
        if not (isinstance(job, ShardJob) and self.kills):
            yield from super().events(job, tick_s=tick_s)
            return
        self.kills -= 1
        os.mkfifo(fifo := str(Path(job.folder) / "fifo"))
        events = super().events(msgspec.structs.replace(job, ground_truth=fifo), tick_s=0.1)
        yield next(events)
        assert self._process is not None
        for child in psutil.Process(self._process.pid).children():
            child.kill()
        yield from events


def divide(installation: Installation, count: int) -> None:
    """Let the phase be scored in so many shards."""
    with installation.services.transaction() as session:
        phase = benchmarks.find_phase(session, "cs3d", "test")
        benchmarks.set_shards(session, phase, count, actor="admin:test")


def shard_rows(installation: Installation) -> list[Shard]:
    """Read all shards that there are."""
    with installation.services.snapshot() as session:
        return list(session.scalars(sa.select(Shard).order_by(Shard.number)))


def once(act: Callable[[AnyJob], None], kind: type[AnyJob]) -> Before:
    """Act before the first job of a kind."""
    done: list[AnyJob] = []

    def before(job: AnyJob) -> AnyJob:
        if isinstance(job, kind) and not done:
            done.append(job)
            act(job)
        return job

    return before
