"""`uvicorn --factory tests.faults.web_app:application`: the real web process with the fault points around it."""

from fastapi import FastAPI

from tests.faults import hooks

hooks.install(hooks.WEB_POINTS)

from server import web  # noqa: E402 - after the points are in place


def application() -> FastAPI:
    """Make the real application."""
    return web.application()
