"""The form to send a submission: the API's own path with a progress bar, or a plain form without JavaScript."""

from collections.abc import AsyncIterator

from fastapi import APIRouter
from sqlalchemy import select
from sqlalchemy.orm import Session
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response

from server import accounts, benchmarks, database, quota, submissions
from server.api import receiving
from server.api.errors import InvalidValue, MissingToken, ValidationFailed
from server.api.identity import Identity
from server.api.multipart import Form, FormReader, boundary_of
from server.api.orders import Order, OrderFields, order_of
from server.api.problems import ProblemDocument, problem_of
from server.api.receiving import Admission
from server.api.sending import announced_archive
from server.api.spool import Spool, at_a_decent_pace
from server.errors import QuotaExceeded, ServerError, TooManyRejections
from server.models import Method, Phase, Team, User
from server.pages.rendering import Context, html
from server.pages.visits import Fields, Visit, VisitDependency, see_other

router = APIRouter(include_in_schema=False)

ADDRESS = "/benchmarks/{benchmark}/{phase}/submit"


@router.get(ADDRESS)
def upload_form(benchmark: str, phase: str, visit: VisitDependency) -> Response:
    """Show the form."""

    def work(session: Session, user: User) -> Context:
        return form_context(session, user, benchmark=benchmark, phase=phase, origin=_origin(visit))

    return visit.show_own("submit.html", work)


@router.post(ADDRESS)
async def upload(request: Request, benchmark: str, phase: str, visit: VisitDependency) -> Response:
    """Take the plain form, then show the submission; problems are shown above the form."""
    boundary = boundary_of(request.headers.get("content-type", ""))
    fields: Fields = {"benchmark": benchmark, "phase": phase}
    try:
        submission_id = await _receive(request, visit, boundary, fields)
    except ServerError as error:
        return await run_in_threadpool(_form_again, visit, fields, problem_of(error))
    return see_other(f"/submissions/{submission_id}")


def form_context(session: Session, user: User, *, benchmark: str, phase: str, origin: str) -> Context:
    """Gather what the form shows."""
    teams = accounts.teams_of(session, user)
    found = benchmarks.find_phase(session, benchmark, phase)
    slugs = session.scalars(select(Method.slug).where(Method.team_id.in_([team.id for team in teams])).distinct())
    at = database.now(session)
    return {
        "phase": found,
        "closed": submissions.why_closed(found, at),
        "spent": [spent for team in teams if (spent := _spent(session, team, found))],
        "slug_pattern": accounts.SLUG.pattern,
        "teams": teams,
        "methods": sorted(slugs),
        "left": {team.slug: quota.remaining(session, team_id=team.id, phase=found, at=at) for team in teams},
        "origin": origin,
        "problem": None,
        "fields": {},
    }


def _spent(session: Session, team: Team, phase: Phase) -> str | None:
    """Say when a team that may not send now may again."""
    try:
        quota.check(session, team=team, phase=phase)
    except (QuotaExceeded, TooManyRejections) as error:
        return str(error)
    return None


async def _receive(request: Request, visit: Visit, boundary: bytes, fields: Fields) -> str:
    web = visit.web
    user_id = await run_in_threadpool(_require_user, visit)  # before the body: nobody else may hold a place
    async with web.gate.spool(user_id, announced_archive(request)) as spool:
        stream = at_a_decent_pace(request.stream(), web.gate.limits)
        form = await _read_checked(stream, boundary, spool, visit)
        fields.update({**form.fields, "benchmark": fields["benchmark"], "phase": fields["phase"]})
        if not form.file_name:
            raise ValidationFailed((InvalidValue("predictions", "choose the zip of your predictions"),))
        spooled = await spool.finish()
        order = order_of(OrderFields.of_form(fields), file_name=form.file_name)
        admission = await run_in_threadpool(_admit, visit, order)
        return str(await run_in_threadpool(receiving.keep, web.services, admission, order, spooled))


async def _read_checked(stream: AsyncIterator[bytes], boundary: bytes, spool: Spool, visit: Visit) -> Form:
    """Read the form; the CSRF token stands before the file, and without it nothing more is read."""
    reader = FormReader(boundary, spool, file_field="predictions", known=[*OrderFields.model_fields, "csrf"])
    checked = False
    async for chunk in stream:
        fields = await reader.feed(chunk)
        if not checked and (reader.form.file_name is not None or "csrf" in fields):
            visit.check_form(dict(fields))
            checked = True
    form = reader.finish()
    if not checked:
        visit.check_form(form.fields)
    return form


def _origin(visit: Visit) -> str:
    return visit.web.services.settings.public_url.rstrip("/")


def _require_user(visit: Visit) -> int:
    with visit.web.services.snapshot() as session:
        return _user_of(session, visit).id


def _user_of(session: Session, visit: Visit) -> User:
    user = visit.web.identities.user_of(session, visit.login)
    if user is None:
        raise MissingToken("Your session ended; log in again.")
    return user


def _admit(visit: Visit, order: Order) -> Admission:
    with visit.web.services.snapshot() as session:
        return receiving.admit(session, Identity(_user_of(session, visit), None), order)


def _form_again(visit: Visit, fields: Fields, problem: ProblemDocument) -> Response:
    with visit.web.services.snapshot() as session:
        user = visit.web.identities.user_of(session, visit.login)
        if user is None:
            return see_other("/login")
        context = form_context(
            session, user, benchmark=fields["benchmark"], phase=fields["phase"], origin=_origin(visit)
        )
        context |= {"problem": problem, "fields": fields}
        return html(visit.request, "submit.html", user=user, login=visit.login, status=problem.status, **context)
