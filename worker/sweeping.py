"""The sweeper within every worker: a thread of its main process, which also forks the processes that score.

A fork copies a lock that another thread holds, and nobody in the copy will ever give it up: a pool process forked while
this thread logs or asks the database could hang for ever. So a fork waits until the thread is between two passes.
"""

import os
import threading
from collections.abc import Callable

import structlog

from server import sweeper
from server.services import Services
from server.settings import Settings

log = structlog.get_logger(__name__)

PASSES_PER_FILE_SWEEP = 40

FORK_PATIENCE_S = 30.0
"""A pass that takes longer hangs at a service; then a pool process that may hang is better than none."""


class Sweeping(threading.Thread):
    """Sweeps from the worker's start to its end."""

    def __init__(self, settings: Settings, sweep_files: Callable[[], object]) -> None:
        """Sweep the installation of `settings`; files are swept elsewhere, by what `sweep_files` calls."""
        super().__init__(name="sweeping", daemon=True)
        self.stopped = threading.Event()
        self._settings = settings
        self._sweep_files = sweep_files
        self._between_passes = _ForkGuard()

    def run(self) -> None:
        """Sweep, wait, and so on; whatever fails is tried again next time."""
        with self._between_passes.lock:
            services = Services.from_settings(self._settings)
        passes = 0
        while True:
            with self._between_passes.lock:
                self._sweep(services, files=passes % PASSES_PER_FILE_SWEEP == 0)
            passes += 1
            if self.stopped.wait(self._settings.sweep_s):
                return

    def _sweep(self, services: Services, *, files: bool) -> None:
        try:
            sweeper.sweep(services)
            if files:
                self._sweep_files()
        except Exception as error:  # noqa: BLE001 - a database or broker that is away comes back
            log.warning("sweep_failed", error=repr(error))


class _ForkGuard:
    """A lock during which this process does not fork."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self._held = False
        os.register_at_fork(before=self._before, after_in_parent=self._after, after_in_child=self._after)

    def _before(self) -> None:
        self._held = self.lock.acquire(timeout=FORK_PATIENCE_S)

    def _after(self) -> None:
        if self._held:
            self._held = False
            self.lock.release()
