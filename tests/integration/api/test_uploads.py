"""Resumable uploads: parts, offsets, digests, interruptions, expiry."""

import base64
import hashlib
import threading
from collections.abc import Iterator

import httpx
import pytest
import sqlalchemy as sa

from server import uploads
from server.api.sweeping import sweep_files
from tests.integration.site import Site
from tests.services.processes import wait_until

PARAMS = {"benchmark": "cs3d", "phase": "test", "method": "ours"}
PART = {"Content-Type": "application/partial-upload"}


def begin(client: httpx.Client, length: int, **headers: str) -> str:
    """Begin an upload and give its address."""
    named = {"Upload-Length": str(length), **{name.replace("_", "-"): value for name, value in headers.items()}}
    response = client.post("/api/v1/uploads", params=PARAMS, headers=named)
    assert (response.status_code, response.headers["upload-offset"]) == (201, "0")
    address: str = response.headers["location"]
    return address


def part(client: httpx.Client, address: str, offset: int, data: bytes, **headers: str) -> httpx.Response:
    """Send a part."""
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return client.patch(address, content=data, headers={**PART, "Upload-Offset": str(offset), **named})


def digest_of(data: bytes) -> str:
    """Write a SHA-256 as RFC 9530 does."""
    return f"sha-256=:{base64.b64encode(hashlib.sha256(data).digest()).decode()}:"


def part_files(site: Site) -> list[str]:
    """List the part files on the disk."""
    return [path.name for path in uploads.folder_of(site.services.settings.data_dir).glob("*")]


def test_parts_become_one_submission(site: Site, archive: bytes) -> None:
    """Three parts with their digests make the submission of the whole archive; no part file is left."""
    third = len(archive) // 3
    with site.client(site.token()) as client:
        address = begin(client, len(archive), Repr_Digest=digest_of(archive))
        for offset in (0, third):
            data = archive[offset : offset + third]
            response = part(client, address, offset, data, Content_Digest=digest_of(data))
            assert (response.status_code, response.headers["upload-offset"]) == (204, str(offset + third))
            assert client.head(address).headers["upload-offset"] == str(offset + third)
        done = part(client, address, 2 * third, archive[2 * third :])
        assert done.status_code == 202
        assert done.json()["predictions"]["sha256"] == hashlib.sha256(archive).hexdigest()
        assert client.get(done.headers["location"]).status_code == 200
        assert client.get(address).json()["submission_id"] == done.json()["id"]
        # A lost answer is asked for again: the same submission.
        assert part(client, address, 2 * third, archive[2 * third :]).json()["id"] == done.json()["id"]
    assert part_files(site) == []


def test_a_part_must_begin_where_the_upload_ends(site: Site, archive: bytes) -> None:
    """A part with another offset is 409 and says where to go on; nothing is written."""
    with site.client(site.token()) as client:
        address = begin(client, len(archive))
        part(client, address, 0, archive[:10])
        response = part(client, address, 5, archive[5:])
        assert (response.status_code, response.json()["code"], response.json()["offset"]) == (
            409,
            "offset_mismatch",
            10,
        )
        assert response.headers["upload-offset"] == "10"
        assert part(client, address, 10, archive[10:]).status_code == 202


def test_a_damaged_part_is_not_kept(site: Site, archive: bytes) -> None:
    """A part that differs from its digest is 422, and the offset stays where it was."""
    with site.client(site.token()) as client:
        address = begin(client, len(archive))
        response = part(client, address, 0, archive[:10], Content_Digest=digest_of(b"other"))
        assert (response.status_code, response.json()["code"]) == (422, "digest_mismatch")
        assert client.head(address).headers["upload-offset"] == "0"
        assert part(client, address, 0, archive).status_code == 202


def test_a_broken_connection_keeps_what_arrived(site: Site) -> None:
    """When a part breaks off, the bytes that were read are safe, and the upload goes on after them."""
    mib = 1 << 20
    folder = uploads.folder_of(site.services.settings.data_dir)

    def breaking() -> Iterator[bytes]:
        yield bytes(2 * mib)
        wait_until(lambda: any(path.stat().st_size >= mib for path in folder.glob("*")), what="a MiB on the disk")
        raise ConnectionResetError

    with site.client(site.token()) as client:
        address = begin(client, 3 * mib)
        with pytest.raises(ConnectionResetError):
            client.patch(address, content=breaking(), headers={**PART, "Upload-Offset": "0"})
    with site.client(site.token()) as client:
        wait_until(lambda: int(client.head(address).headers["upload-offset"]) >= mib, what="a safe MiB")
        offset = int(client.head(address).headers["upload-offset"])
        assert part(client, address, offset, b"more").headers["upload-offset"] == str(offset + 4)


def test_more_than_announced_is_refused(site: Site, archive: bytes) -> None:
    """A part that goes beyond the announced length is refused and not kept."""
    with site.client(site.token()) as client:
        address = begin(client, len(archive) - 1)
        response = part(client, address, 0, archive)
        assert (response.status_code, response.json()["code"]) == (400, "malformed_request")
        assert client.head(address).headers["upload-offset"] == "0"


