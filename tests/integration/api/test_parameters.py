"""Query parameters that an address does not have are refused, not lost."""

import re

import httpx
import pytest

from tests.integration.api.test_sending import PARAMS, left_behind, problem_of, recorded
from tests.integration.site import Site, send

pytestmark = pytest.mark.parametrize("shape", ["embedded"], indirect=True)
"""What is wrong is found before the database and the blobs."""

OF_AN_ORDER = "benchmark, phase, method, method_name, description, paper_url, code_url, file_name, team"


def reasons(response: httpx.Response) -> dict[str, str]:
    """Give what is said of each wrong value of a refused request."""
    assert (response.status_code, problem_of(response)["code"]) == (422, "invalid_request")
    return {error["pointer"]: error["detail"] for error in response.json()["errors"]}


@pytest.mark.parametrize(
    ("path", "says"),
    [
        (
            "/api/v1/submissions?stat=scored&limit=1",
            {"query/stat": "did you mean state? known: benchmark, phase, method, state, limit, offset"},
        ),
        ("/api/v1/leaderboards/cs3d/test?quantity=1", {"query/quantity": "there is no such parameter; known: format"}),
        ("/api/v1/leaderboards/cs3d/test?FORMAT=csv", {"query/FORMAT": "did you mean format?"}),
        ("/api/v1/benchmarks?a=1&b", {"query/a": "no query parameters", "query/b": "no query parameters"}),
        ("/api/v1/submissions?limit=1&limit=2", {"query/limit": "is given 2 times"}),
        ("/api/v1/openapi.json?x=1", {"query/x": "no query parameters"}),
    ],
)
def test_a_parameter_that_is_not_there_is_named(site: Site, path: str, says: dict[str, str]) -> None:
    """Unknown and repeated parameters are 422, each with what is known and the nearest of it."""
    with site.client() as client:
        found = reasons(client.get(path))
    assert found.keys() == says.keys()
    assert all(says[pointer] in found[pointer] for pointer in says)


def test_every_operation_refuses_them(site: Site) -> None:
    """Whatever the OpenAPI document lists answers 422 to a parameter it does not list, and documents that it does."""
    with site.client(site.token()) as client:
        paths = client.get("/api/v1/openapi.json").json()["paths"]
        for path, operations in paths.items():
            for method, operation in operations.items():
                answer = client.request(method, re.sub(r"{\w+}", "x", path), params={"no-parameter": "1"})
                assert answer.status_code == 422, (method, path)
                assert "422" in operation["responses"], (method, path)


def test_what_is_documented_passes(site: Site) -> None:
    """The parameters that the OpenAPI document lists are those an operation reads: none of them is refused as unknown."""
    with site.client() as client:
        for path, operations in client.get("/api/v1/openapi.json").json()["paths"].items():
            for method, operation in operations.items():
                listed = {one["name"]: "1" for one in operation.get("parameters", []) if one["in"] == "query"}
                answer = client.request(method, re.sub(r"{\w+}", "x", path), params=listed)
                assert "no such parameter" not in answer.text


def test_a_misspelt_description_costs_nothing(site: Site, archive: bytes) -> None:
    """An archive sent with `descripton` is refused before it is taken; with what submit.js and the client say, it is."""
    misspelt = {**PARAMS, "descripton": "Monocular."}
    usual = {**PARAMS, "method_name": "Ours", "description": "Monocular.", "team": "", "file_name": "p.zip"}
    with site.client(site.token()) as client:
        headers = {"Content-Type": "application/zip"}
        refused = client.post("/api/v1/submissions", params=misspelt, content=archive, headers=headers)
        assert reasons(refused)["query/descripton"].endswith(f"did you mean description? known: {OF_AN_ORDER}")
        assert recorded(site.services) == (0, 0)
        assert left_behind(site.services) == []
        taken = client.post("/api/v1/submissions", params=usual, content=archive, headers=headers)
        assert taken.status_code == 202
        assert client.get(taken.json()["links"]["self"], params={"wait": 0}).status_code == 200


def test_a_kept_status_is_no_way_around(site: Site, archive: bytes) -> None:
    """A submission whose answer is kept for those who ask again refuses unknown parameters all the same."""
    with site.client(site.token()) as client:
        own = send(client, archive).json()["links"]["self"]
        assert [client.get(own).status_code for _ in range(2)] == [200, 200]
        assert "query/wiat" in reasons(client.get(own, params={"wiat": 1}))


def test_many_wrong_ones_get_a_short_answer(site: Site) -> None:
    """Of thousands of unknown parameters ten are named, and long names are cut."""
    query = "&".join(f"{'n' * 100}{number}" for number in range(300))
    with site.client() as client:
        response = client.get(f"/api/v1/benchmarks?{query}")
    assert len(response.json()["errors"]) == 10
    assert len(response.content) < 4000


def test_pages_and_files_take_any(site: Site) -> None:
    """Links from elsewhere carry parameters of their own: pages pass over them."""
    with site.client() as client:
        for path in ("/", "/benchmarks/cs3d/test", "/login", "/static/base.css"):
            assert client.get(path, params={"utm_source": "elsewhere"}).status_code == 200
