"""What killed web processes leave behind goes; what living ones write to stays."""

import os
import threading
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
import sqlalchemy as sa

from server import uploads
from server.api.sweeping import sweep_files
from server.services import Services
from tests.integration.api.test_sending import left_behind
from tests.integration.api.test_uploads import PART, begin, part_files
from tests.integration.site import Site, running_site, send
from tests.services.processes import wait_until


def make_old(path: Path) -> None:
    """Let a file look as if nobody had written to it for two hours, twice the grace time."""
    hours_ago = path.stat().st_mtime - 2 * 3600
    os.utime(path, (hours_ago, hours_ago))


def leave_behind(services: Services) -> list[Path]:
    """Make what a web process killed two hours ago leaves in each of its folders."""
    data = services.settings.data_dir
    files = [
        services.blobs.incoming / "upload-lost",
        uploads.folder_of(data) / "11111111-2222-3333-4444-555555555555.part",
        data / "charts" / "chart.lost.part",
    ]
    for path in files:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"half")
        make_old(path)
    return files


class Paused:
    """A body that stops in the middle until it is told to go on."""

    def __init__(self, data: bytes) -> None:
        """Take the bytes."""
        self._data = data
        self.go_on = threading.Event()

    def __iter__(self) -> Iterator[bytes]:
        """Give half, wait, and give the rest."""
        middle = len(self._data) // 2
        yield self._data[:middle]
        self.go_on.wait(60)
        yield self._data[middle:]


def test_a_web_process_sweeps_its_folders_when_it_starts(quiet_services: Services) -> None:
    """Without any worker on its machine, old leftovers go; a chart that is whole stays."""
    files = leave_behind(quiet_services)
    whole = files[2].with_name("chart.svg")
    whole.write_text("<svg/>")
    make_old(whole)
    with running_site(quiet_services):
        wait_until(lambda: not any(path.exists() for path in files), what="the end of the leftovers")
    assert whole.exists()


def test_new_files_stay(quiet_services: Services) -> None:
    """What was written within the grace time may belong to somebody."""
    new = quiet_services.blobs.incoming / "upload-new"
    new.touch()
    assert sweep_files(quiet_services) == 0
    assert new.exists()


def test_a_live_upload_survives_the_sweep_of_another_process(site: Site, archive: bytes) -> None:
    """A file that a living process holds stays however old it looks, and its upload is taken."""
    body, answers = Paused(archive), []

    def request(token: str) -> None:
        with site.client(token) as client:
            answers.append(send(client, body).status_code)  # type: ignore[arg-type]  # httpx takes iterables

    sending = threading.Thread(target=request, args=(site.token(),))
    sending.start()
    wait_until(lambda: left_behind(site.services), what="the upload's file")
    make_old(left_behind(site.services)[0])
    other = Services.from_settings(site.services.settings)
    assert sweep_files(other) == 0
    body.go_on.set()
    sending.join()
    other.close()
    assert answers == [202]


@pytest.mark.parametrize("ending", ["expired", "completed"])
def test_a_part_in_transit_is_not_pulled_away(site: Site, archive: bytes, ending: str) -> None:
    """A sweep leaves the file of a part that is arriving; when its upload expired meanwhile, the part is 404."""
    body: Paused = Paused(archive)
    answers: list[httpx.Response] = []

    with site.client(site.token()) as client:
        address = begin(client, len(archive))

        def request() -> None:
            answers.append(client.patch(address, content=body, headers={**PART, "Upload-Offset": "0"}))

        sending = threading.Thread(target=request)
        sending.start()
        wait_until(lambda: part_files(site), what="the part's file")
        if ending == "expired":
            with site.services.transaction() as session:
                session.execute(sa.text("UPDATE upload SET expires_at = '2020-01-01 00:00:00.000000'"))
        assert sweep_files(site.services) == 0
        assert len(part_files(site)) == 1
        body.go_on.set()
        sending.join()
        (answer,) = answers
        if ending == "expired":
            assert (answer.status_code, answer.json()["code"]) == (404, "not_found")
            assert sweep_files(site.services) == 1
        else:
            assert answer.status_code == 202
    assert part_files(site) == []
