"""Requests that no page of ours sends."""

from collections.abc import Iterator

import httpx
import pytest

from tests.integration.pages.test_pages import csrf_of
from tests.integration.site import PASSWORD, Site


@pytest.fixture
def ann(site: Site) -> Iterator[httpx.Client]:
    """Give Ann's browser, logged in."""
    with site.client() as client:
        fields = {"csrf": csrf_of(client.get("/login").text), "email": "ann@example.org", "password": PASSWORD}
        client.post("/login", data=fields)
        yield client


@pytest.mark.parametrize("page", ["9" * 30, "9" * 5000, "-1", "x", "٣"])
def test_a_page_that_cannot_be_is_the_first_or_empty(ann: httpx.Client, page: str) -> None:
    """Numbers beyond what Python or the database holds are not an error of the server's."""
    assert ann.get("/submissions", params={"page": page}).status_code == 200


def test_numbers_beyond_the_database_are_refused(ann: httpx.Client) -> None:
    """A token's id and a lifetime with thousands of digits are refused like any other wrong value."""
    csrf = csrf_of(ann.get("/account").text)
    assert ann.post(f"/account/tokens/{'9' * 30}/revoke", data={"csrf": csrf}).status_code == 422
    fields = {"csrf": csrf, "name": "n", "team": "lab", "days": "9" * 5000}
    assert ann.post("/account/tokens", data=fields).status_code == 422


def test_who_is_not_logged_in_sends_no_archive(site: Site, archive: bytes) -> None:
    """A visitor with a page's CSRF token but no login is sent to the login before the body is read."""
    with site.client() as client:
        fields = {"csrf": csrf_of(client.get("/login").text), "team": "lab", "method": "ours"}
        answer = client.post("/benchmarks/cs3d/test/submit", data=fields, files={"predictions": ("p.zip", archive)})
    assert (answer.status_code, answer.headers["location"]) == (303, "/login")
