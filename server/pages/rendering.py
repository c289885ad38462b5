"""Templates: one Jinja environment, one way to answer with a page."""

import hashlib
from functools import cache
from pathlib import Path
from typing import Any

import jinja2
from starlette.requests import Request
from starlette.responses import HTMLResponse

from server.api.identity import LoginSession
from server.models import User
from server.pages.formatting import FILTERS

Context = dict[str, Any]
"""What a template shows, by name."""


def template_folder() -> Path:
    """Find the templates: inside the installed package, else beside it in the source tree."""
    package = Path(__file__).parent.parent
    candidates = (package / "templates", package.parent / "templates")
    return next(folder for folder in candidates if (folder / "base.html").is_file())


@cache
def environment() -> jinja2.Environment:
    """Open the templates: escaping everywhere, and a name that is not there is an error."""
    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(template_folder()),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters.update(FILTERS)
    made.globals["static"] = static_address
    return made


@cache
def static_address(name: str) -> str:
    """Give the address of a static file with its digest, so that browsers may keep it for ever."""
    digest = hashlib.sha256((template_folder() / "static" / name).read_bytes()).hexdigest()[:12]
    return f"/static/{name}?v={digest}"


def html(
    request: Request,
    template: str,
    *,
    user: User | None,
    login: LoginSession | None,
    status: int = 200,
    **context: Any,  # noqa: ANN401 - templates take anything
) -> HTMLResponse:
    """Render a page for its visitor."""
    text = (
        environment()
        .get_template(template)
        .render(path=request.url.path, user=user, csrf=login.csrf if login else "", **context)
    )
    return HTMLResponse(text, status, {"Cache-Control": "private, no-cache", "Vary": "Cookie"})
