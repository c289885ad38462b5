"""/api/v1/uploads: send an archive in parts over a bad connection (after the IETF draft on resumable uploads).

    POST    announce the length and what to do with the archive   -> 201, Location
    HEAD    ask how many bytes are safe                            -> Upload-Offset
    PATCH   send the next part                                     -> 204, or 202 with the submission after the last
    DELETE  give up

A part that breaks off keeps what arrived, unless it announced a digest, which half a part cannot meet. A part takes one
of the places for uploads while it arrives.
"""

import hashlib
import uuid
from collections.abc import AsyncIterator
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Annotated

from fastapi import APIRouter, Header, Path
from sqlalchemy.orm import Session
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response

from server import uploads
from server.api import documents, errors, examples, receiving
from server.api.digests import announced_sha256, check_sha256
from server.api.edge import Asker, Web, WebDependency, answers, change, document_answer, json_response, read
from server.api.errors import (
    ArchiveRefused,
    DigestMismatch,
    MalformedRequest,
    MissingToken,
    OffsetConflict,
    UnsupportedMediaType,
    UploadTimeout,
)
from server.api.identity import Credentials, Identity
from server.api.orders import Order, OrderFields, order_of
from server.api.parts import PartFile, locked
from server.api.receiving import Admission
from server.api.sending import SENDING_PROBLEMS, QueryFields, accepted, refuse_content_coding
from server.api.spool import SpooledFile, at_a_decent_pace, check_floor
from server.errors import NotAuthenticated, NotFound
from server.models import Team, Upload

router = APIRouter(prefix="/uploads", tags=["resumable uploads"])

PART_TYPE = "application/partial-upload"

_BUFFER_BYTES = 1 << 20
_SAFE_EVERY_BYTES = 64 << 20
"""So often a long part is made safe, and its upload kept from expiring."""

UploadId = Annotated[str, Path(description="Id of an upload", examples=[examples.UPLOAD["id"]])]

_ACCESS = (NotAuthenticated, errors.CsrfFailed, errors.TooManyRequests, NotFound)
_HEADERS = {"Upload-Offset": "Bytes that are safe", "Upload-Length": "Bytes in all", "Upload-Complete": "`?1` or `?0`"}


@dataclass(frozen=True, slots=True)
class _Open:
    """An upload as the record has it."""

    id: uuid.UUID
    offset: int
    length: int
    sha256: str | None
    order: Order
    admission: Admission
    submission_id: uuid.UUID | None


@router.post(
    "",
    status_code=201,
    summary="Begin a resumable upload",
    responses=answers(
        *SENDING_PROBLEMS,
        s201=document_answer(
            "Send the parts to Location.",
            documents.UploadDocument,
            example={**examples.UPLOAD, "offset": 0},
            headers={"Location": "The upload", **_HEADERS},
        ),
    ),
)
def begin_upload(
    *,
    request: Request,
    web: WebDependency,
    asker: Asker,
    length: Annotated[int, Header(alias="Upload-Length", ge=1, le=1 << 50)],
    fields: QueryFields,
) -> Response:
    """Announce an archive. `Repr-Digest` of the whole is checked at the end."""
    order = order_of(fields)
    announced = announced_sha256(request.headers)
    web.gate.check_room(length)

    def work(session: Session, identity: Identity) -> Response:
        admission = receiving.admit(session, identity, order)
        upload = uploads.create(
            session,
            user=identity.user,
            team=session.get_one(Team, admission.team_id),
            fields=fields.model_dump(),
            length_bytes=length,
            sha256=announced,
        )
        return _described(upload, status=201)

    return change(web, asker, work)


@router.get(
    "/{upload_id}",
    summary="How far an upload is",
    responses=answers(
        *_ACCESS,
        s200=document_answer("The upload.", documents.UploadDocument, example=examples.UPLOAD, headers=_HEADERS),
    ),
)
@router.head(
    "/{upload_id}",
    summary="The offset of an upload",
    responses={
        200: {
            "description": "The headers say how far the upload is.",
            "headers": {name: {"description": text, "schema": {"type": "string"}} for name, text in _HEADERS.items()},
        },
        **{status: {"description": "As for GET."} for status in (401, 403, 404, 429)},
    },
)
def show_upload(upload_id: UploadId, web: WebDependency, asker: Asker) -> Response:
    """Say how many bytes are safe."""
    return read(web, asker, lambda session, identity: _described(_find(session, upload_id, identity)))


