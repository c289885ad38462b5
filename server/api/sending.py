"""POST /api/v1/submissions: one archive, as the raw body or as a form; and the list of what was sent."""

import re
from typing import Annotated, Any

import sqlalchemy as sa
from fastapi import APIRouter, Query
from sqlalchemy.orm import Session
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response

from server import accounts, benchmarks, submissions
from server.accounts import MAX_URL_CHARACTERS
from server.api import documents, errors, examples, receiving, rendering
from server.api.digests import announced_sha256, check_sha256
from server.api.edge import (
    POLL_S,
    Asker,
    Web,
    WebDependency,
    answers,
    document_answer,
    json_response,
    read,
)
from server.api.errors import InvalidValue, MalformedRequest, MissingToken, UnsupportedMediaType, ValidationFailed
from server.api.identity import Credentials, Identity
from server.api.multipart import FormReader, boundary_of
from server.api.orders import MAX_DESCRIPTION_CHARACTERS, MAX_TEXT_CHARACTERS, REQUIRED, Order, OrderFields, order_of
from server.api.receiving import Admission
from server.api.spool import FORM_OVERHEAD_BYTES, at_a_decent_pace
from server.errors import (
    Conflict,
    Forbidden,
    IdempotencyMismatch,
    InvalidField,
    NotAuthenticated,
    NotFound,
    PhaseClosed,
    QuotaExceeded,
    TooManyRejections,
    Unavailable,
)
from server.models import Submission, SubmissionState

router = APIRouter(prefix="/submissions", tags=["submissions"])

ARCHIVE_TYPES = {"application/zip", "application/x-zip-compressed", "application/octet-stream"}
"""Media types of a raw body; the last is what some clients call every file."""

_TEXT = {"type": "string", "minLength": 1, "maxLength": MAX_TEXT_CHARACTERS}

_BODY: dict[str, Any] = {
    "required": True,
    "description": "The zip of prediction files; either raw, with the fields as query parameters, or a form.",
    "content": {
        "application/zip": {"schema": {"type": "string", "format": "binary"}},
        "multipart/form-data": {
            "schema": {
                "type": "object",
                "required": [*REQUIRED, "predictions"],
                "additionalProperties": False,
                "properties": {
                    "benchmark": _TEXT,
                    "phase": _TEXT,
                    "method": {**_TEXT, "description": "Slug; a new one makes a new method of your team"},
                    "method_name": {"type": "string", "maxLength": MAX_TEXT_CHARACTERS},
                    "description": {"type": "string", "maxLength": MAX_DESCRIPTION_CHARACTERS},
                    "paper_url": {"type": "string", "maxLength": MAX_URL_CHARACTERS},
                    "code_url": {"type": "string", "maxLength": MAX_URL_CHARACTERS},
                    "file_name": {"type": "string", "maxLength": MAX_TEXT_CHARACTERS},
                    "team": {"type": "string", "maxLength": MAX_TEXT_CHARACTERS},
                    "predictions": {"type": "string", "format": "binary"},
                },
            }
        },
    },
}

_HEADERS = [
    {
        "name": "Idempotency-Key",
        "in": "header",
        "schema": {"type": "string", "minLength": 1, "maxLength": receiving.MAX_KEY_CHARACTERS},
        "description": "The same key again gives the same submission, so a lost answer can be asked for again.",
    },
    {
        "name": "Content-Digest",
        "in": "header",
        "schema": {"type": "string"},
        "description": "`sha-256=:<base64>:` of the body (RFC 9530); Repr-Digest is taken too.",
    },
]

SENDING_PROBLEMS = (
    NotAuthenticated,
    errors.CsrfFailed,
    Forbidden,
    NotFound,
    Conflict,
    PhaseClosed,
    errors.UploadTooLarge,
    InvalidField,
    ValidationFailed,
    errors.ArchiveRefused,
    errors.DigestMismatch,
    IdempotencyMismatch,
    QuotaExceeded,
    TooManyRejections,
    errors.TooManyRequests,
    Unavailable,
    errors.TooManyUploads,
    errors.TooManyOwnUploads,
    errors.DiskFull,
    MalformedRequest,
    errors.UploadTimeout,
    errors.LengthRequired,
)
"""What may stop an upload on its way to a submission."""

