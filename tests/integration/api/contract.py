"""Requests generated from the OpenAPI document, and what every answer to them has to keep.

Run for a bounded number of requests by test_contract.py, and for any time by tests/fuzz/api.py.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, cast

import hypothesis
import schemathesis
from hypothesis import assume, given
from schemathesis import GenerationMode
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from tests.integration.api.test_following import own
from tests.integration.site import Site, send

CHECKS = [not_a_server_error, status_code_conformance, content_type_conformance, response_schema_conformance]

NOT_HTTP = b"Invalid HTTP request received."
"""The HTTP server's own answer to a request it cannot parse."""

schemathesis.serializer.alias("application/partial-upload", "application/octet-stream")


@dataclass(frozen=True, kw_only=True)
class Caller:
    """Who sends the generated requests, and the things that exist for them; every answer's status is kept."""

    token: str | None
    existing: dict[str, str] = field(default_factory=dict)
    statuses: list[int] = field(default_factory=list)

    @property
    def headers(self) -> dict[str, str]:
        """The caller's headers; none without a token."""
        return {"Authorization": f"Bearer {self.token}"} if self.token else {}


def operations(site: Site) -> list[Any]:
    """Read the operations of the served document, those that delete last.

    Event streams do not end and are tested elsewhere.
    """
    schema = schemathesis.openapi.from_url(f"{site.url}/api/v1/openapi.json")
    found: list[Any] = [cast("Any", result).ok() for result in schema.get_all_operations()]
    ending = [operation for operation in found if not operation.path.endswith("/events")]
    return sorted(ending, key=lambda operation: operation.method.upper() == "DELETE")


def make_existing(site: Site, token: str, archive: bytes, score: Callable[[str], None] | None) -> dict[str, str]:
    """Start an upload and send a submission, scored and published unless `score` is None; give what paths name them by."""
    with site.client(token) as client:
        sent = send(client, archive).json()
        if score:
            score(sent["id"])
            client.post(f"{own(sent)}/publication", json={"publication": "published"})
        upload = client.post(
            "/api/v1/uploads",
            params={"benchmark": "cs3d", "phase": "test", "method": "ours"},
            headers={"Upload-Length": "1000"},
        ).json()
    return {"submission_id": sent["id"], "upload_id": upload["id"], "benchmark": "cs3d", "phase": "test"}


def check_operation(operation: Any, caller: Caller, bounds: hypothesis.settings, *, seed: str | None = None) -> None:
    """Send generated requests, valid and invalid ones; with a seed, the same ones each time.

    Raises:
        FailureGroup: An answer is not what the document promises; it shows the request as a curl command.
    """

    @bounds
    @given(
        operation.as_strategy(generation_mode=GenerationMode.POSITIVE)
        | operation.as_strategy(generation_mode=GenerationMode.NEGATIVE)
    )
    def check(case: Any) -> None:
        _point_at(case, caller.existing)
        response = case.call(headers=caller.headers)
        # Negative requests may not be HTTP at all (RFC 9110, section 5.5); those never reach the application.
        assume(response.content != NOT_HTTP)
        caller.statuses.append(response.status_code)
        case.validate_response(response, checks=CHECKS, headers=caller.headers)

    (check if seed is None else hypothesis.seed(seed)(check))()


def _point_at(case: Any, existing: dict[str, str]) -> None:
    """Make a generated request be about things that exist, so that it gets further than to 404."""
    for values in (case.path_parameters or {}, case.query or {}):
        values.update({name: value for name, value in existing.items() if name in values})
