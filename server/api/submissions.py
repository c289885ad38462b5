"""/api/v1/submissions: send, look, wait, publish, cancel."""

import uuid
from collections.abc import AsyncIterator
from typing import Annotated, Literal

import msgspec
from fastapi import APIRouter, Path, Query
from pydantic import BaseModel, ConfigDict
from sqlalchemy.orm import Session
from sse_starlette import EventSourceResponse, ServerSentEvent
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response

from server import submissions
from server.api import documents, errors, examples, rendering
from server.api.edge import (
    POLL_S,
    Asker,
    Web,
    WebDependency,
    answers,
    change,
    document_answer,
    json_response,
    not_modified,
    read,
    unchanged,
)
from server.api.identity import Credentials, Identity
from server.api.polling import Answer, Basis, bases_of, key_of, names_version
from server.api.watch import Mark, mark_of
from server.errors import Forbidden, IllegalTransition, NotAuthenticated, NotFound, NotScored
from server.models import Submission

router = APIRouter(prefix="/submissions", tags=["submissions"])

MAX_WAIT_S = 60

SubmissionId = Annotated[str, Path(description="Id of a submission", examples=[examples.SUBMISSION_ID])]

_ACCESS = (NotAuthenticated, errors.TooManyRequests, NotFound)


class PublicationChange(BaseModel):
    """What to do with a scored submission."""

    model_config = ConfigDict(extra="forbid")

    publication: Literal["published", "withdrawn"]


class _View(msgspec.Struct, frozen=True):
    """A submission as one asker sees it at one moment."""

    document: documents.SubmissionDocument
    mark: Mark
    etag: str
    basis: Basis


def visible(session: Session, submission_id: str, identity: Identity | None) -> tuple[Submission, bool]:
    """Find a submission the asker may see.

    Returns:
        The submission, and whether the asker acts for it.

    Raises:
        NotFound: There is none, or the asker may not know of it: the two look the same.
    """
    user = identity.user if identity else None
    submission = submissions.find(session, submission_id)
    owned = submissions.owned_by(submission, user)
    # A token acts for one team: it opens nothing that belongs to its user's other teams.
    if identity and identity.team and not identity.user.is_maintainer:
        owned = owned and identity.team.id == submission.team_id
    if not owned and not submissions.visible_to(submission, None):
        raise NotFound(f"there is no submission {submission_id[:64]!r}")
    return submission, owned


def owned(session: Session, submission_id: str, identity: Identity) -> Submission:
    """Find a submission the asker may act for.

    Raises:
        NotFound: The asker may not know of it.
        Forbidden: It is published, but not the asker's.
    """
    submission, mine = visible(session, submission_id, identity)
    if not mine:
        raise Forbidden("only its team may change this submission")
    return submission


@router.get(
    "/{submission_id}",
    summary="State, progress and report of a submission",
    responses=answers(
        *_ACCESS,
        s200=document_answer(
            "The submission as it is now.",
            documents.SubmissionDocument,
            example=examples.SUBMISSION,
            headers={"ETag": "Version", "Retry-After": "Seconds until asking again makes sense; not when terminal"},
        ),
        s304={"description": "Nothing changed since the version in If-None-Match."},
    ),
)
async def show_submission(
    request: Request,
    submission_id: SubmissionId,
    web: WebDependency,
    asker: Asker,
    *,
    wait: Annotated[float, Query(ge=0, le=MAX_WAIT_S, description="Wait so many seconds for a change")] = 0,
) -> Response:
    """Show a submission. With `wait` and If-None-Match, answer as soon as it differs from that version."""
    view = await run_in_threadpool(_view, web, asker, submission_id)
    known = request.headers.get("if-none-match")
    # Without a version to compare to, waiting is for the next change of something that still changes.
    waits = wait > 0 and not view.document.terminal and (known is None or names_version(known, view.etag))
    if waits and await web.watch.wait(uuid.UUID(view.document.id), view.mark, wait):
        view = await run_in_threadpool(_view, web, asker, submission_id)
    answer = _answer(view)
    if asker.token is not None:
        web.polls.keep(key_of(asker.token, view.document.id), answer)
    return answer.unchanged if known is not None and names_version(known, view.etag) else answer.full


@router.get(
    "/{submission_id}/events",
    summary="Follow a submission as server-sent events",
    response_class=EventSourceResponse,
    responses=answers(
        *_ACCESS,
        s200={
            "description": "One `submission` event for every change; its data is the submission's document. "
            "The stream ends with the terminal state.",
            "content": {"text/event-stream": {"schema": {"type": "string"}}},
        },
    ),
)
async def follow_submission(submission_id: SubmissionId, web: WebDependency, asker: Asker) -> EventSourceResponse:
    """Send the submission now and at every change until it is done."""
    first = await run_in_threadpool(_view, web, asker, submission_id)
    return EventSourceResponse(_events(web, asker, first), ping=15, headers={"Cache-Control": "no-store"})


