"""What the sweeper deletes from disks, in both shapes."""

import os

import pytest

from server import sweeper
from server.services import Services


@pytest.mark.parametrize("services", [{"orphan_grace_s": 3600.0, "score_time_s": 10.0}], indirect=True)
def test_unused_copies_and_abandoned_files_go_after_the_grace_time(services: Services) -> None:
    """Of two files of each kind the one that is two hours old is deleted; the one just made stays."""
    folders = [folder for folder in (services.blobs.incoming, services.blobs.cache) if folder]
    for folder in folders:
        (folder / "new").touch()
        (folder / "old").touch()
        hours_ago = (folder / "old").stat().st_mtime - 2 * 3600
        os.utime(folder / "old", (hours_ago, hours_ago))
    assert sweeper.sweep_files(services) == len(folders)
    assert all([path.name for path in folder.iterdir()] == ["new"] for folder in folders)


@pytest.mark.parametrize("services", [{"orphan_grace_s": 3600.0}], indirect=True)
def test_a_blob_without_a_row_stays_for_the_grace_time(services: Services) -> None:
    """Its row may be about to be written."""
    sha256 = services.blobs.put_bytes(b"just promoted")
    assert sweeper.sweep_files(services) == 0
    assert services.blobs.local_path(sha256).read_bytes() == b"just promoted"
