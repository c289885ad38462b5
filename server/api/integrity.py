"""/api/v1/submissions/{id}/integrity: the audit of a score, and a maintainer's decision on one that is held."""

from fastapi import APIRouter
from sqlalchemy.orm import Session
from starlette.responses import Response

from evaluator.integrity import IntegrityAudit
from server import integrity
from server.api import documents, errors, examples, rendering
from server.api.edge import Asker, WebDependency, answers, change, document_answer, json_response, read
from server.api.identity import Identity
from server.api.submissions import SubmissionId, owned, shown_to_owner, visible
from server.errors import Conflict, Forbidden, NotAuthenticated, NotFound, NotScored

router = APIRouter(prefix="/submissions", tags=["submissions"])

_ACCESS = (NotAuthenticated, errors.TooManyRequests, NotFound)


@router.get(
    "/{submission_id}/integrity",
    summary="Integrity audit of a score",
    responses=answers(
        *_ACCESS, Forbidden, NotScored, s200=document_answer("The audit kept with the score.", IntegrityAudit)
    ),
)
def show_integrity(submission_id: SubmissionId, web: WebDependency, asker: Asker) -> Response:
    """Give the audit to the submission's team and the maintainers."""

    def work(session: Session, identity: Identity | None) -> Response:
        submission, mine = visible(session, submission_id, identity)
        if not mine:
            raise Forbidden("only its team may see the audit of this submission")
        audit = rendering.integrity_of(submission)
        if audit is None:
            raise NotScored(f"submission {submission.id} is {submission.state.value}; it has no audit")
        return json_response(audit)

    return read(web, asker, work)


@router.post(
    "/{submission_id}/release",
    summary="Let a held submission be published (maintainers)",
    responses=answers(
        *_ACCESS,
        Forbidden,
        errors.CsrfFailed,
        Conflict,
        s200=document_answer("The submission as it is now.", documents.SubmissionDocument, example=examples.SUBMISSION),
    ),
)
def release_submission(submission_id: SubmissionId, web: WebDependency, asker: Asker) -> Response:
    """Decide that the score may rank."""

    def work(session: Session, identity: Identity) -> None:
        submission = owned(session, submission_id, identity)
        if not identity.user.is_maintainer:
            raise Forbidden("only a maintainer may release a held submission")
        integrity.release(session, submission, identity.actor)

    change(web, asker, work)
    return shown_to_owner(web, asker, submission_id)
