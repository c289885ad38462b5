"""/api/v1/health: for load balancers and supervisors, who ask often and log in nowhere."""

import msgspec
import sqlalchemy as sa
from fastapi import APIRouter
from starlette.responses import Response

from server.api import documents
from server.api.edge import WebDependency, answers, document_answer
from server.errors import Unavailable
from server.models import Benchmark

router = APIRouter(tags=["health"])

_CHEAP = sa.select(Benchmark.id).limit(1)
"""Reads a table: SQLite answers what needs none without looking at its file."""


@router.get(
    "/health",
    summary="Whether the server can do its work",
    responses=answers(
        Unavailable, s200=document_answer("The database answers.", documents.HealthDocument, example={"status": "ok"})
    ),
)
def show_health(web: WebDependency) -> Response:
    """Ask the database one cheap question; needs no token, looks at none, and is not limited."""
    with web.services.snapshot() as session:
        session.execute(_CHEAP)
    body = msgspec.json.encode(documents.HealthDocument(status="ok"))
    return Response(body, headers={"Cache-Control": "no-store"}, media_type="application/json")
