"""Waiting for submissions to change: long polls and event streams share one cheap query.

However many clients wait, one task asks the database for the marks of all watched submissions, a few times a second,
and only while somebody waits.
"""

import asyncio
import uuid
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import sqlalchemy as sa
import structlog
from starlette.concurrency import run_in_threadpool

from server.models import Submission
from server.services import Services

log = structlog.get_logger(__name__)

INTERVAL_S = 0.25

Mark = tuple[int, str | None, int]
"""Version, stage and images done: differs whenever a submission looks different."""


def mark_of(submission: Submission) -> Mark:
    """Give the mark of a submission as it is in memory."""
    return submission.version, submission.stage, submission.images_done


class Watch:
    """Tells waiting clients of one web process that a submission changed."""

    def __init__(self, services: Services, interval_s: float = INTERVAL_S) -> None:
        """Ask the database of `services` every `interval_s` seconds."""
        self._services = services
        self._interval_s = interval_s
        self._waiting: dict[uuid.UUID, set[_Waiter]] = {}
        self._task: asyncio.Task[None] | None = None

    async def wait(self, submission_id: uuid.UUID, known: Mark, timeout_s: float) -> bool:
        """Wait until the submission differs from `known`.

        Returns:
            False when `timeout_s` passed first.
        """
        async with self._registered(submission_id, known) as waiter:
            try:
                async with asyncio.timeout(timeout_s):
                    await waiter.changed.wait()
            except TimeoutError:
                return False
        return True

    async def close(self) -> None:
        """Stop asking."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
            self._task = None

    @asynccontextmanager
    async def _registered(self, submission_id: uuid.UUID, known: Mark) -> AsyncIterator["_Waiter"]:
        waiter = _Waiter(known)
        self._waiting.setdefault(submission_id, set()).add(waiter)
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._ask())
        try:
            yield waiter
        finally:
            others = self._waiting[submission_id]
            others.discard(waiter)
            if not others:
                del self._waiting[submission_id]

    async def _ask(self) -> None:
        while self._waiting:
            try:
                marks = await run_in_threadpool(self._marks, list(self._waiting))
            except Exception as error:  # noqa: BLE001 - those who wait must not wait for ever on a task that is gone
                # The database may be away for a moment; it is asked again.
                log.warning("watch_failed", error=repr(error))
                marks = {}
            for submission_id, mark in marks.items():
                for waiter in self._waiting.get(submission_id, ()):
                    waiter.tell(mark)
            await asyncio.sleep(self._interval_s)

    def _marks(self, submission_ids: list[uuid.UUID]) -> dict[uuid.UUID, Mark]:
        query = sa.select(Submission.id, Submission.version, Submission.stage, Submission.images_done)
        with self._services.snapshot() as session:
            rows = session.execute(query.where(Submission.id.in_(submission_ids)))
            return {row_id: (version, stage, done) for row_id, version, stage, done in rows}


class _Waiter:
    """One client that waits."""

    def __init__(self, known: Mark) -> None:
        self.changed = asyncio.Event()
        self._known = known

    def tell(self, mark: Mark) -> None:
        if mark != self._known:
            self.changed.set()
