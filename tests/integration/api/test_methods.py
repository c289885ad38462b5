"""405: which methods an address takes."""

import pytest

from tests.integration.site import Site

pytestmark = pytest.mark.parametrize("shape", ["embedded"], indirect=True)
"""Nothing of this reaches the database or the blobs."""


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("DELETE", "/api/v1/submissions", "GET, HEAD, POST"),
        ("POST", "/api/v1/uploads/x", "DELETE, GET, HEAD, PATCH"),
        ("GET", "/api/v1/uploads", "POST"),
        ("HEAD", "/api/v1/uploads", "POST"),
        ("PUT", "/api/v1/leaderboards/cs3d/test", "GET, HEAD"),
        ("POST", "/api/v1/openapi.json", "GET, HEAD"),
        ("PROPFIND", "/login", "GET, HEAD, POST"),
        ("GET", "/logout", "POST"),
        ("DELETE", "/favicon.ico", "GET, HEAD"),
        ("POST", "/static/base.css", "GET, HEAD"),
    ],
)
def test_a_wrong_method_is_told_every_right_one(site: Site, method: str, path: str, allowed: str) -> None:
    """The header Allow of API, pages and files lists what all routes of the address take, sorted; the text says it, too."""
    with site.client() as client:
        answer = client.request(method, path)
    assert (answer.status_code, answer.headers["allow"]) == (405, allowed)
    assert method == "HEAD" or f"Use one of: {allowed}." in answer.text
