"""Removes what killed web processes left in the folders of this machine: half uploads, half charts, unused copies.

Workers sweep their own machine (`server/sweeper.py`); a web process on another one has folders that no worker sees.
Several web processes on one machine may all do this: a file that a living process holds is never deleted.
"""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

import structlog
from starlette.concurrency import run_in_threadpool

from server import file_sweeper, leftovers, uploads
from server.services import Services

log = structlog.get_logger(__name__)

PERIOD_S = 3600.0


@asynccontextmanager
async def swept(services: Services) -> AsyncIterator[None]:
    """Sweep at once and then every hour, for as long as the block lasts."""
    sweeping = asyncio.create_task(_sweep_regularly(services))
    try:
        yield
    finally:
        sweeping.cancel()
        with suppress(asyncio.CancelledError):
            await sweeping


async def _sweep_regularly(services: Services) -> None:
    while True:
        try:
            await run_in_threadpool(sweep_files, services)
        except Exception as error:  # noqa: BLE001 - a database that is away comes back
            log.warning("sweep_failed", error=repr(error))
        await asyncio.sleep(PERIOD_S)


def sweep_files(services: Services) -> int:
    """Sweep once.

    Returns:
        How many files were deleted.
    """
    settings = services.settings
    local = file_sweeper.sweep_local(services)
    charts = leftovers.delete_old(settings.data_dir / "charts", grace_s=settings.orphan_grace_s, pattern="*.part")
    with services.transaction() as session:
        parts = uploads.sweep(session, uploads.folder_of(settings.data_dir))
    return local + charts + parts
