"""The bounded places for uploads: few for one user, so that no account keeps the others out."""

import contextlib
import threading
import time
from collections.abc import Iterator

import httpx
import pytest

from server.api.spool import UploadLimits
from server.services import Services
from tests.integration.api.test_sending import begin_slowly, left_behind, problem_of
from tests.integration.api.test_uploads import PART, begin, part
from tests.integration.site import Site, running_site, send
from tests.services.processes import wait_until

pytestmark = pytest.mark.parametrize("shape", ["embedded"], indirect=True)
"""The places are those of one web process, whatever is behind it."""

LIMITS = UploadLimits(max_bytes=1 << 30, disk_floor_bytes=0, concurrency_of_user=2, patience_s=0)
FIELDS = {"benchmark": "cs3d", "phase": "test", "method": "ours"}


@contextlib.contextmanager
def slow_uploads(site: Site, token: str, count: int) -> Iterator[None]:
    """Keep uploads open whose bodies do not come."""
    with contextlib.ExitStack() as stack:
        for _ in range(count):
            stack.enter_context(begin_slowly(site, token, 1000))
        wait_until(lambda: len(left_behind(site.services)) == count, what="the slow uploads' files")
        yield


def test_one_user_cannot_take_every_place(quiet_services: Services, archive: bytes) -> None:
    """With a user's places full of slow uploads, another way of sending is refused too, and others are let in."""
    with running_site(quiet_services, limits=LIMITS) as site:
        token, stranger = site.token(), site.stranger()
        with slow_uploads(site, token, 2), site.client(token) as client, site.client(stranger) as other:
            raw = send(client, archive)
            form = client.post("/api/v1/submissions", data=FIELDS, files={"predictions": ("p.zip", archive)})
            resumed = part(client, begin(client, len(archive)), 0, archive)
            for response in (raw, form, resumed):
                assert (response.status_code, problem_of(response)["code"]) == (503, "too_many_own_uploads")
                assert int(response.headers["retry-after"]) >= 1
            assert send(other, archive).status_code == 202
        with site.client(token) as client:
            wait_until(lambda: not left_behind(quiet_services), what="the end of the slow uploads")
            assert send(client, archive).status_code == 202


def test_a_burst_waits_for_places(quiet_services: Services, archive: bytes) -> None:
    """More small uploads at once than there are places are all taken, one after another."""
    limits = UploadLimits(max_bytes=1 << 30, disk_floor_bytes=0, concurrency=1, patience_s=60)
    statuses = []
    with running_site(quiet_services, limits=limits) as site:
        token = site.token()

        def request() -> None:
            with httpx.Client(base_url=site.url, headers={"Authorization": f"Bearer {token}"}, timeout=90) as client:
                statuses.append(send(client, archive).status_code)

        threads = [threading.Thread(target=request) for _ in range(6)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert statuses == [202] * 6


@pytest.mark.parametrize("resumable", [False, True])
def test_a_client_that_trickles_is_let_go(quiet_services: Services, archive: bytes, *, resumable: bool) -> None:
    """A body that keeps coming, but byte by byte, is 408; a resumable upload keeps what came and goes on after it."""
    limits = UploadLimits(
        max_bytes=1 << 30, disk_floor_bytes=0, idle_timeout_s=2.0, min_rate_bytes_per_s=len(archive) * 100
    )

    def trickle() -> Iterator[bytes]:
        for place in range(len(archive)):
            yield archive[place : place + 1]
            time.sleep(0.02)

    with running_site(quiet_services, limits=limits) as site, site.client(site.token()) as client:
        if resumable:
            address = begin(client, len(archive))
            response = client.patch(address, content=trickle(), headers={**PART, "Upload-Offset": "0"})
        else:
            response = send(client, trickle())  # type: ignore[arg-type]  # httpx takes iterators
        assert (response.status_code, problem_of(response)["code"]) == (408, "upload_timeout")
        if resumable:
            offset = int(client.head(address).headers["upload-offset"])
            assert 0 < offset < len(archive)
            assert part(client, address, offset, archive[offset:]).status_code == 202
    assert left_behind(quiet_services) == []
