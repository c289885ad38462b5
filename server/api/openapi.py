"""The OpenAPI document: FastAPI's, with our typed documents as schemas and nothing it did not promise."""

from typing import Any

import msgspec
from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from server.api.documents import EXPOSED
from server.api.problems import MEDIA_TYPE, ProblemDocument

TITLE = "Cityscapes 3D benchmark"

DESCRIPTION = """Send predictions, follow their scoring, read leaderboards.

Everything that changes something needs `Authorization: Bearer <token>`; tokens are made on your account page.
Errors are problem documents (RFC 9457) with a stable `code`. Numbers are in full precision, undefined is `null`.
"""

_PROBLEM = {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/ProblemDocument"}}}

_METHODS = ("get", "put", "post", "patch", "delete", "head")


def build(app: FastAPI) -> dict[str, Any]:
    """Build the document once and keep it."""
    if app.openapi_schema is None:
        app.openapi_schema = _finished(
            get_openapi(title=TITLE, version=app.version, description=DESCRIPTION, routes=app.routes)
        )
    return app.openapi_schema


def _finished(document: dict[str, Any]) -> dict[str, Any]:
    components = document.setdefault("components", {})
    schemas = components.setdefault("schemas", {})
    for unused in ("HTTPValidationError", "ValidationError"):
        schemas.pop(unused, None)
    _, ours = msgspec.json.schema_components([*EXPOSED, ProblemDocument], ref_template="#/components/schemas/{name}")
    schemas.update(ours)
    components["securitySchemes"] = {
        "token": {"type": "http", "scheme": "bearer", "description": "An API token from your account page"}
    }
    for path in document["paths"].values():
        for method in _METHODS:
            if method in path:
                _finish_operation(path[method])
    return document


def _finish_operation(operation: dict[str, Any]) -> None:
    responses = operation["responses"]
    unforeseen = {"description": "Something unforeseen happened.", "content": _PROBLEM}
    # FastAPI announces its own validation answer wherever there are parameters; ours is a problem document.
    if "application/json" in responses.get("422", {}).get("content", {}):
        documented = responses["422"]["content"].get(MEDIA_TYPE)
        description = responses["422"]["description"] if documented else "Values of the request cannot be used."
        content = {MEDIA_TYPE: documented} if documented else _PROBLEM
        responses["422"] = {"description": description, "content": content}
    # Every address refuses parameters it does not have (server/api/parameters.py).
    responses.setdefault("422", {"description": "Values of the request cannot be used.", "content": _PROBLEM})
    operation["security"] = [{"token": []}, {}]
    responses.setdefault("500", unforeseen)
    away = {
        "description": "A service behind the server does not answer; asking again later helps.",
        "content": _PROBLEM,
    }
    responses.setdefault("503", away)
