"""The OpenAPI document against the running application: no server error, no answer that is not documented."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, assume, given, settings
from schemathesis import GenerationMode
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from server.api.problems import all_errors, title_of
from tests.integration.api.test_following import own
from tests.integration.site import Site, send

ONE_SHAPE = pytest.mark.parametrize("shape", ["embedded"], indirect=True)
"""Hundreds of requests made at random: what they try lies before the database and the blobs."""

EXAMPLES = 12
"""Requests generated for each operation: a bounded run; `python3 do.py fuzz` is for long ones."""

CHECKS = [not_a_server_error, status_code_conformance, content_type_conformance, response_schema_conformance]

NOT_HTTP = b"Invalid HTTP request received."
"""The HTTP server's own answer to a request it cannot parse."""

schemathesis.serializer.alias("application/partial-upload", "application/octet-stream")

BOUNDED = settings(
    max_examples=EXAMPLES,
    deadline=None,
    derandomize=True,
    database=None,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=list(HealthCheck),
)


def operations(site: Site) -> list[Any]:
    """Read the operations of the served document; event streams do not end and are tested elsewhere."""
    schema = schemathesis.openapi.from_url(f"{site.url}/api/v1/openapi.json")
    found: list[Any] = [cast("Any", result).ok() for result in schema.get_all_operations()]
    return [operation for operation in found if not operation.path.endswith("/events")]


@ONE_SHAPE
@pytest.mark.parametrize("known", [True, False], ids=["member", "nobody"])
def test_every_answer_is_documented(site: Site, archive: bytes, score: Callable[[str], None], *, known: bool) -> None:
    """Generated requests, good and bad, with a token and without, get only what the OpenAPI document promises."""
    token = site.token()
    with site.client(token) as client:
        sent = send(client, archive).json()
        score(sent["id"])
        client.post(f"{own(sent)}/publication", json={"publication": "published"})
        upload = client.post(
            "/api/v1/uploads",
            params={"benchmark": "cs3d", "phase": "test", "method": "ours"},
            headers={"Upload-Length": "1000"},
        ).json()["id"]
    headers = {"Authorization": f"Bearer {token}"} if known else {}
    for operation in operations(site):

        @BOUNDED
        @_given(operation)
        def check(case: Any) -> None:
            if known:
                _point_at(
                    case, {"submission_id": sent["id"], "upload_id": upload, "benchmark": "cs3d", "phase": "test"}
                )
            response = case.call(headers=headers)
            # Negative requests may not be HTTP at all (RFC 9110, section 5.5); those never reach the application.
            assume(response.content != NOT_HTTP)
            case.validate_response(response, checks=CHECKS, headers=headers)

        check()


def _point_at(case: Any, real: dict[str, str]) -> None:
    """Make a generated request be about things that exist, so that it gets further than to 404."""
    for values in (case.path_parameters or {}, case.query or {}):
        values.update({name: value for name, value in real.items() if name in values})


def _given(operation: Any) -> Callable[[Callable[[Any], None]], Callable[[], None]]:
    """Give the requests to generate for an operation, valid and invalid ones."""
    strategy = operation.as_strategy(generation_mode=GenerationMode.POSITIVE) | operation.as_strategy(
        generation_mode=GenerationMode.NEGATIVE
    )
    return given(strategy)


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
    text = (Path(__file__).resolve().parents[3] / "docs" / "api.md").read_text(encoding="utf-8")
    table = text.partition("## Problems")[2].partition("## Limits")[0]
    listed = re.findall(r"^\| `([a-z_]+)` \| (\d+) \| (.*)\. \|$", table, re.MULTILINE)
    assert listed == [(code, str(kind.status), title_of(kind)) for code, kind in all_errors().items()]


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
