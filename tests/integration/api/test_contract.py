"""The OpenAPI document against the running application: no server error, no answer that is not documented."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, settings

from server.api.problems import all_errors, title_of
from tests.integration.api.contract import Caller, check_operation, make_existing, operations
from tests.integration.site import Site

ONE_SHAPE = pytest.mark.parametrize("shape", ["embedded"], indirect=True)
"""Hundreds of requests made at random: what they try lies before the database and the blobs."""

API_PAGE = (Path(__file__).resolve().parents[3] / "docs" / "api.md").read_text(encoding="utf-8")

EXAMPLES = 12
"""Requests generated for each operation: a bounded run, the same each time; `python3 do.py fuzz` makes long ones."""

BOUNDED = settings(
    max_examples=EXAMPLES,
    deadline=None,
    derandomize=True,
    database=None,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=list(HealthCheck),
)


@ONE_SHAPE
@pytest.mark.parametrize("known", [True, False], ids=["member", "nobody"])
def test_every_answer_is_documented(site: Site, archive: bytes, score: Callable[[str], None], *, known: bool) -> None:
    """Generated requests, good and bad, with a token and without, get only what the OpenAPI document promises."""
    token = site.token()
    existing = make_existing(site, token, archive, score)
    caller = Caller(token=token, existing=existing) if known else Caller(token=None)
    for operation in operations(site):
        check_operation(operation, caller, BOUNDED)
    assert len(caller.statuses) > EXAMPLES


@ONE_SHAPE
def test_codes_are_stable_and_explained(site: Site) -> None:
    """Every code has one class, a status and a sentence, and its page exists where `type` points."""
    with site.client() as client:
        for code, kind in all_errors().items():
            assert kind.__doc__
            assert 400 <= kind.status <= 599
            assert client.get(f"/problems/{code}").status_code == 200


def test_the_documentation_lists_every_code() -> None:
    """docs/api.md has one line for each code, with its status and its sentence, and no other."""
    table = API_PAGE.partition("## Problems")[2].partition("## Limits")[0]
    listed = re.findall(r"^\| `([a-z_]+)` \| (\d+) \| (.*)\. \|$", table, re.MULTILINE)
    assert listed == [(code, str(kind.status), title_of(kind)) for code, kind in all_errors().items()]


@ONE_SHAPE
def test_the_documentation_lists_every_operation(site: Site) -> None:
    """The table of docs/api.md has every operation of the OpenAPI document once, and no other."""
    with site.client() as client:
        document = client.get("/api/v1/openapi.json").json()
    table = API_PAGE.partition("| request |")[2].partition("\n\n")[0]
    requests = "".join(re.findall(r"^\| (.*?) \|", table, re.MULTILINE))
    described = {
        f"{method.upper()} {re.sub('{[a-z]+_id}', '{id}', path.removeprefix('/api/v1'))}"
        for path, operations in document["paths"].items()
        for method in operations
    }
    assert sorted(re.findall(r"`([A-Z]+ [^`]+)`", requests)) == sorted(described)


@ONE_SHAPE
def test_documented_problems_have_examples(site: Site) -> None:
    """Every operation documents its problems by code, with an example each, and its success with a schema."""
    with site.client() as client:
        document = client.get("/api/v1/openapi.json").json()
    known = all_errors()
    for path in document["paths"].values():
        for operation in path.values():
            assert any(status < "400" for status in operation["responses"])
            for status, answer in operation["responses"].items():
                for code, example in (
                    answer.get("content", {}).get("application/problem+json", {}).get("examples", {}).items()
                ):
                    assert known[code].status == int(status) == example["value"]["status"]
