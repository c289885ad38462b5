"""Everything a process of ours works with, opened once at its edge and handed inwards: no global state."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Self

import sqlalchemy as sa
from sqlalchemy.orm import Session

from server import database
from server.blobs import Blobs, open_blobs
from server.queue import Queue
from server.settings import Settings


@dataclass(frozen=True, slots=True)
class Services:
    """Database, blob store and queue of one installation."""

    settings: Settings
    engine: sa.Engine
    blobs: Blobs
    queue: Queue

    @classmethod
    def from_settings(cls, settings: Settings) -> Self:
        """Open what the settings name. Nothing is asked of the database or the broker yet."""
        settings.data_dir.mkdir(mode=0o700, parents=True, exist_ok=True)  # it holds hidden ground truth
        engine = database.create_engine(settings.database)
        return cls(settings=settings, engine=engine, blobs=open_blobs(settings), queue=Queue(settings))

    @contextmanager
    def transaction(self) -> Iterator[Session]:
        """Give a session whose changes are committed together at the end, or not at all.

        Rows stay readable after the commit. Send messages to the queue after this, never inside.

        Raises:
            Unavailable: The database is away, or went away: then the change may or may not have been made.
            StorageFull: Its disk is full.
        """
        with (
            database.outages_are_said(),
            Session(self.engine, expire_on_commit=False, info={"blobs": self.blobs}) as session,
            session.begin(),
        ):
            yield session

    @contextmanager
    def snapshot(self) -> Iterator[Session]:
        """Give a session that reads one consistent state and waits for no writer; nothing is committed."""
        engine = database.snapshot_engine(self.engine)
        with database.outages_are_said(), Session(engine, expire_on_commit=False, autoflush=False) as session:
            yield session

    def close(self) -> None:
        """Close every connection; the services may be used again afterwards."""
        self.engine.dispose()
        self.queue.close()