@router.delete(
    "/{upload_id}", status_code=204, summary="Give up an upload", responses=answers(*_ACCESS, errors.UploadBusy)
)
def delete_upload(upload_id: UploadId, web: WebDependency, asker: Asker) -> Response:
    """Delete the upload and its bytes."""

    def work(session: Session, identity: Identity) -> Response:
        upload = _find(session, upload_id, identity)
        with locked(_path(web, upload.id)):
            uploads.delete(session, upload.id)
            _path(web, upload.id).unlink(missing_ok=True)
        return Response(status_code=204)

    return change(web, asker, work)


@router.patch(
    "/{upload_id}",
    status_code=204,
    summary="Send the next part",
    openapi_extra={
        "requestBody": {"required": True, "content": {PART_TYPE: {"schema": {"type": "string", "format": "binary"}}}}
    },
    responses=answers(
        *SENDING_PROBLEMS,
        OffsetConflict,
        errors.UploadBusy,
        UnsupportedMediaType,
        s202=document_answer(
            "The archive is whole and safe, and will be scored. Follow Location.",
            documents.SubmissionDocument,
            example={**examples.SUBMISSION, "state": "received", "progress": None, "attempt": 0},
            headers={"Location": "The submission"},
        ),
        s204={
            "description": "The part is safe.",
            "headers": {name: {"description": text, "schema": {"type": "string"}} for name, text in _HEADERS.items()},
        },
    ),
)
async def append_part(
    request: Request,
    upload_id: UploadId,
    web: WebDependency,
    asker: Asker,
    offset: Annotated[int, Header(alias="Upload-Offset", ge=0, le=1 << 50)],
) -> Response:
    """Append a part; `Content-Digest` of the part is checked. The last part makes the submission."""
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != PART_TYPE:
        raise UnsupportedMediaType(f"Send a part as {PART_TYPE}.")
    refuse_content_coding(request)
    announced = announced_sha256(request.headers)
    known = await run_in_threadpool(_open, web, asker, upload_id)
    if known.submission_id is None:
        async with web.gate.place(known.admission.user_id):
            with locked(_path(web, known.id)) as part:
                # Read again under the lock: another request may have got further meanwhile.
                known = await run_in_threadpool(_open, web, asker, upload_id)
                if known.submission_id is None:
                    start = await run_in_threadpool(part.begin, known.offset)
                    if offset != start:
                        raise OffsetConflict(offset=start)
                    stream = at_a_decent_pace(request.stream(), web.gate.limits)
                    known = await _go_on(web, known, part, stream, announced)
                    if known.submission_id is None:
                        return Response(status_code=204, headers=_headers(part.end, known.length))
    return await run_in_threadpool(accepted, web, asker, str(known.submission_id))


async def _go_on(web: Web, known: _Open, part: PartFile, stream: AsyncIterator[bytes], announced: str | None) -> _Open:
    """Append a part; the last one makes the submission."""
    await _append(web, known, part, stream, announced)
    if part.end < known.length:
        return known
    return replace(known, submission_id=await run_in_threadpool(_complete, web, known, part))


async def _append(web: Web, known: _Open, part: PartFile, stream: AsyncIterator[bytes], announced: str | None) -> None:
    """Write what comes; whatever ends it, what is safe is on the disk and in the record."""
    start, rest, is_kept = part.end, bytearray(), True
    web.gate.check_room(known.length - start)
    try:
        sha256 = await _take(web, known, part, stream, rest, all_or_nothing=announced is not None)
        check_sha256(announced, sha256)
        await run_in_threadpool(_write, web, part, bytes(rest))
    except (ClientDisconnect, UploadTimeout):
        is_kept = announced is None
        if is_kept and rest:
            await run_in_threadpool(_write, web, part, bytes(rest))
        raise
    except BaseException:  # whatever it is: what was not checked is not kept
        is_kept = False
        raise
    finally:
        await run_in_threadpool(_end_part, web, known, part, None if is_kept else start)


