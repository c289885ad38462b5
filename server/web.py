"""The web face: one ASGI application with the REST API under /api/v1 and the pages.

    uvicorn --factory server.web:application

Everything is wired here and nowhere else: services, routes, error handling, security headers.
"""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from http import HTTPStatus

import anyio.to_thread
from fastapi import APIRouter, Depends, FastAPI
from fastapi.exceptions import RequestValidationError
from sqlalchemy.exc import DataError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response

from evaluator.errors import BenchmarkError
from server.api import health, integrity, leaderboards, openapi, problems, sending, submissions, uploads
from server.api.edge import Web, attach
from server.api.head import AnswersHead
from server.api.identity import Identities
from server.api.methods import answer_wrong_method
from server.api.parameters import check_parameters
from server.api.polling import AnswersRepeatedPolls, Polls
from server.api.spool import UploadGate, UploadLimits
from server.api.sweeping import swept
from server.api.watch import Watch
from server.charts import ChartStore
from server.pages import routes as pages
from server.pages.error_page import error_page
from server.security import HEADERS, SecurityHeaders
from server.services import Services
from server.settings import Settings

API = "/api/v1"

THREADS = 64
"""Requests that block (database, blob store, argon2) run on so many threads; waiting clients use none."""


def application() -> FastAPI:
    """Make the application of this process from its environment."""
    return create_app(Services.from_settings(Settings()))


def create_app(services: Services, *, limits: UploadLimits | None = None) -> FastAPI:
    """Make an application that works with `services`.

    Args:
        services: Used, and closed at shutdown.
        limits: What uploads may take; by default what the settings say.
    """
    web = _web(services, limits or default_limits(services.settings))
    app = AnswersRepeatedPolls(
        title=openapi.TITLE,
        version="1",
        lifespan=_lifespan,
        openapi_url=None,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
    )
    app.polls, app.polled = web.polls, f"{API}/submissions/"
    attach(app, web)
    app.include_router(_api())
    pages.include(app)
    app.openapi = lambda: openapi.build(app)  # type: ignore[method-assign]  # FastAPI's documented way
    for kind in (BenchmarkError, HTTPException, RequestValidationError, DataError):
        app.add_exception_handler(kind, _on_error)
    app.add_exception_handler(HTTPStatus.METHOD_NOT_ALLOWED, answer_wrong_method)
    app.add_exception_handler(ClientDisconnect, _on_disconnect)
    app.add_exception_handler(Exception, _on_unforeseen)
    app.add_middleware(AnswersHead, own=f"{API}/uploads/")
    app.add_middleware(SecurityHeaders)
    return app


def default_limits(settings: Settings) -> UploadLimits:
    """Take the limits of uploads from the settings."""
    return UploadLimits(max_bytes=settings.upload_max_bytes, disk_floor_bytes=settings.disk_floor_bytes)


def _web(services: Services, limits: UploadLimits) -> Web:
    return Web(
        services=services,
        identities=Identities(services.settings),
        gate=UploadGate(services.blobs.incoming, limits),
        watch=Watch(services),
        polls=Polls(services),
        charts=ChartStore(services.settings.data_dir / "charts"),
    )


def _api() -> APIRouter:
    router = APIRouter(prefix=API, dependencies=[Depends(check_parameters)])
    for part in (sending, submissions, integrity, uploads, leaderboards, health):
        router.include_router(part.router)

    @router.get("/openapi.json", include_in_schema=False)
    def describe(request: Request) -> JSONResponse:
        """Give the OpenAPI document."""
        return JSONResponse(openapi.build(request.app))

    return router


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    anyio.to_thread.current_default_thread_limiter().total_tokens = THREADS
    web: Web = app.state.web
    try:
        async with swept(web.services):
            yield
    finally:
        await web.watch.close()
        web.services.close()


async def _on_error(request: Request, exception: Exception) -> Response:
    problem = problems.problem_of(problems.error_of(exception))
    return _answer(request, problem, dict(getattr(exception, "headers", None) or {}))


async def _on_disconnect(request: Request, exception: Exception) -> Response:
    """End a request whose sender is gone; nobody reads this."""
    del request, exception
    return Response(status_code=400)


async def _on_unforeseen(request: Request, exception: Exception) -> Response:
    response = _answer(request, problems.unforeseen(request, exception), {})
    # This answer is made outside all middleware.
    response.headers.update(HEADERS)
    return response


def _answer(request: Request, problem: problems.ProblemDocument, headers: dict[str, str]) -> Response:
    if request.url.path.startswith("/api/"):
        return problems.problem_response(problem, headers)
    return error_page(request, problem)