def test_a_whole_that_differs_from_its_digest_is_over(site: Site, archive: bytes) -> None:
    """When the whole is not what was announced, the upload ends with 422 and its bytes are deleted."""
    with site.client(site.token()) as client:
        address = begin(client, len(archive), Repr_Digest=digest_of(b"other"))
        response = part(client, address, 0, archive)
        assert (response.status_code, response.json()["code"]) == (422, "digest_mismatch")
        assert client.get(address).status_code == 404
    assert part_files(site) == []


def test_a_bad_archive_ends_the_upload_with_its_report(site: Site) -> None:
    """Bytes that are no archive end as they do in one piece: 422 with the report, no quota used."""
    with site.client(site.token()) as client:
        address = begin(client, 9)
        response = part(client, address, 0, b"not a zip")
        assert (response.status_code, response.json()["code"]) == (422, "archive_refused")
        assert response.json()["report"]["groups"]
        assert client.get("/api/v1/submissions").json()["submissions"] == []
    assert part_files(site) == []


def test_others_have_no_part_in_it(site: Site, archive: bytes) -> None:
    """Somebody else's upload does not exist; its owner may delete it."""
    with site.client(site.token()) as client, site.client(site.stranger()) as other:
        address = begin(client, len(archive))
        assert other.get(address).status_code == 404
        assert part(other, address, 0, archive).status_code == 404
        assert other.delete(address).status_code == 404
        assert client.delete(address).status_code == 204
        assert client.get(address).status_code == 404


def test_uploads_expire_with_their_bytes(site: Site, archive: bytes) -> None:
    """An upload nobody went on with is gone after its time, and its bytes with the next sweep."""
    with site.client(site.token()) as client:
        address = begin(client, len(archive))
        part(client, address, 0, archive[:10])
        assert len(part_files(site)) == 1
        with site.services.transaction() as session:
            session.execute(sa.text("UPDATE upload SET expires_at = '2020-01-01 00:00:00.000000'"))
        assert client.get(address).status_code == 404
    assert sweep_files(site.services) == 1
    assert part_files(site) == []


@pytest.mark.parametrize(
    ("headers", "status", "code"),
    [
        ({}, 422, "invalid_request"),
        ({"Upload-Length": "0"}, 422, "invalid_request"),
        ({"Upload-Length": "ten"}, 422, "invalid_request"),
        ({"Upload-Length": str(1 << 40)}, 413, "too_large"),
    ],
)
def test_a_length_must_be_announced(site: Site, headers: dict[str, str], status: int, code: str) -> None:
    """An upload without a usable length is refused before anything is made."""
    with site.client(site.token()) as client:
        response = client.post("/api/v1/uploads", params=PARAMS, headers=headers)
    assert (response.status_code, response.json()["code"]) == (status, code)


def test_parts_have_their_own_media_type(site: Site, archive: bytes) -> None:
    """A part sent as another type is 415."""
    with site.client(site.token()) as client:
        address = begin(client, len(archive))
        response = client.patch(address, content=archive, headers={"Upload-Offset": "0"})
    assert (response.status_code, response.json()["code"]) == (415, "unsupported_media_type")


def test_parts_are_not_compressed_on_top(site: Site, archive: bytes) -> None:
    """A part with a content coding, which nothing here undoes, is 415 and not kept."""
    with site.client(site.token()) as client:
        address = begin(client, len(archive))
        response = part(client, address, 0, archive, Content_Encoding="gzip")
        assert (response.status_code, response.json()["code"]) == (415, "unsupported_media_type")
        assert client.head(address).headers["upload-offset"] == "0"


def test_last_parts_at_once_make_one_submission(site: Site, archive: bytes) -> None:
    """Of eight simultaneous last parts one makes the submission; the others are told so, or that one is writing."""
    answers: list[httpx.Response] = []
    token = site.token()
    with site.client(token) as client:
        address = begin(client, len(archive))
        assert part(client, address, 0, archive[:50]).status_code == 204

    def request() -> None:
        with site.client(token) as client:
            answers.append(part(client, address, 50, archive[50:]))

    threads = [threading.Thread(target=request) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    told = {"upload_busy", "offset_mismatch"}
    assert {answer.status_code for answer in answers} <= {202, 409}
    assert {answer.json()["code"] for answer in answers if answer.status_code == 409} <= told
    assert len({answer.json()["id"] for answer in answers if answer.status_code == 202}) == 1
    with site.client(token) as client:
        assert len(client.get("/api/v1/submissions").json()["submissions"]) == 1


def test_unfinished_uploads_are_bounded(site: Site) -> None:
    """A team may have ten unfinished uploads; the eleventh is 429."""
    with site.client(site.token()) as client:
        for _ in range(uploads.MAX_OPEN):
            begin(client, 100)
        response = client.post("/api/v1/uploads", params=PARAMS, headers={"Upload-Length": "100"})
    assert (response.status_code, response.json()["code"]) == (429, "quota_exceeded")
