"""The methods an address takes: an answer 405 has to list them all (RFC 9110, section 15.5.6).

The router asks route after route and refuses with the methods of the first whose path matches; other routes of the
same address take others.
"""

from collections.abc import Iterable
from http import HTTPMethod, HTTPStatus

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Match, Mount
from starlette.types import Scope


async def answer_wrong_method(request: Request, exception: Exception) -> Response:
    """Answer 405 as the application answers every error, with the complete list of methods."""
    del exception
    allowed = ", ".join(methods_of(request.app.routes, request.scope))
    complete = HTTPException(HTTPStatus.METHOD_NOT_ALLOWED, headers={"Allow": allowed})
    response: Response = await request.app.exception_handlers[HTTPException](request, complete)
    response.headers["Allow"] = allowed  # pages of errors carry no headers of their own
    return response


def methods_of(routes: Iterable[BaseRoute], scope: Scope) -> list[str]:
    """List the methods that the address of a request takes, sorted; HEAD goes wherever GET does (server/api/head.py)."""
    # Routing leaves its traces in the scope; a mount also moves the root.
    root = scope.get("app_root_path", scope.get("root_path", ""))
    asked = {"type": "http", "path": scope["path"], "root_path": root}
    taken = {
        str(method)
        for method in HTTPMethod
        if any(_takes(route, method, {**asked, "method": str(method)}) for route in routes)
    }
    return sorted(taken | {"HEAD"} if "GET" in taken else taken)


def _takes(route: BaseRoute, method: HTTPMethod, scope: Scope) -> bool:
    """Tell whether a route takes a request; a mount says yes to all, but ours hold files, which are only read."""
    if isinstance(route, Mount) and method is not HTTPMethod.GET:
        return False
    return route.matches(scope)[0] is Match.FULL