@router.get(
    "/{submission_id}/results",
    summary="All scores of a submission",
    responses=answers(
        *_ACCESS,
        NotScored,
        errors.ValidationFailed,
        s200=document_answer(
            "Every number in full precision; undefined is null.",
            documents.ResultsDocument,
            headers={"ETag": "Version"},
        ),
        s304={"description": "Nothing changed since the version in If-None-Match."},
    ),
)
def show_results(
    request: Request,
    submission_id: SubmissionId,
    web: WebDependency,
    asker: Asker,
    *,
    score: Annotated[int | None, Query(ge=1, lt=1 << 31, description="Another score in its history")] = None,
) -> Response:
    """Give the scores with their signature: those that rank, or others of its history."""

    def work(session: Session, identity: Identity | None) -> Response:
        submission, _ = visible(session, submission_id, identity)
        scores = rendering.scores_of(submission, web.services.blobs, score)
        history = rendering.history_of(submission)
        versions = "".join(f"-{one.id}{'r' if one.ranks else ''}" for one in history)
        etag = f'"{scores.signature}{versions}"'
        document = rendering.results_document(scores, history)
        return not_modified(request, etag) or json_response(document, headers={"ETag": etag})

    return read(web, asker, work)


@router.post(
    "/{submission_id}/publication",
    summary="Publish or withdraw a scored submission",
    responses=answers(
        *_ACCESS,
        Forbidden,
        errors.CsrfFailed,
        NotScored,
        errors.MalformedRequest,
        errors.ValidationFailed,
        s200=document_answer("The submission as it is now.", documents.SubmissionDocument, example=examples.SUBMISSION),
    ),
)
def change_publication(
    submission_id: SubmissionId, body: PublicationChange, web: WebDependency, asker: Asker
) -> Response:
    """Make the submission its method's row on the leaderboard, or take it off."""

    def work(session: Session, identity: Identity) -> None:
        submission = owned(session, submission_id, identity)
        act = submissions.publish if body.publication == "published" else submissions.withdraw
        act(session, submission, identity.actor)

    change(web, asker, work)
    return shown_to_owner(web, asker, submission_id)


@router.post(
    "/{submission_id}/cancel",
    summary="Cancel a submission that is not being scored yet",
    responses=answers(
        *_ACCESS,
        Forbidden,
        errors.CsrfFailed,
        IllegalTransition,
        s200=document_answer("The submission as it is now.", documents.SubmissionDocument, example=examples.SUBMISSION),
    ),
)
def cancel_submission(submission_id: SubmissionId, web: WebDependency, asker: Asker) -> Response:
    """End the submission; its quota is given back."""

    def work(session: Session, identity: Identity) -> None:
        submissions.cancel(session, owned(session, submission_id, identity), identity.actor)

    change(web, asker, work)
    return shown_to_owner(web, asker, submission_id)


def shown_to_owner(web: Web, asker: Credentials, submission_id: str) -> Response:
    """Answer with a submission after a change: its report is read once the record's locks are free."""

    def work(session: Session, identity: Identity | None) -> Response:
        submission, mine = visible(session, submission_id, identity)
        return json_response(rendering.submission_document(submission, web.services.blobs, owned=mine))

    return read(web, asker, work)


def _view(web: Web, asker: Credentials, submission_id: str) -> _View:
    def work(session: Session, identity: Identity | None) -> _View:
        submission, mine = visible(session, submission_id, identity)
        document = rendering.submission_document(submission, web.services.blobs, owned=mine)
        key = key_of(asker.token or "", document.id)
        basis = bases_of(session, [key]).get(key, ())
        return _View(document, mark_of(submission), f'"{submission.version}{"o" if mine else "p"}"', basis)

    return read(web, asker, work)


def _answer(view: _View) -> Answer:
    """Render a view in both ways."""
    retry = {} if view.document.terminal else {"Retry-After": str(POLL_S)}
    full = json_response(view.document, headers={"ETag": view.etag, **retry})
    return Answer(basis=view.basis, etag=view.etag, full=full, unchanged=unchanged(view.etag, retry))


async def _events(web: Web, asker: Credentials, view: _View) -> AsyncIterator[ServerSentEvent]:
    shown = None
    while True:
        if view.etag != shown:
            data = msgspec.json.encode(view.document).decode()
            yield ServerSentEvent(data, event="submission", id=view.etag.strip('"'))
            shown = view.etag
        if view.document.terminal:
            return
        await web.watch.wait(uuid.UUID(view.document.id), view.mark, MAX_WAIT_S)
        try:
            view = await run_in_threadpool(_view, web, asker, view.document.id)
        except (NotFound, NotAuthenticated):
            return  # the token was revoked, or the submission withdrawn, while we waited
