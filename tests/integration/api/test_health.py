"""GET /api/v1/health: what load balancers and supervisors poll."""

import dataclasses

import pytest

from server import database
from server.services import Services
from tests.integration.api.test_sending import problem_of
from tests.integration.site import Site, running_site
from tests.services.processes import free_port

HEALTH = "/api/v1/health"


def test_a_server_whose_database_answers_is_well(site: Site) -> None:
    """200 with a status for everybody, never kept by caches; HEAD is enough."""
    with site.client() as client:
        answer, head = client.get(HEALTH), client.head(HEALTH)
    assert (answer.status_code, answer.json(), answer.headers["cache-control"]) == (200, {"status": "ok"}, "no-store")
    assert (head.status_code, head.content) == (200, b"")


@pytest.mark.parametrize("shape", ["embedded"], indirect=True)
def test_a_database_that_is_away_is_told(quiet_services: Services) -> None:
    """503 as a problem document while nobody listens where the database should be."""
    nowhere = database.create_engine(f"postgresql+psycopg://nobody@127.0.0.1:{free_port()}/none")
    with running_site(dataclasses.replace(quiet_services, engine=nowhere)) as site, site.client() as client:
        answer = client.get(HEALTH)
    assert (answer.status_code, problem_of(answer)["code"]) == (503, "unavailable")
    assert answer.headers["cache-control"] == "no-store"


@pytest.mark.parametrize("shape", ["embedded"], indirect=True)
def test_health_is_not_limited(site: Site) -> None:
    """An address that is told to wait for its wrong tokens still gets an answer, whatever token it sends."""
    with site.client("cs3d_wrong") as client:
        refused = [client.get("/api/v1/submissions").status_code for _ in range(21)]
        assert refused[-1] == 429
        assert client.get(HEALTH).status_code == 200
