"""POST /api/v1/submissions: what is taken, and every way an upload is refused."""

import base64
import hashlib
import socket
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest
import sqlalchemy as sa

from server.api.spool import UploadLimits
from server.models import QuotaEntry, Submission
from server.services import Services
from tests.integration.site import Site, running_site, send
from tests.services.installation import SMALL_CASE, zip_of
from tests.services.processes import wait_until

PARAMS = {"benchmark": "cs3d", "phase": "test", "method": "ours"}
LIMITS = UploadLimits(max_bytes=1 << 30, disk_floor_bytes=0)


def problem_of(response: httpx.Response) -> dict[str, object]:
    """Read a problem document, checking its form (RFC 9457)."""
    assert response.headers["content-type"] == "application/problem+json"
    document: dict[str, object] = response.json()
    assert document["status"] == response.status_code
    assert {"type", "title", "detail", "code"} <= document.keys()
    return document


def recorded(services: Services) -> tuple[int, int]:
    """Count submissions and quota entries."""
    with services.snapshot() as session:
        return (
            session.scalar(sa.select(sa.func.count()).select_from(Submission)) or 0,
            session.scalar(sa.select(sa.func.count()).select_from(QuotaEntry)) or 0,
        )


def left_behind(services: Services) -> list[Path]:
    """List the temporary files that remain."""
    return list(services.blobs.incoming.iterdir())


def test_a_raw_body_is_taken_without_a_broker(site: Site, archive: bytes) -> None:
    """An archive sent as the body is answered 202 with its place and its digest, though no broker answers."""
    with site.client(site.token()) as client:
        response = send(client, archive)
        document = response.json()
        assert response.status_code == 202
        assert response.headers["location"] == document["links"]["self"]
        assert document["state"] == "received"
        assert document["predictions"]["sha256"] == hashlib.sha256(archive).hexdigest()
        assert document["predictions"]["size_bytes"] == len(archive)
        assert client.get(response.headers["location"]).json() == document
    assert site.services.blobs.read(document["predictions"]["sha256"]) == archive
    assert left_behind(site.services) == []


def test_a_form_is_taken(site: Site, archive: bytes) -> None:
    """The same as a form, with a shown name for the new method; the file keeps its name."""
    fields = {**PARAMS, "method_name": "Ours, revised"}
    with site.client(site.token()) as client:
        response = client.post("/api/v1/submissions", data=fields, files={"predictions": ("run 7.zip", archive)})
    assert response.status_code == 202
    assert response.json()["method_name"] == "Ours, revised"
    assert response.json()["predictions"]["file_name"] == "run 7.zip"


@pytest.mark.parametrize(
    ("query", "headers", "status", "code"),
    [
        ({}, {"Content-Type": "text/plain"}, 415, "unsupported_media_type"),
        ({}, {"Content-Type": ""}, 415, "unsupported_media_type"),
        ({}, {"Content-Encoding": "gzip"}, 415, "unsupported_media_type"),
        ({}, {"Content-Type": "multipart/form-data"}, 400, "malformed_request"),
        ({}, {"Content-Type": "multipart/form-data; boundary=x"}, 400, "malformed_request"),
        ({"method": ""}, {}, 422, "invalid_request"),
        ({"method": "Not A Slug"}, {}, 422, "invalid_field"),
        ({"phase": "nowhere"}, {}, 404, "not_found"),
        ({"team": "others"}, {}, 403, "forbidden"),
        ({}, {"Content-Digest": "md5"}, 400, "malformed_request"),
        ({}, {"Content-Digest": f"sha-256=:{base64.b64encode(bytes(32)).decode()}:"}, 422, "digest_mismatch"),
        ({}, {"Idempotency-Key": "k" * 256}, 422, "invalid_field"),
    ],
)
def test_bad_requests_cost_nothing(
    *, site: Site, archive: bytes, query: dict[str, str], headers: dict[str, str], status: int, code: str
) -> None:
    """A request that cannot become a submission is refused with its code; nothing is recorded or left on the disk."""
    with site.client(site.token()) as client:
        response = client.post(
            "/api/v1/submissions",
            params={**PARAMS, **query},
            content=archive,
            headers={"Content-Type": "application/zip", **headers},
        )
    assert (response.status_code, problem_of(response)["code"]) == (status, code)
    assert recorded(site.services) == (0, 0)
    assert left_behind(site.services) == []


