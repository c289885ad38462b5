"""Puts the points, and whatever else the environment asks for, around the real functions of a process."""

import functools
import os
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing, contextmanager
from typing import Any

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


def install(live: Iterable[str]) -> None:
    """Put everything in place; only the points named strike in this process."""
    points.install(live)
    wrap(FolderBlobs, "put_file", before="received", after="promoted")
    wrap(blobs, "_flush", after="fsynced")
    wrap(BucketBlobs, "put_file", before="fsynced")  # flushing is the store's own affair there
    wrap(BucketBlobs, "put_file", before="received", after="promoted")
    wrap(Queue, "enqueue", after="enqueued")
    _reach_after_commit()
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


def _reach_after_commit() -> None:
    """Reach the points that stand for a commit once it has returned."""
    original = Services.transaction

    @contextmanager
    def transaction(self: Services) -> Iterator[Any]:
        with original(self) as session:
            yield session
            done = session.info.get("done", ())
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
    """Send what the broker takes several times; what it does not take, once."""
    original = Queue.enqueue

    @functools.wraps(original)
    def enqueue(self: Queue, *arguments: Any, **named: Any) -> bool:
        return all(original(self, *arguments, **named) for _ in range(copies))

    Queue.enqueue = enqueue  # type: ignore[method-assign]  # that is what this module is for