QueryFields = Annotated[OrderFields, Query()]
QueryText = Annotated[str | None, Query(max_length=MAX_TEXT_CHARACTERS)]


@router.post(
    "",
    status_code=202,
    summary="Send a submission",
    openapi_extra={"requestBody": _BODY, "parameters": _HEADERS},
    responses=answers(
        *SENDING_PROBLEMS,
        UnsupportedMediaType,
        s202=document_answer(
            "The bytes are safe and will be scored. Follow Location.",
            documents.SubmissionDocument,
            example={**examples.SUBMISSION, "state": "received", "progress": None, "attempt": 0},
            headers={
                "Location": "The submission",
                "Retry-After": "Seconds until asking makes sense",
                "ETag": "Version",
            },
        ),
    ),
)
async def send_submission(
    *,
    request: Request,
    web: WebDependency,
    asker: Asker,
    fields: QueryFields,
) -> Response:
    """Take an archive and answer as soon as it is safe; scoring follows."""
    key = idempotency_key(request)
    require_body(request)
    refuse_content_coding(request)
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind in ARCHIVE_TYPES:
        submission_id = await receive_raw(request, web, asker, order_of(fields, key))
    else:
        submission_id = await receive_form(request, web, asker, fields, key)
    return await run_in_threadpool(accepted, web, asker, submission_id)


def idempotency_key(request: Request) -> str | None:
    """Read the one Idempotency-Key.

    Raises:
        MalformedRequest: There are several, and no way to tell which is meant.
    """
    keys = request.headers.getlist("idempotency-key")
    if len(keys) > 1:
        raise MalformedRequest("Send one Idempotency-Key, not several.")
    return keys[0] if keys else None


def require_body(request: Request) -> None:
    """Refuse a request that has no body, so that it is not taken for an empty archive (RFC 9112, section 6.3).

    Raises:
        LengthRequired: It announces none.
    """
    if not {"content-length", "transfer-encoding"} & set(request.headers):
        raise errors.LengthRequired


def refuse_content_coding(request: Request) -> None:
    """Refuse a body that was compressed on top: nothing here undoes that (RFC 9110, section 8.4).

    Raises:
        UnsupportedMediaType: A Content-Encoding other than `identity` is announced.
    """
    coding = request.headers.get("content-encoding", "identity").strip().lower()
    if coding not in {"", "identity"}:
        raise UnsupportedMediaType("Send the archive as it is, without Content-Encoding; a zip is compressed already.")


async def receive_raw(request: Request, web: Web, asker: Credentials, order: Order) -> str:
    """Take an archive that is the body."""
    announced = announced_sha256(request.headers)
    admission = await run_in_threadpool(admit, web, asker, order)
    async with web.gate.spool(admission.user_id, announced_size(request)) as spool:
        async for chunk in at_a_decent_pace(request.stream(), web.gate.limits):
            await spool.write(chunk)
        spooled = await spool.finish()
        check_sha256(announced, spooled.sha256)
        return str(await run_in_threadpool(receiving.keep, web.services, admission, order, spooled))


async def receive_form(request: Request, web: Web, asker: Credentials, fields: OrderFields, key: str | None) -> str:
    """Take an archive that is the part `predictions` of a form, whose fields go before those of the query."""
    boundary = boundary_of(request.headers.get("content-type", ""))
    user_id = await run_in_threadpool(_require, web, asker)
    # The digest of a form covers its framing too; it is not the archive's.
    if announced_sha256(request.headers) is not None:
        raise MalformedRequest("Send the archive as the raw body to have its digest checked.")
    async with web.gate.spool(user_id, announced_archive(request)) as spool:
        reader = FormReader(boundary, spool, file_field="predictions", known=[*OrderFields.model_fields])
        form = await reader.read(at_a_decent_pace(request.stream(), web.gate.limits))
        given = OrderFields.of_form(fields.model_dump(exclude_unset=True) | form.fields)
        order = order_of(given, key, file_name=form.file_name)
        if form.file_name is None:
            raise ValidationFailed((InvalidValue("body/predictions", "the archive is missing"),))
        spooled = await spool.finish()
        admission = await run_in_threadpool(admit, web, asker, order)
        return str(await run_in_threadpool(receiving.keep, web.services, admission, order, spooled))


