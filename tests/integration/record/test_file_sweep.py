"""What the sweeper deletes from disks, in both shapes."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from server import sweeper
from server.api import sweeping
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
