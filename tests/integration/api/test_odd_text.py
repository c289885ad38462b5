"""Text that a database may not be able to keep, in both shapes."""

import pytest

from server.services import Services
from tests.integration.site import Site, populate, running_site, send


@pytest.fixture
def site(services: Services) -> Site:
    """Give a site in each shape; its web server runs for the test alone."""
    populate(services)
    return Site(url="", services=services)


def test_nul_characters_are_no_error_of_the_server(site: Site, archive: bytes) -> None:
    """PostgreSQL keeps no NUL in text, SQLite does: either way the answer is below 500 and the site goes on."""
    with running_site(site.services) as running, running.client(running.token()) as client:
        for path in ("/benchmarks/%00/test", "/methods/%00/x", "/api/v1/leaderboards/%00/test"):
            assert 400 <= client.get(path).status_code < 500
        query = {"benchmark": "cs3d", "phase": "test", "method": "other", "description": "a\0b"}
        headers = {"Content-Type": "application/zip"}
        sent = client.post("/api/v1/submissions", params=query, content=archive, headers=headers)
        assert sent.status_code in {202, 422}
        assert send(client, archive).status_code == 202
