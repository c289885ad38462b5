"""Problem documents (RFC 9457): the one way every error leaves the API.

Whatever is raised becomes `application/problem+json` with a stable `code`. What nobody foresaw becomes 500 with a
reference for the log, and says nothing about the inside.
"""

import secrets
import traceback
from http import HTTPStatus
from typing import Any

import msgspec
import structlog
from fastapi.exceptions import RequestValidationError
from sqlalchemy.exc import DataError
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response

from evaluator.errors import BenchmarkError
from evaluator.report import Report
from server.api.errors import InvalidValue, MalformedRequest, MethodNotAllowed, UnknownPath, ValidationFailed
from server.errors import InvalidField, LeaseLost, ServerError

log = structlog.get_logger(__name__)

MEDIA_TYPE = "application/problem+json"


class ProblemDocument(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What went wrong and what helps (RFC 9457)."""

    type: str
    """Address of the page that explains the code."""
    title: str
    """One sentence; the same for every problem of this code."""
    status: int
    detail: str
    """What helps in this case."""
    code: str
    """Stable name of the problem; docs/api.md lists all."""
    instance: str | None = None
    """For unforeseen errors: what the maintainers find in their log."""
    errors: tuple[InvalidValue, ...] = ()
    """Values of the request that cannot be used."""
    report: Report | None = None
    """What is wrong inside an archive."""
    retry_after_s: int | None = None
    offset: int | None = None
    """Where an interrupted upload goes on."""
    max_bytes: int | None = None


class InternalError(ServerError):
    """Something unforeseen happened on the server."""

    code = "internal_error"


def problem_of(error: BenchmarkError) -> ProblemDocument:
    """Describe an error of the project's tree."""
    return ProblemDocument(
        type=f"/problems/{error.code}",
        title=title_of(type(error)),
        status=error.status,
        detail=str(error) or title_of(type(error)),
        code=error.code,
        errors=getattr(error, "errors", ()),
        report=getattr(error, "report", None),
        retry_after_s=getattr(error, "retry_after_s", None),
        offset=getattr(error, "offset", None),
        max_bytes=getattr(error, "max_bytes", None),
    )


def title_of(kind: type[BenchmarkError]) -> str:
    """Take the first sentence of the docstring of the class that introduced the error's code."""
    owner = next(base for base in kind.__mro__ if "code" in vars(base))
    return (owner.__doc__ or "").split("\n", 1)[0].removesuffix(".")


def error_of(exception: Exception) -> BenchmarkError:
    """Find the error of our tree that says what a framework's exception says."""
    if isinstance(exception, BenchmarkError):
        return exception
    if isinstance(exception, RequestValidationError):
        return _validation_error(exception)
    if isinstance(exception, HTTPException):
        return _http_error(exception)
    if isinstance(exception, DataError):
        return InvalidField("a value holds what the database cannot keep, such as a NUL character")
    return InternalError("The maintainers can find the cause by the reference in `instance`.")


def problem_response(problem: ProblemDocument, headers: dict[str, str] | None = None) -> Response:
    """Answer with a problem document."""
    extra = dict(headers or {})
    if problem.retry_after_s is not None:
        extra["Retry-After"] = str(problem.retry_after_s)
    if problem.status == HTTPStatus.UNAUTHORIZED:
        extra["WWW-Authenticate"] = 'Bearer realm="cs3d"'
    if problem.status == HTTPStatus.REQUEST_TIMEOUT:
        extra["Connection"] = "close"
    if problem.offset is not None:
        extra["Upload-Offset"] = str(problem.offset)
    extra.setdefault("Cache-Control", "no-store")
    return Response(msgspec.json.encode(problem), problem.status, extra, media_type=MEDIA_TYPE)


def unforeseen(request: Request, exception: Exception) -> ProblemDocument:
    """Log an unforeseen exception under a reference and describe it without leaking anything."""
    reference = f"urn:cs3d:error:{secrets.token_hex(8)}"
    # Formatted here: some log renderers show local variables, and those hold tokens and passwords.
    trace = "".join(traceback.format_exception(exception))
    log.error("unforeseen_error", reference=reference, path=request.url.path, traceback=trace)
    problem = problem_of(error_of(exception))
    return msgspec.structs.replace(problem, instance=reference)


def all_errors() -> dict[str, type[BenchmarkError]]:
    """List every code the server may answer with and the class that explains it, by code.

    `LeaseLost` and what belongs to it never leave the worker.
    """
    found: dict[str, type[BenchmarkError]] = {}
    waiting: list[type[BenchmarkError]] = [ServerError]
    while waiting:
        kind = waiting.pop(0)
        if "code" in vars(kind):
            found[kind.code] = kind
        waiting.extend(one for one in kind.__subclasses__() if one is not LeaseLost)
    return dict(sorted(found.items()))


def _validation_error(exception: RequestValidationError) -> BenchmarkError:
    errors: list[dict[str, Any]] = list(exception.errors())
    if any(error["type"] == "json_invalid" for error in errors):
        return MalformedRequest("The body is not valid JSON.")
    return ValidationFailed(tuple(InvalidValue("/".join(map(str, error["loc"])), error["msg"]) for error in errors))


def _http_error(exception: HTTPException) -> BenchmarkError:
    if exception.status_code == HTTPStatus.NOT_FOUND:
        return UnknownPath()
    if exception.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
        allowed = (exception.headers or {}).get("Allow", "")
        return MethodNotAllowed(f"Use one of: {allowed}." if allowed else "Use another HTTP method.")
    return MalformedRequest(str(exception.detail))