def announced_size(request: Request) -> int | None:
    """Read Content-Length; None when the body comes in chunks."""
    value = request.headers.get("content-length")
    return int(value) if value is not None and re.fullmatch(r"[0-9]{1,18}", value) else None


def announced_archive(request: Request) -> int | None:
    """Read from Content-Length how large the archive in a form is at least."""
    size = announced_size(request)
    return None if size is None else max(0, size - FORM_OVERHEAD_BYTES)


def admit(web: Web, asker: Credentials, order: Order) -> Admission:
    """Ask whether the upload may begin; blocks."""
    with web.services.snapshot() as session:
        return receiving.admit(session, web.identities.require(session, asker), order)


def _require(web: Web, asker: Credentials) -> int:
    with web.services.snapshot() as session:
        return web.identities.require(session, asker).user.id


def accepted(web: Web, asker: Credentials, submission_id: str) -> Response:
    """Answer 202 with a submission that was just made, or made before by the same request."""

    def work(session: Session, identity: Identity | None) -> Response:
        del identity
        submission = submissions.find(session, submission_id)
        document = rendering.submission_document(submission, web.services.blobs, owned=True)
        headers = {
            "Location": document.links.self,
            "Retry-After": str(POLL_S),
            "ETag": f'"{submission.version}o"',
        }
        return json_response(document, status=202, headers=headers)

    return read(web, asker, work)


@router.get(
    "",
    summary="The submissions of your team",
    responses=answers(
        NotAuthenticated,
        errors.TooManyRequests,
        NotFound,
        Forbidden,
        InvalidField,
        ValidationFailed,
        s200=document_answer("Latest first.", documents.SubmissionList),
    ),
)
def list_submissions(
    *,
    web: WebDependency,
    asker: Asker,
    benchmark: Annotated[QueryText, Query(description="Slug; only with `phase`")] = None,
    phase: Annotated[QueryText, Query(description="Slug; only those sent to this phase of `benchmark`")] = None,
    method: Annotated[QueryText, Query(description="Slug; only those of this method")] = None,
    state: Annotated[SubmissionState | None, Query(description="Only those in this state now")] = None,
    limit: Annotated[int, Query(ge=1, le=500, description="So many at most")] = 100,
    offset: Annotated[int, Query(ge=0, le=1_000_000, description="Leave out so many of the latest")] = 0,
) -> Response:
    """List what the token's team, or all of the user's teams together, sent; filters hold together."""

    def work(session: Session, identity: Identity | None) -> Response:
        if identity is None:
            raise MissingToken
        teams = [identity.team] if identity.team else accounts.teams_of(session, identity.user)
        conditions = [Submission.team_id.in_([team.id for team in teams]), *_in_phase(session, benchmark, phase)]
        if method is not None:
            conditions.append(Submission.method.has(slug=accounts.checked_slug("method", method)))
        if state is not None:
            conditions.append(Submission.state == state)
        rows = submissions.latest(session, *conditions, limit=limit, offset=offset)
        return json_response(rendering.submission_list(session, rows))

    return read(web, asker, work)


def _in_phase(session: Session, benchmark: str | None, phase: str | None) -> list[sa.ColumnElement[bool]]:
    if not (phase or benchmark):
        return []
    if not (phase and benchmark):
        raise ValidationFailed((InvalidValue("query", "give benchmark and phase together"),))
    return [Submission.phase_id == benchmarks.find_phase(session, benchmark, phase).id]
