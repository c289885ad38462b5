"""`uvicorn --factory tests.faults.web_app:application`: the real web process with the fault points around it."""

from fastapi import FastAPI

from tests.faults import clock

clock.shift()

from tests.faults import hooks  # noqa: E402 - after the clock is shifted
from tests.faults.points import WEB_POINTS  # noqa: E402 - likewise

hooks.install(WEB_POINTS)

from server import web  # noqa: E402 - after the points are in place


def application() -> FastAPI:
    """Make the real application."""
    return web.application()
