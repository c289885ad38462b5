"""The page of one submission, the list of a user's submissions, and what their owners may do."""

from dataclasses import dataclass

from fastapi import APIRouter
from sqlalchemy.orm import Session
from starlette.responses import Response

from server import accounts, audit, exclusions, integrity, ranking, standings, submissions
from server.api import rendering
from server.api.errors import MalformedRequest
from server.api.identity import Identity
from server.api.submissions import owned, visible
from server.errors import Forbidden
from server.models import AuditEvent, Submission, SubmissionState, User
from server.pages import tables
from server.pages.paging import page_of
from server.pages.rendering import Context
from server.pages.visits import FieldsDependency, VisitDependency

router = APIRouter(include_in_schema=False)

_WAY = (SubmissionState.RECEIVED, SubmissionState.QUEUED, SubmissionState.SCORING, SubmissionState.SCORED)
_EXPLAINED = {
    "received": ("Received", "The archive is safe; its files are being checked."),
    "queued": ("Checked", "No errors; it waits for scoring."),
    "scoring": ("Scoring", "Predictions are matched to the ground truth."),
    "scored": ("Scored", "All metrics are recorded."),
    "rejected": ("Rejected", "The predictions have errors. It cost no quota."),
    "failed": ("Failed", "Our fault. It cost no quota; the maintainers know."),
    "cancelled": ("Cancelled", "Ended by its owner. It cost no quota."),
}


@dataclass(frozen=True, slots=True)
class Step:
    """One station of a submission's life."""

    state: str
    title: str
    detail: str
    kind: str
    """`done`, `now`, `todo` or `bad`."""
    at: object
    """When it was reached; None: not (yet)."""


@router.get("/submissions")
def submission_list(visit: VisitDependency) -> Response:
    """List what the user's teams sent."""

    def work(session: Session, user: User) -> Context:
        teams = accounts.teams_of(session, user)
        pages = {
            team.slug: page_of(session, visit.request.query_params, Submission.team_id == team.id) for team in teams
        }
        shown = [row for page in pages.values() for row in page.rows]
        return {"teams": teams, "pages": pages, "scores": ranking.shown_scores(session, shown)}

    return visit.show_own("submissions.html", work)


@router.get("/submissions/{submission_id}")
def submission_page(submission_id: str, visit: VisitDependency) -> Response:
    """Show one submission: its life, and its report or its scores."""

    def work(session: Session, user: User | None) -> Context:
        identity = Identity(user, None) if user else None
        submission, mine = visible(session, submission_id, identity)
        blobs = visit.web.services.blobs
        shown = ranking.ranking_score(submission) if submission.state is SubmissionState.SCORED else None
        scores = None if shown is None else rendering.scores_of(submission, blobs)
        charts = () if shown is None or scores is None else visit.web.charts.charts(shown.scores_sha256, scores)
        return {
            "submission": submission,
            "owned": mine,
            "document": rendering.submission_document(submission, blobs, owned=mine),
            "steps": life(submission, audit.trail(session, audit.subject_of(submission))),
            "scores": scores,
            "history": rendering.history_of(submission) if scores else [],
            "excluded": exclusions.reason(session, submission),
            "charts": charts,
            "interval": standings.interval_of(session, shown) if shown else None,
            "audit": rendering.integrity_of(submission) if mine else None,
            "bin_metric": tables.View.from_query(visit.request.query_params, ()).bin_metric,
            "tables": tables,
        }

    return visit.show("submission.html", work)


@router.post("/submissions/{submission_id}/publication")
def change_publication(submission_id: str, visit: VisitDependency, fields: FieldsDependency) -> Response:
    """Publish or withdraw, then show the submission."""

    def work(session: Session, identity: Identity) -> str:
        submission = owned(session, submission_id, identity)
        acts = {"published": submissions.publish, "withdrawn": submissions.withdraw}
        act = acts.get(fields.get("publication", ""))
        if act is None:
            raise MalformedRequest("publication is `published` or `withdrawn`")
        act(session, submission, identity.actor)
        return f"/submissions/{submission.id}"

    return visit.act(fields, work)


@router.post("/submissions/{submission_id}/cancel")
def cancel(submission_id: str, visit: VisitDependency, fields: FieldsDependency) -> Response:
    """Cancel, then show the submission."""

    def work(session: Session, identity: Identity) -> str:
        submission = owned(session, submission_id, identity)
        submissions.cancel(session, submission, identity.actor)
        return f"/submissions/{submission.id}"

    return visit.act(fields, work)


@router.post("/submissions/{submission_id}/release")
def release(submission_id: str, visit: VisitDependency, fields: FieldsDependency) -> Response:
    """Let a held submission be published, as a maintainer; then show it."""

    def work(session: Session, identity: Identity) -> str:
        submission = owned(session, submission_id, identity)
        if not identity.user.is_maintainer:
            raise Forbidden("only a maintainer may release a held submission")
        integrity.release(session, submission, identity.actor)
        return f"/submissions/{submission.id}"

    return visit.act(fields, work)


def life(submission: Submission, trail: list[AuditEvent]) -> list[Step]:
    """Lay out the stations of a submission: those behind it, the present one, those that may follow."""
    reached = {
        event.action.removeprefix("submission."): event.at for event in trail if event.action.startswith("submission.")
    }
    state = submission.state
    if state in _WAY:
        return [_step(one, reached.get(one), _kind(_WAY.index(one), _WAY.index(state))) for one in _WAY]
    passed = [_step(one, reached[one], "done") for one in _WAY[:-1] if one in reached]
    return [*passed, _step(state, reached.get(state), "bad")]


def _kind(position: int, present: int) -> str:
    if position < present or present == len(_WAY) - 1:
        return "done"
    return "now" if position == present else "todo"


def _step(state: str, at: object, kind: str) -> Step:
    title, detail = _EXPLAINED[str(state)]
    return Step(str(state), title, detail, kind, at if kind != "todo" else None)
