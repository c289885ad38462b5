"""The yardstick: one Starlette route that answers a small JSON document and asks nothing of anybody."""

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse
from starlette.routing import Route


async def _answer(_: Request) -> JSONResponse:
    return JSONResponse({"state": "scored", "terminal": True})


def application() -> Starlette:
    """Make the application."""
    return Starlette(routes=[Route("/", _answer)])