async def _take(
    web: Web, known: _Open, part: PartFile, stream: AsyncIterator[bytes], rest: bytearray, *, all_or_nothing: bool
) -> str:
    """Write the body but for its `rest`, which is still in memory, and return the digest of all of it."""
    start = safe = part.end
    digest = hashlib.sha256()
    async for chunk in stream:
        if part.end + len(rest) + len(chunk) > known.length:
            raise MalformedRequest(f"The upload was announced with {known.length} bytes; this part goes beyond.")
        rest += chunk
        digest.update(chunk)
        if len(rest) >= _BUFFER_BYTES:
            await run_in_threadpool(_write, web, part, bytes(rest))
            rest.clear()
        if part.end - safe >= _SAFE_EVERY_BYTES:
            safe = part.end
            await run_in_threadpool(_make_safe, web, known, part, start if all_or_nothing else safe)
    return digest.hexdigest()


def _write(web: Web, part: PartFile, data: bytes) -> None:
    check_floor(uploads.folder_of(web.services.settings.data_dir), web.gate.limits, len(data))
    part.append(data)


def _end_part(web: Web, known: _Open, part: PartFile, drop_from: int | None) -> None:
    """Drop what is not to be kept, and make the rest safe."""
    if drop_from is not None:
        part.cut(drop_from)
    _make_safe(web, known, part, part.end)


def _make_safe(web: Web, known: _Open, part: PartFile, offset: int) -> None:
    """Flush the part and record how many bytes the upload goes on after."""
    part.make_safe()
    with web.services.transaction() as session:
        uploads.advance(session, known.id, offset)


def _complete(web: Web, known: _Open, part: PartFile) -> uuid.UUID:
    path, sha256 = _path(web, known.id), part.sha256()
    try:
        check_sha256(known.sha256, sha256)
        submission_id = receiving.keep(
            web.services, known.admission, known.order, SpooledFile(path, sha256, known.length)
        )
    except (DigestMismatch, ArchiveRefused):
        # Sending the same bytes again would not help: the upload is over.
        with web.services.transaction() as session:
            uploads.delete(session, known.id)
        path.unlink(missing_ok=True)
        raise
    with web.services.transaction() as session:
        uploads.complete(session, known.id, submission_id)
    return submission_id


def _open(web: Web, asker: Credentials, upload_id: str) -> _Open:
    def work(session: Session, identity: Identity | None) -> _Open:
        upload = _find(session, upload_id, identity)
        # One upload is one submission, even when a crash lets its last part be sent again.
        order = order_of(OrderFields.model_validate(upload.fields), f"upload:{upload.id}")
        return _Open(
            id=upload.id,
            offset=upload.offset_bytes,
            length=upload.length_bytes,
            sha256=upload.sha256,
            order=order,
            admission=Admission(upload.user_id, upload.team_id, f"user:{upload.user_id}"),
            submission_id=upload.submission_id,
        )

    return read(web, asker, work)


def _find(session: Session, upload_id: str, identity: Identity | None) -> Upload:
    if identity is None:
        raise MissingToken
    return uploads.find(session, upload_id, user=identity.user)


def _path(web: Web, upload_id: uuid.UUID) -> FilePath:
    return uploads.folder_of(web.services.settings.data_dir) / f"{upload_id}.part"


def _headers(offset: int, length: int) -> dict[str, str]:
    complete = "?1" if offset == length else "?0"
    return {"Upload-Offset": str(offset), "Upload-Length": str(length), "Upload-Complete": complete}


def _described(upload: Upload, *, status: int = 200) -> Response:
    document = documents.UploadDocument(
        id=str(upload.id),
        offset=upload.offset_bytes,
        length=upload.length_bytes,
        expires_at=upload.expires_at,
        complete=upload.submission_id is not None,
        submission_id=str(upload.submission_id) if upload.submission_id else None,
    )
    headers = {**_headers(upload.offset_bytes, upload.length_bytes), "Location": f"/api/v1/uploads/{upload.id}"}
    return json_response(document, status=status, headers={**headers, "Cache-Control": "no-store"})
