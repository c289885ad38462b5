"""What the sweeper deletes from disks, in both shapes."""

import dataclasses
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from server import file_sweeper, sweeper
from server.api import sweeping
from server.blobs import StoredBlob, record_blob
from server.services import Services


def _make_older(path: Path, hours: float) -> None:
    changed_at = path.stat().st_mtime - hours * 3600
    os.utime(path, (changed_at, changed_at))


@pytest.mark.parametrize("services", [{"orphan_grace_s": 3600.0, "score_time_s": 10.0}], indirect=True)
def test_unused_copies_and_abandoned_files_go_after_the_grace_time(services: Services) -> None:
    """Of two files of each kind the one that is two hours old is deleted; the one just made stays."""
    folders = [folder for folder in (services.blobs.incoming, services.blobs.cache) if folder]
    for folder in folders:
        (folder / "new").touch()
        (folder / "old").touch()
        _make_older(folder / "old", 2)
    assert sweeper.sweep_files(services) == len(folders)
    assert all([path.name for path in folder.iterdir()] == ["new"] for folder in folders)


@pytest.mark.parametrize("services", [{"orphan_grace_s": 3600.0}], indirect=True)
def test_a_blob_without_a_row_stays_for_the_grace_time(services: Services) -> None:
    """Its row may be about to be written."""
    sha256 = services.blobs.put_bytes(b"just promoted")
    assert sweeper.sweep_files(services) == 0
    assert services.blobs.local_path(sha256).read_bytes() == b"just promoted"


@pytest.mark.parametrize("services", [{"orphan_grace_s": 3600.0, "score_time_s": 3600.0}], indirect=True)
@pytest.mark.parametrize("sweep_files", [sweeper.sweep_files, sweeping.sweep_files])
def test_the_folder_of_an_attempt_stays_while_it_may_last(
    services: Services, sweep_files: Callable[[Services], int]
) -> None:
    """Nothing is written to it while others match its shards; after the worker's own limit nobody works there."""
    folder = services.blobs.incoming / "attempt.d"
    folder.mkdir()
    (folder / "predictions").touch()
    _make_older(folder, 1.5)  # the limit is two hours and four minutes
    assert sweep_files(services) == 0
    assert (folder / "predictions").exists()
    _make_older(folder, 1.5)
    assert sweep_files(services) == 1
    assert not folder.exists()


@dataclasses.dataclass
class Watched:
    """A blob store that acts at the end of every listing and notes how many blobs each transaction deleted."""

    services: Services
    listed: Callable[[], object]
    deleted: list[int] = dataclasses.field(default_factory=list)

    def __getattr__(self, name: str) -> Any:
        """Be the store otherwise."""
        return getattr(self.services.blobs, name)

    def stored(self) -> Iterator[StoredBlob]:
        """List everything."""
        yield from self.services.blobs.stored()
        self.listed()

    def delete(self, sha256: str) -> None:
        """Delete and count."""
        self.services.blobs.delete(sha256)
        self.deleted[-1] += 1


def test_orphans_go_in_batches_that_spare_what_is_recorded_meanwhile(
    services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No transaction, which uploads wait for, deletes more than a batch; a blob whose row was just written stays."""
    digests = [services.blobs.put_bytes(f"orphan {number}".encode()) for number in range(6)]

    def record() -> None:
        with services.transaction() as session:
            record_blob(session, services.blobs, digests[0], 8)

    store = Watched(services, listed=record)
    monkeypatch.setattr(file_sweeper, "BATCH", 2)
    watched = dataclasses.replace(services, blobs=store)
    begun = (services.engine, "begin", lambda _: store.deleted.append(0))
    sa.event.listen(*begun)
    try:
        assert file_sweeper.sweep_orphans(watched, grace_s=-60) == 5
    finally:
        sa.event.remove(*begun)
    # Six in three batches, one of them with the blob that stays.
    assert sorted(count for count in store.deleted if count) == [1, 2, 2]
    assert [services.blobs.exists(sha256) for sha256 in digests] == [True] + [False] * 5
