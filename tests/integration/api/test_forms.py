"""Forms that are not as a browser or curl would send them: refused with their reason, under caps."""

import asyncio
from collections.abc import Sequence

import httpx
import pytest

from server.api.errors import MalformedRequest
from server.api.multipart import MAX_FIELD_BYTES, MAX_PARTS, Form, FormReader
from server.api.spool import FORM_OVERHEAD_BYTES, Spool, UploadLimits
from server.services import Services
from tests.integration.api.test_sending import left_behind, problem_of, recorded
from tests.integration.site import Site, running_site

pytestmark = pytest.mark.parametrize("shape", ["embedded"], indirect=True)
"""What these forms try lies before the database and the blobs."""

FIELDS = (("benchmark", b"cs3d"), ("phase", b"test"), ("method", b"ours"))
END = b"\r\n--b--\r\n"


def field(name: str, value: bytes) -> bytes:
    """Write one field, with the line break before its boundary."""
    return b'\r\n--b\r\nContent-Disposition: form-data; name="%s"\r\n\r\n%s' % (name.encode(), value)


def file(data: bytes, name: str = "predictions") -> bytes:
    """Write one file."""
    return b'\r\n--b\r\nContent-Disposition: form-data; name="%s"; filename="p.zip"\r\n\r\n%s' % (name.encode(), data)


def form(*parts: bytes, end: bytes = END, fields: Sequence[tuple[str, bytes]] = FIELDS) -> bytes:
    """Write a form with the usual fields before `parts`."""
    return b"".join((*(field(name, value) for name, value in fields), *parts, end))


def post(client: httpx.Client, body: bytes) -> httpx.Response:
    """Send a form as it is."""
    return client.post("/api/v1/submissions", content=body, headers={"Content-Type": "multipart/form-data; boundary=b"})


def test_the_forms_of_these_tests_are_taken(site: Site, archive: bytes) -> None:
    """Without anything odd the form is a submission; a short epilogue, which the standard allows, is passed over."""
    with site.client(site.token()) as client:
        assert post(client, form(file(archive))).status_code == 202
        assert post(client, form(file(archive)) + b"an epilogue\r\n").status_code == 202


@pytest.mark.parametrize(
    ("odd", "says"),
    [
        ([field("method", b"theirs")], "more than one part named 'method'"),
        ([field("team", b"lab"), field("team", b"lab")], "more than one part named 'team'"),
        ([file(b"PK")], "more than one part named 'predictions'"),
        ([field("description", b"d" * (MAX_FIELD_BYTES + 1))], "longer than 65536 bytes"),
        ([file(b"d" * (MAX_FIELD_BYTES + 1), "description")], "longer than 65536 bytes"),
        ([field("", b"value")], "no name"),
        ([b"\r\n--b\r\nContent-Type: text/plain\r\n\r\nvalue"], "no name"),
        ([b"\r\n--b\r\nContent-Disposition: form-data; name=" + b"n" * 10_000 + b"\r\n\r\n"], "cannot be read"),
        ([b"\r\n--b\r\nno header\r\n\r\n"], "cannot be read"),
    ],
)
def test_odd_parts_are_refused_by_their_reason(site: Site, archive: bytes, odd: list[bytes], says: str) -> None:
    """Repeated, oversized and unnamed parts are 400 and say which; nothing is recorded or left behind."""
    with site.client(site.token()) as client:
        response = post(client, form(file(archive), *odd))
    problem = problem_of(response)
    assert (response.status_code, problem["code"]) == (400, "malformed_request")
    assert says in str(problem["detail"])
    assert recorded(site.services) == (0, 0)
    assert left_behind(site.services) == []


@pytest.mark.parametrize(
    ("odd", "name"),
    [
        (file(b"d" * (MAX_FIELD_BYTES + 1), "file"), "file"),
        (field("descripton", b"Monocular."), "descripton"),
        (field("n" * 1000, b""), "n" * 64),
    ],
)
def test_parts_that_are_not_asked_for_are_refused_by_name(site: Site, archive: bytes, odd: bytes, name: str) -> None:
    """A part of another name is 422 at its header and says how the archive's part and the fields are called."""
    with site.client(site.token()) as client:
        response = post(client, form(odd, file(archive)))
    assert (response.status_code, problem_of(response)["code"]) == (422, "invalid_request")
    (error,) = response.json()["errors"]
    assert error["pointer"] == f"body/{name}"
    assert error["detail"] == (
        "there is no such field; the archive's part is called predictions, the other fields are"
        " benchmark, phase, method, method_name, description, paper_url, code_url, file_name, team"
    )
    assert recorded(site.services) == (0, 0)
    assert left_behind(site.services) == []


