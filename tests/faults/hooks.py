"""Puts the points, and whatever else the environment asks for, around the real functions of a process."""

import functools
import os
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import psycopg
from celery import Celery

from server import blobs, lifecycle, submissions
from server.blobs import BucketBlobs, FolderBlobs
from server.models import Submission
from server.queue import Queue
from server.services import Services
from server.settings import Settings
from tests.faults import clock, points, sabotage
from tests.faults.points import reach
from worker.messages import AnyJob, Event, Scored
from worker.sandbox import Sandbox

COPIES_VARIABLE = "CS3D_TEST_COPIES"
"""How often every message is sent."""

WITHIN_COMMIT = "commit_sent"
"""On PostgreSQL this point lies between COMMIT and its answer."""


def install(live: Iterable[str]) -> None:
    """Put everything in place; only the points named strike in this process."""
    points.install(live)
    _reach_received(live)
    _reach_flushed()
    wrap(FolderBlobs, "put_file", after="promoted")
    wrap(BucketBlobs, "put_file", before="fsynced", after="promoted")  # flushing is the store's own affair there
    _reach_enqueued()
    _reach_after_commit()
    _reach_within_commit()
    _reach_with_scores()
    _note_early_messages()
    _send_copies(int(os.environ.get(COPIES_VARIABLE, "1")))
    if Settings().blob_url:  # the times in a local folder go wrong along with this machine's clock
        clock.shift_datetime_of(blobs)
    sabotage.install()


def wrap(owner: Any, name: str, *, before: str | None = None, after: str | None = None) -> None:
    """Reach points before and after a function."""
    original: Callable[..., Any] = getattr(owner, name)

    @functools.wraps(original)
    def wrapped(*arguments: Any, **named: Any) -> Any:
        if before:
            with blobs.no_room_is_said():
                reach(before)
        result = original(*arguments, **named)
        if after:
            reach(after)
        return result

    setattr(owner, name, wrapped)


def _reach_received(live: Iterable[str]) -> None:
    """Reach the point at which the whole body is in a temporary file, and nobody has looked at it."""
    if "received" in live:
        from server.api import receiving  # noqa: PLC0415 - workers have no web faces

        wrap(receiving, "keep", before="received")


def _reach_flushed() -> None:
    """Reach the point between flushing a file and promoting it; the folder that is flushed after that is none."""
    original = blobs._flush

    def flush(path: Path) -> None:
        original(path)
        if path.is_file():
            reach("fsynced")

    blobs._flush = flush


def _reach_enqueued() -> None:
    original = Queue.enqueue

    @functools.wraps(original)
    def enqueue(self: Queue, submission_id: Any, **named: Any) -> bool:
        taken = original(self, submission_id, **named)
        if taken:
            reach("enqueued", about=str(submission_id))
        return taken

    Queue.enqueue = enqueue  # type: ignore[method-assign]  # that is what this module is for


class _Committing(threading.local):
    """What the commit stands for that this thread is about to make."""

    points: tuple[str, ...] = ()


_committing = _Committing()


def _reach_after_commit() -> None:
    """Reach the points that stand for a commit once it has returned, unless they were reached within it."""
    original = Services.transaction

    @contextmanager
    def transaction(self: Services) -> Iterator[Any]:
        try:
            with original(self) as session:
                yield session
                _committing.points = tuple(session.info.get("done", ()))
            done = _committing.points
        finally:
            _committing.points = ()
        for point in done:
            reach(point)

    Services.transaction = transaction  # type: ignore[method-assign]  # that is what this module is for
    _note(submissions, "receive", "committed")
    _note(lifecycle, "claim", "claimed", when=lambda held: held is not None)
    _note(lifecycle, "validated", "parsed")
    _note(lifecycle, "record_score", "commit_sent")


def _note(module: Any, name: str, point: str, *, when: Callable[[Any], bool] = lambda _: True) -> None:
    """Remember in the session which point its commit reaches."""
    original: Callable[..., Any] = getattr(module, name)

    @functools.wraps(original)
    def noted(session: Any, *arguments: Any, **named: Any) -> Any:
        result = original(session, *arguments, **named)
        if when(result):
            session.info.setdefault("done", []).append(point)
        return result

    setattr(module, name, noted)


def _reach_within_commit() -> None:
    """Reach a point while the answer to COMMIT is not read. SQLite has no such moment: its commit is a call."""
    original = psycopg.Connection.commit

    @functools.wraps(original)
    def commit(self: psycopg.Connection[Any]) -> None:
        if WITHIN_COMMIT not in _committing.points:
            original(self)
            return
        _committing.points = tuple(point for point in _committing.points if point != WITHIN_COMMIT)
        with self.lock:
            self.wait(commit_reaching(self, WITHIN_COMMIT))

    psycopg.Connection.commit = commit  # type: ignore[method-assign]  # that is what this module is for


def commit_reaching(connection: psycopg.Connection[Any], point: str) -> Generator[Any, Any, None]:
    """Commit by psycopg's own steps; reach a point when it waits for the first time: COMMIT is sent, not answered."""
    steps = connection._commit_gen()
    try:
        waits = next(steps)
        reach(point)
        while True:
            waits = steps.send((yield waits))
    except StopIteration:
        return


def _reach_with_scores() -> None:
    """Reach the point between the computation of scores and their record."""
    original = Sandbox.events

    def events(self: Sandbox, job: AnyJob, *, tick_s: float) -> Generator[Event | None, None, None]:
        with closing(original(self, job, tick_s=tick_s)) as told:
            for event in told:
                if isinstance(event, Scored):
                    reach("scored")
                yield event

    Sandbox.events = events  # type: ignore[method-assign]  # that is what this module is for


def _note_early_messages() -> None:
    """Notice messages about submissions that are not rows: sent before the commit, they would be lost."""
    original = lifecycle.claim

    @functools.wraps(original)
    def claim(session: Any, submission_id: Any, **named: Any) -> Any:
        held = original(session, submission_id, **named)
        if held is None and session.get(Submission, submission_id) is None:
            points.note_early_message(submission_id)
        return held

    setattr(lifecycle, "claim", claim)  # noqa: B010 - the checker of types minds a plain assignment


def _send_copies(copies: int) -> None:
    """Send what the broker takes several times, whatever it is and whoever sends it; what it does not take, once."""
    original = Celery.send_task

    @functools.wraps(original)
    def send_task(self: Celery, *arguments: Any, **named: Any) -> Any:
        return [original(self, *arguments, **named) for _ in range(copies)][-1]

    Celery.send_task = send_task
