"""All pages of the application, and the static files."""

import os

from fastapi import FastAPI
from starlette.responses import FileResponse, Response
from starlette.staticfiles import PathLike, StaticFiles
from starlette.types import Scope

from server.pages import account, public, submission, upload
from server.pages.rendering import template_folder


class KeptFiles(StaticFiles):
    """Static files that browsers keep for ever: their address carries their digest."""

    def file_response(
        self, full_path: PathLike, stat_result: os.stat_result, scope: Scope, status_code: int = 200
    ) -> Response:
        """Allow keeping what was asked for by digest."""
        response = super().file_response(full_path, stat_result, scope, status_code)
        kept = b"v=" in scope.get("query_string", b"")
        response.headers["Cache-Control"] = "public, max-age=31536000, immutable" if kept else "no-cache"
        return response


def include(app: FastAPI) -> None:
    """Add the pages to an application."""
    for part in (public, upload, submission, account):
        app.include_router(part.router)
    app.mount("/static", KeptFiles(directory=template_folder() / "static"), name="static")

    @app.get("/favicon.ico", include_in_schema=False)
    def favicon() -> FileResponse:
        """Give the mark of the site to whoever asks without having read the page."""
        return FileResponse(template_folder() / "static" / "mark.svg", media_type="image/svg+xml")