@pytest.mark.parametrize("token", [None, "cs3d_wrong"])
def test_nobody_may_send(site: Site, archive: bytes, token: str | None) -> None:
    """Without a valid token the answer is 401 and says how to authenticate."""
    with site.client(token) as client:
        response = send(client, archive)
    assert response.status_code == 401
    assert problem_of(response)["code"] == "not_authenticated"
    assert response.headers["www-authenticate"].startswith("Bearer")


@pytest.mark.parametrize(
    ("body", "code"),
    [
        (b"", "not_a_zip"),
        (b"certainly not a zip", "not_a_zip"),
        (zip_of(SMALL_CASE / "pred") + b"more", "suffix_bytes"),
    ],
)
def test_a_bad_archive_is_refused_at_once_with_a_report(site: Site, body: bytes, code: str) -> None:
    """What breaks the framing rules is refused with 422 and the full report, and costs no quota."""
    with site.client(site.token()) as client:
        response = send(client, body)
    document = problem_of(response)
    assert (response.status_code, document["code"]) == (422, "archive_refused")
    report = document["report"]
    assert isinstance(report, dict)
    assert code in [group["code"] for group in report["groups"]]
    assert recorded(site.services) == (0, 0)
    assert left_behind(site.services) == []


def test_a_truncated_archive_is_refused_at_once(site: Site, archive: bytes) -> None:
    """An archive whose end is missing is refused with a report."""
    with site.client(site.token()) as client:
        response = send(client, archive[: len(archive) // 2])
    assert problem_of(response)["code"] == "archive_refused"


@pytest.mark.parametrize("chunked", [False, True])
def test_the_cap_holds_announced_or_not(quiet_services: Services, archive: bytes, *, chunked: bool) -> None:
    """One byte more than allowed is 413, whether Content-Length says so or the bytes just keep coming."""
    limits = UploadLimits(max_bytes=len(archive) - 1, disk_floor_bytes=0)
    with running_site(quiet_services, limits=limits) as site, site.client(site.token()) as client:
        body = iter([archive[:10], archive[10:]]) if chunked else archive
        response = send(client, body)  # type: ignore[arg-type]  # httpx takes both
        assert response.status_code == 413
        assert problem_of(response)["max_bytes"] == len(archive) - 1
    assert left_behind(quiet_services) == []


def test_the_cap_itself_is_taken(quiet_services: Services, archive: bytes) -> None:
    """Exactly as many bytes as allowed are taken."""
    limits = UploadLimits(max_bytes=len(archive), disk_floor_bytes=0)
    with running_site(quiet_services, limits=limits) as site, site.client(site.token()) as client:
        assert send(client, archive).status_code == 202


def test_the_disk_floor_holds(quiet_services: Services, archive: bytes) -> None:
    """With less space than the floor, an upload is 507 before its body is read."""
    limits = UploadLimits(max_bytes=1 << 30, disk_floor_bytes=1 << 60)
    with running_site(quiet_services, limits=limits) as site, site.client(site.token()) as client:
        response = send(client, archive)
    assert (response.status_code, problem_of(response)["code"]) == (507, "storage_full")


def test_a_request_without_a_body_is_told_so(site: Site) -> None:
    """Neither Content-Length nor Transfer-Encoding means no body, which is 411; an announced empty one is no zip, 422."""
    with site.client(site.token()) as client:
        request = client.build_request(
            "POST", "/api/v1/submissions", params=PARAMS, headers={"Content-Type": "application/zip"}
        )
        assert send(client, b"").status_code == 422
        del request.headers["content-length"]
        response = client.send(request)
    assert (response.status_code, problem_of(response)["code"]) == (411, "length_required")
    assert recorded(site.services) == (0, 0)


def begin_slowly(site: Site, token: str, length: int) -> socket.socket:
    """Open a connection that announces a body and sends only its beginning."""
    address = urlsplit(site.url)
    connection = socket.create_connection((address.hostname, address.port), timeout=10)
    head = (
        "POST /api/v1/submissions?benchmark=cs3d&phase=test&method=ours HTTP/1.1\r\n"
        f"Host: {address.netloc}\r\nAuthorization: Bearer {token}\r\n"
        f"Content-Type: application/zip\r\nContent-Length: {length}\r\n\r\nPK"
    )
    connection.sendall(head.encode())
    return connection


def test_a_client_that_stalls_is_let_go(quiet_services: Services) -> None:
    """A body that stops coming is answered 408 and the connection closed; the part on the disk is deleted."""
    limits = UploadLimits(max_bytes=1 << 30, disk_floor_bytes=0, idle_timeout_s=0.2)
    with running_site(quiet_services, limits=limits) as site:
        with begin_slowly(site, site.token(), 1000) as connection:
            answer = b"".join(iter(lambda: connection.recv(65536), b""))
        assert answer.startswith(b"HTTP/1.1 408 ")
        assert b'"code":"upload_timeout"' in answer
    assert left_behind(quiet_services) == []


def test_a_client_that_hangs_up_leaves_nothing(quiet_services: Services, archive: bytes) -> None:
    """A connection that breaks in mid-body leaves no file and no row, and its slot is free again."""
    limits = UploadLimits(max_bytes=1 << 30, disk_floor_bytes=0, concurrency=1)
    with running_site(quiet_services, limits=limits) as site, site.client(site.token()) as client:
        begin_slowly(site, site.token(), 1000).close()
        responses = (send(client, archive) for _ in range(50))
        assert next(response for response in responses if response.status_code != 503).status_code == 202
    assert recorded(quiet_services) == (1, 1)
    assert left_behind(quiet_services) == []


def test_one_upload_too_many_is_told_to_come_back(quiet_services: Services, archive: bytes) -> None:
    """With every place taken by a slow client, the next upload is 503 with Retry-After."""
    limits = UploadLimits(max_bytes=1 << 30, disk_floor_bytes=0, concurrency=1, patience_s=0)
    with (
        running_site(quiet_services, limits=limits) as site,
        site.client(site.token()) as client,
        begin_slowly(site, site.token(), 1000),
    ):
        wait_until(lambda: left_behind(quiet_services), what="the slow upload's file")
        response = send(client, archive)
        assert (response.status_code, problem_of(response)["code"]) == (503, "too_many_uploads")
        assert int(response.headers["retry-after"]) >= 1


def test_a_right_digest_is_taken(site: Site, archive: bytes) -> None:
    """A Content-Digest that fits is no obstacle, nor is one of an algorithm the server does not know."""
    digest = base64.b64encode(hashlib.sha256(archive).digest()).decode()
    with site.client(site.token()) as client:
        response = send(client, archive, Content_Digest=f"sha-512=:AAAA:, sha-256=:{digest}:")
    assert response.status_code == 202


def test_a_used_up_quota_is_said_before_the_body(tmp_path: Path, quiet_services: Services, archive: bytes) -> None:
    """When the team's quota is used up, the answer is 429 with Retry-After."""
    del tmp_path
    with quiet_services.transaction() as session:
        session.execute(sa.text("UPDATE phase SET submissions_per_day = 1"))
    with running_site(quiet_services, limits=LIMITS) as site, site.client(site.token()) as client:
        assert send(client, archive).status_code == 202
        response = send(client, archive)
    assert (response.status_code, problem_of(response)["code"]) == (429, "quota_exceeded")
    assert int(response.headers["retry-after"]) > 0
    assert recorded(quiet_services) == (1, 1)


def test_wrong_tokens_are_slowed_down(site: Site) -> None:
    """After twenty wrong tokens in a minute an address gets 429; nothing is even looked up."""
    with site.client("cs3d_wrong") as client:
        statuses = [client.get("/api/v1/submissions").status_code for _ in range(22)]
    assert statuses == [401] * 20 + [429] * 2
