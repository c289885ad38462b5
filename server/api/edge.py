"""What every endpoint shares: its services, JSON answers, conditional requests and OpenAPI's list of answers."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any, TypeVar

import msgspec
from fastapi import Depends, FastAPI
from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response

from evaluator.errors import BenchmarkError
from server.api import problems
from server.api.identity import Credentials, Identities, Identity, credentials_of
from server.api.polling import Polls, names_version
from server.api.problems import title_of
from server.api.spool import UploadGate
from server.api.watch import Watch
from server.charts import ChartStore
from server.services import Services
from server.standings import StandingsCache

POLL_S = 2
"""Retry-After of a submission that is not done."""


@dataclass(frozen=True, slots=True)
class Web:
    """What one web process works with."""

    services: Services
    identities: Identities
    gate: UploadGate
    watch: Watch
    polls: Polls
    charts: ChartStore
    standings: StandingsCache = field(default_factory=StandingsCache)


def attach(app: FastAPI, web: Web) -> None:
    """Hand an application what its endpoints work with."""
    app.state.web = web


def web_of(request: Request) -> Web:
    """Give what the application of this request works with."""
    web: Web = request.app.state.web
    return web


WebDependency = Annotated[Web, Depends(web_of)]
Asker = Annotated[Credentials, Depends(credentials_of)]

T = TypeVar("T")


def read(web: Web, asker: Credentials, work: Callable[[Session, Identity | None], T]) -> T:
    """Do read-only work in one snapshot, for whoever asks. Blocks: call it on a thread."""
    with web.services.snapshot() as session:
        return work(session, web.identities.identify(session, asker))


def change(web: Web, asker: Credentials, work: Callable[[Session, Identity], T]) -> T:
    """Do work that changes the record in one transaction, for somebody known. Blocks: call it on a thread."""
    # Looked up first on its own: a wrong token must not wait for, or hold, the writers' lock.
    with web.services.snapshot() as session:
        web.identities.require(session, asker)
    with web.services.transaction() as session:
        return work(session, web.identities.require(session, asker))


def json_response(document: msgspec.Struct, *, status: int = 200, headers: dict[str, str] | None = None) -> Response:
    """Answer with a document. Answers differ by asker, so shared caches must not keep them."""
    extra = {"Cache-Control": "private, no-cache", "Vary": "Authorization, Cookie", **(headers or {})}
    return Response(msgspec.json.encode(document), status, extra, media_type="application/json")


def not_modified(request: Request, etag: str) -> Response | None:
    """Answer 304 when the asker already holds this version (RFC 9110, section 13.1.2)."""
    given = request.headers.get("if-none-match")
    return unchanged(etag) if given is not None and names_version(given, etag) else None


def unchanged(etag: str, headers: dict[str, str] | None = None) -> Response:
    """Make an answer 304."""
    own = {"ETag": etag, "Cache-Control": "private, no-cache", "Vary": "Authorization, Cookie"}
    return Response(status_code=304, headers={**own, **(headers or {})})


def answers(*kinds: type[BenchmarkError], **good: Any) -> dict[int | str, dict[str, Any]]:  # noqa: ANN401 - OpenAPI
    """List an endpoint's answers for OpenAPI: problems by their class, others as `s200={...}`."""
    listed: dict[int | str, dict[str, Any]] = {int(name[1:]): value for name, value in good.items()}
    for kind in kinds:
        entry = listed.setdefault(kind.status, _problem_answer())
        example = {
            "type": f"/problems/{kind.code}",
            "title": title_of(kind),
            "status": kind.status,
            "detail": title_of(kind) + ".",
            "code": kind.code,
        }
        content = entry["content"][problems.MEDIA_TYPE]
        content["examples"][kind.code] = {"summary": title_of(kind), "value": example}
        entry["description"] = "; ".join(one["summary"] for one in content["examples"].values()) + "."
    return listed


def document_answer(
    description: str, kind: type[msgspec.Struct], *, example: object = None, headers: dict[str, str] | None = None
) -> dict[str, Any]:
    """Describe a JSON answer for OpenAPI."""
    content: dict[str, Any] = {"schema": {"$ref": f"#/components/schemas/{kind.__name__}"}}
    if example is not None:
        content["example"] = example
    answer: dict[str, Any] = {"description": description, "content": {"application/json": content}}
    if headers:
        answer["headers"] = {
            name: {"description": text, "schema": {"type": "string"}} for name, text in headers.items()
        }
    return answer


def _problem_answer() -> dict[str, Any]:
    schema = {"$ref": "#/components/schemas/ProblemDocument"}
    return {"description": "", "content": {problems.MEDIA_TYPE: {"schema": schema, "examples": {}}}}
