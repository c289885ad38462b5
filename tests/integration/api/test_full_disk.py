"""A disk that is really full: a small file system of its own, filled to its last byte or its last file."""

import contextlib
import subprocess
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest

from server import database, uploads
from server.api.spool import UploadLimits
from server.errors import StorageFull
from server.services import Services
from server.settings import Settings
from tests.integration.api.test_sending import left_behind, problem_of, recorded
from tests.integration.api.test_uploads import begin, part
from tests.integration.site import Site, populate, running_site, send
from worker.evaluation import evaluate_submission
from worker.sandbox import Sandbox

MIB = 1 << 20
SIZE = "size=16m,nr_inodes=200"
LIMITS = UploadLimits(max_bytes=1 << 30, disk_floor_bytes=0)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """Give a file system of 16 MiB and 200 files."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", SIZE, "none", str(place)]
    if subprocess.run(mount, check=False, capture_output=True).returncode:
        pytest.skip("a file system can be mounted only as root, and not in every container")
    yield place
    subprocess.run(["umount", "--lazy", str(place)], check=True)


@pytest.fixture
def small_site(small_disk: Path, tmp_path: Path) -> Iterator[Site]:
    """Give a running application whose files are on the small disk, and its database elsewhere."""
    services = Services.from_settings(
        Settings(
            data_dir=small_disk / "data",
            database_url=f"sqlite:///{tmp_path / 'record.sqlite'}",
            broker_url=f"redis+socket://{tmp_path / 'nobody.sock'}",
            broker_timeout_s=0.1,
            disk_floor_bytes=0,
        )
    )
    database.migrate(services.engine)
    populate(services)
    with running_site(services, limits=LIMITS) as site:
        yield site
    services.close()


def fill(disk: Path) -> Path:
    """Take the last byte of a disk, and give the file that holds it."""
    filler = disk / "filler"
    with contextlib.suppress(OSError), filler.open("wb", buffering=0) as file:
        while file.write(bytes(4096)):
            pass
    return filler


def use_up_files(disk: Path) -> None:
    """Make files until no more can be made."""
    with contextlib.suppress(OSError):
        for number in range(1000):
            (disk / f"file-{number}").touch()


@pytest.mark.parametrize("exhaust", [fill, use_up_files])
def test_every_way_of_sending_says_that_the_disk_is_full(
    small_site: Site, small_disk: Path, archive: bytes, exhaust: Callable[[Path], object]
) -> None:
    """Raw bodies, forms and parts are 507 `storage_full`; nothing is recorded or left behind."""
    fields = {"benchmark": "cs3d", "phase": "test", "method": "ours"}
    with small_site.client(small_site.token()) as client:
        address = begin(client, len(archive))
        exhaust(small_disk)
        form = client.post("/api/v1/submissions", data=fields, files={"predictions": ("p.zip", archive)})
        for response in (send(client, archive), form, part(client, address, 0, archive)):
            assert (response.status_code, problem_of(response)["code"]) == (507, "storage_full")
    assert recorded(small_site.services) == (0, 0)
    assert left_behind(small_site.services) == []


def test_a_part_goes_on_once_there_is_room(small_site: Site, small_disk: Path, archive: bytes) -> None:
    """What was safe before the disk ran full stays safe, and the upload is completed from there."""
    with small_site.client(small_site.token()) as client:
        address = begin(client, len(archive))
        assert part(client, address, 0, archive[:100]).status_code == 204
        # The first page of the part file has room for no more than 4096 bytes; the archive is smaller, so the part
        # that does not fit is of another upload.
        other = begin(client, 8 * MIB)
        filler = fill(small_disk)
        assert part(client, other, 0, bytes(MIB)).status_code == 507
        assert client.head(other).headers["upload-offset"] == "0"
        filler.unlink()
        assert part(client, other, 0, bytes(MIB)).status_code == 204
        assert part(client, address, 100, archive[100:]).status_code == 202


def test_a_body_that_does_not_fit_is_removed(small_site: Site, small_disk: Path, archive: bytes) -> None:
    """A body of unknown length that fills the disk is 507 and frees it again: the next one is taken."""

    def body() -> Iterator[bytes]:
        for _ in range(32):
            yield bytes(MIB)

    with small_site.client(small_site.token()) as client:
        with contextlib.suppress(httpx.WriteError):  # the server answers and hangs up while more is sent
            response = send(client, body())  # type: ignore[arg-type]  # httpx takes iterators
            assert (response.status_code, problem_of(response)["code"]) == (507, "storage_full")
        assert send(client, archive).status_code == 202
    assert left_behind(small_site.services) == []
    assert small_disk.exists()


def test_the_floor_holds_while_a_body_arrives(small_disk: Path, small_site: Site, archive: bytes) -> None:
    """A body of unknown length ends where it would take the space that uploads leave."""
    limits = UploadLimits(max_bytes=1 << 30, disk_floor_bytes=8 * MIB)
    with running_site(small_site.services, limits=limits) as site, site.client(site.token()) as client:
        assert send(client, archive).status_code == 202
        with contextlib.suppress(httpx.WriteError):
            assert send(client, iter([bytes(MIB)] * 12)).status_code == 507  # type: ignore[arg-type]  # as above
        # 16 MiB less 8 MiB for others: a file of 8 MiB still fits beside what is there
        (small_disk / "others").write_bytes(bytes(8 * MIB - 64 * 1024))
    assert left_behind(small_site.services) == []


def test_scores_are_shown_on_a_full_disk(small_site: Site, small_disk: Path, archive: bytes, sandbox: Sandbox) -> None:
    """The charts of a submission's page are drawn although they cannot be kept."""
    with small_site.client(small_site.token()) as client:
        sent = send(client, archive).json()
        evaluate_submission(small_site.services, sandbox, uuid.UUID(sent["id"]), worker="test")
        client.post(f"{sent['links']['self']}/publication", json={"publication": "published"})
        fill(small_disk)
        use_up_files(small_disk)
        page = client.get(f"/submissions/{sent['id']}")
        assert page.status_code == 200
        assert page.text.count('role="img"') == 6  # five metrics over distance, and precision over recall
    assert list((small_disk / "data").glob("charts/*.part")) == []


def test_a_blob_that_does_not_fit_leaves_nothing(small_site: Site, small_disk: Path) -> None:
    """Bytes that cannot be kept are said, and half of them do not stay."""
    with pytest.raises(StorageFull):
        small_site.services.blobs.put_bytes(bytes(32 * MIB))
    assert left_behind(small_site.services) == []
    (small_disk / "fits").write_bytes(bytes(8 * MIB))
    assert not list(uploads.folder_of(small_disk / "data").glob("*"))
