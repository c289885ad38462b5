"""Deletes blobs that no row knows, and what crashes and finished work leave in this machine's folders of the blob store.

Part of what workers (server/sweeper.py) and web processes (server/api/sweeping.py) sweep.
"""

from collections.abc import Sequence
from datetime import UTC, datetime

import sqlalchemy as sa

from server import leftovers
from server.blobs import known_digests
from server.queue import hard_limit_s
from server.services import Services

BATCH = 50
"""Blobs deleted under one lock: so many calls to the store are the most that an upload waits for."""


def sweep_orphans(services: Services, *, grace_s: float) -> int:
    """Delete blobs that no row knows and that nobody put again for `grace_s` seconds.

    Returns:
        How many were deleted.
    """
    deadline = datetime.now(UTC).timestamp() - grace_s  # the store's clock is the only one its times can be held to
    with services.snapshot() as session:
        known = known_digests(session)
    # Listed without a lock: a large bucket takes its time, and uploads must not wait for it.
    old = (blob.sha256 for blob in services.blobs.stored() if blob.modified_at.timestamp() < deadline)
    orphans = [sha256 for sha256 in old if sha256 not in known]
    batches = (orphans[first : first + BATCH] for first in range(0, len(orphans), BATCH))
    return sum(_delete(services, batch) for batch in batches)


def _delete(services: Services, batch: Sequence[str]) -> int:
    """Delete those that are still without a row; none gets one meanwhile (`server.blobs.record_blob`)."""
    with services.transaction() as session:
        if session.get_bind().dialect.name == "postgresql":
            session.execute(sa.text("LOCK TABLE blob, shard IN SHARE ROW EXCLUSIVE MODE"))
        orphans = set(batch) - known_digests(session, batch)
        for sha256 in orphans:
            # A slow store may take longer than the database lets a transaction wait; with it the lock would be gone.
            session.execute(sa.select(1))
            services.blobs.delete(sha256)
    return len(orphans)


def sweep_local(services: Services) -> int:
    """Delete what nobody needs in the store's folders here: half files, results of killed workers, copies for reading.

    The folder of an attempt cannot be held, and the copy of its ground truth may be opened late: both are kept for as
    long as an attempt can last.

    Returns:
        How many files and folders were deleted.
    """
    grace_s = max(services.settings.orphan_grace_s, hard_limit_s(services.settings))
    folders = (services.blobs.incoming, services.blobs.cache)
    return sum(leftovers.delete_old(folder, grace_s=grace_s) for folder in folders if folder)
