"""Pages for everybody: home, leaderboards, methods, comparison, the list of problems."""

from fastapi import APIRouter
from sqlalchemy import select
from sqlalchemy.orm import Session
from starlette.responses import RedirectResponse, Response

from evaluator.protocol import PROTOCOLS
from server import benchmarks, database, ranking, submissions
from server.api.problems import all_errors
from server.errors import NotFound
from server.models import Method, Publication, Submission, Team, User
from server.pages import tables
from server.pages.paging import Page, page_of
from server.pages.rendering import Context
from server.pages.visits import Visit, VisitDependency

router = APIRouter(include_in_schema=False)

SHOWN_AT_HOME = 3
"""Rows of each phase's podium."""


@router.get("/")
def home(visit: VisitDependency) -> Response:
    """Show what there is and who leads."""

    def work(session: Session, user: User | None) -> Context:
        del user
        listed = benchmarks.list_benchmarks(session)
        phases = [phase for benchmark in listed for phase in benchmark.phases]
        leaders = {phase.id: ranking.leaders(session, phase, SHOWN_AT_HOME) for phase in phases}
        at = database.now(session)
        closed = {phase.id: why for phase in phases if (why := submissions.why_closed(phase, at))}
        return {"benchmarks": listed, "leaders": leaders, "closed": closed}

    return visit.show("home.html", work)


@router.get("/benchmarks/{benchmark}")
def benchmark_home(benchmark: str, visit: VisitDependency) -> Response:
    """Go to the benchmark on the home page."""
    with visit.web.services.snapshot() as session:
        slug = benchmarks.find_benchmark(session, benchmark).slug
    return RedirectResponse(f"/#{slug}", 303)


@router.get("/benchmarks/{benchmark}/{phase}")
def leaderboard(benchmark: str, phase: str, visit: VisitDependency) -> Response:
    """Show the ranking of a phase."""

    def work(session: Session, user: User | None) -> Context:
        del user
        board = ranking.leaderboard(session, benchmarks.find_phase(session, benchmark, phase))
        labels = tables.labels_of(board.rows)
        view = tables.View.from_query(visit.request.query_params, labels)
        return {
            "phase": board.phase,
            "closed": submissions.why_closed(board.phase, database.now(session)),
            "rows": tables.sorted_rows(board.rows, view),
            "labels": labels,
            "view": view,
            "best": tables.best_values(board.rows, labels, view.metric),
            "protocol": PROTOCOLS.get(board.phase.protocol),
            "standings": visit.web.standings.of(session, board.rows),
            "tables": tables,
        }

    return visit.show("leaderboard.html", work)


@router.get("/benchmarks/{benchmark}/{phase}/compare")
def compare(benchmark: str, phase: str, visit: VisitDependency) -> Response:
    """Show two published methods side by side; by default the first two."""

    def work(session: Session, user: User | None) -> Context:
        del user
        board = ranking.leaderboard(session, benchmarks.find_phase(session, benchmark, phase))
        query, rows = visit.request.query_params, board.rows
        named = {str(row.submission.id): row for row in rows}
        labels = tables.labels_of(rows)
        for key in {"a", "b"} & query.keys():
            if query[key] not in named:
                raise NotFound(f"phase {phase[:64]} ranks no submission {query[key][:64]!r}; it may be withdrawn")
        left = named.get(query.get("a", ""), rows[0] if rows else None)
        right = named.get(query.get("b", ""), rows[min(1, len(rows) - 1)] if rows else None)
        return {
            "phase": board.phase,
            "rows": rows,
            "labels": labels,
            "left": left,
            "right": right,
            "significance": tables.significance(session, left, right, labels) if left and right else {},
            "metric": tables.View.from_query(query, labels).metric,
            "tables": tables,
        }

    return visit.show("compare.html", work)


@router.get("/methods/{team}/{method}")
def method_page(team: str, method: str, visit: VisitDependency) -> Response:
    """Show a method and those of its submissions that the visitor may see."""

    def work(session: Session, user: User | None) -> Context:
        found = session.scalar(select(Method).join(Team).where(Team.slug == team, Method.slug == method))
        page = _page_of_method(session, visit, found, user) if found else None
        # A method nobody may see a submission of is as unknown as one that does not exist.
        if page is None or not page.rows:
            raise NotFound(f"there is no method {method[:64]!r} of team {team[:64]!r}, or it has no such page")
        scores = ranking.shown_scores(session, page.rows, summaries=True)
        return {"method": found, "page": page, "scores": scores, "tables": tables}

    return visit.show("method.html", work)


@router.get("/problems")
@router.get("/problems/{code}")
def problem_list(visit: VisitDependency, code: str = "") -> Response:
    """Explain every code of a problem document."""
    known = all_errors()
    if code and code not in known:
        raise NotFound(f"there is no problem code {code[:64]!r}")
    return visit.show("problems.html", lambda *_: {"problems": known, "chosen": code})


def _page_of_method(session: Session, visit: Visit, method: Method, user: User | None) -> Page:
    """Read a page of those submissions of a method that the visitor may see (`submissions.visible_to`)."""
    conditions = [Submission.method_id == method.id]
    if not submissions.acts_for(session, method.team_id, user):
        conditions.append(Submission.publication == Publication.PUBLISHED)
    return page_of(session, visit.request.query_params, *conditions)