def test_the_number_of_parts_is_capped(site: Site) -> None:
    """However many names there are."""
    names = [f"field{number}" for number in range(MAX_PARTS + 1)]

    async def read(parts: int) -> Form:
        async with Spool(site.services.blobs.incoming, UploadLimits(max_bytes=1, disk_floor_bytes=0)) as spool:
            reader = FormReader(b"b", spool, file_field="predictions", known=names)
            await reader.feed(form(*(field(name, b"") for name in names[:parts]), fields=()))
            return reader.finish()

    assert len(asyncio.run(read(MAX_PARTS)).fields) == MAX_PARTS
    with pytest.raises(MalformedRequest, match="more than 24 parts"):
        asyncio.run(read(MAX_PARTS + 1))


@pytest.mark.parametrize("place", ["before", "after"])
def test_padding_is_capped(site: Site, archive: bytes, place: str) -> None:
    """What stands around the parts of a form, as its epilogue may, counts: beyond 2 MiB the form is 400."""
    padding = b"\r\n" * (FORM_OVERHEAD_BYTES // 2 + 1)
    body = form(file(archive))
    with site.client(site.token()) as client:
        response = post(client, padding + body if place == "before" else body + padding)
    assert (response.status_code, problem_of(response)["code"]) == (400, "malformed_request")
    assert left_behind(site.services) == []


@pytest.mark.parametrize("end", [b"", b"\r\n--b", b"\r\n--b-", b"\r\n--c--\r\n"])
def test_a_form_without_its_end_is_refused(site: Site, archive: bytes, end: bytes) -> None:
    """A form that ends before its closing boundary is 400, even when its archive is whole."""
    with site.client(site.token()) as client:
        response = post(client, form(file(archive), end=end))
    assert (response.status_code, problem_of(response)["code"]) == (400, "malformed_request")


@pytest.mark.parametrize(("spare", "status"), [(0, 202), (-1, 413)])
def test_the_cap_is_the_archives_not_the_forms(
    quiet_services: Services, archive: bytes, spare: int, status: int
) -> None:
    """An archive of exactly the size allowed is taken from a form; one byte more is 413."""
    limits = UploadLimits(max_bytes=len(archive) + spare, disk_floor_bytes=0)
    with running_site(quiet_services, limits=limits) as site, site.client(site.token()) as client:
        assert post(client, form(file(archive))).status_code == status


def test_a_form_announced_far_too_large_is_refused_before_its_body(quiet_services: Services, archive: bytes) -> None:
    """Content-Length alone is enough when even the largest form around an allowed archive would be smaller."""
    limits = UploadLimits(max_bytes=len(archive), disk_floor_bytes=0)
    with running_site(quiet_services, limits=limits) as site, site.client(site.token()) as client:
        response = post(client, bytes(len(archive) + FORM_OVERHEAD_BYTES + 1))
        assert (response.status_code, problem_of(response)["code"]) == (413, "too_large")


def every_way(client: httpx.Client, archive: bytes, **fields: str) -> list[httpx.Response]:
    """Send fields raw, in a form, and to begin a resumable upload."""
    given = {"benchmark": "cs3d", "phase": "test", "method": "ours", **fields}
    return [
        client.post("/api/v1/submissions", params=given, content=archive, headers={"Content-Type": "application/zip"}),
        client.post("/api/v1/submissions", data=given, files={"predictions": ("p.zip", archive)}),
        client.post("/api/v1/uploads", params=given, headers={"Upload-Length": "100"}),
    ]


@pytest.mark.parametrize(("name", "most"), [("description", 10_000), ("method_name", 200)])
def test_a_field_may_be_as_long_in_every_way_of_sending(site: Site, archive: bytes, name: str, most: int) -> None:
    """Raw, in a form and in a resumable upload the same length is taken; one character more is 422 and says where."""
    with site.client(site.token()) as client:
        taken = every_way(client, archive, **{name: "d" * most})
        refused = every_way(client, archive, **{name: "d" * (most + 1)})
    assert [response.status_code for response in taken] == [202, 202, 201]
    assert [(response.status_code, problem_of(response)["code"]) for response in refused] == [
        (422, "invalid_request")
    ] * 3
    places = [[error["pointer"] for error in response.json()["errors"]] for response in refused]
    assert places == [[f"query/{name}"], [f"body/{name}"], [f"query/{name}"]]
