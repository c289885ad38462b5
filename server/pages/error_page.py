"""Problems as pages: the same document the API gives, for people."""

from starlette.requests import Request
from starlette.responses import Response

from server.api.problems import ProblemDocument
from server.pages.rendering import html


def error_page(request: Request, problem: ProblemDocument) -> Response:
    """Show a problem. Asks nothing of the database, so it works when that is what failed."""
    response = html(request, "problem.html", user=None, login=None, status=problem.status, problem=problem)
    if problem.retry_after_s is not None:
        response.headers["Retry-After"] = str(problem.retry_after_s)
    return response
