"""A visitor's request for a page: who they are, the form they sent, and the transaction around both."""

from collections.abc import Callable
from typing import Annotated
from urllib.parse import parse_qsl

from fastapi import Depends
from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from server.api.edge import Web, web_of
from server.api.errors import CsrfFailed, UnsupportedMediaType, UploadTooLarge
from server.api.identity import Identity, LoginSession, check_csrf, cookie_name
from server.models import User
from server.pages.rendering import Context, html

MAX_FORM_BYTES = 64 << 10

Fields = dict[str, str]


class Visit:
    """One request of a browser."""

    def __init__(self, request: Request) -> None:
        """Read the session cookie; nothing is asked of the database yet."""
        self.request = request
        self.web: Web = web_of(request)
        self.login: LoginSession | None = self.web.identities.read_cookie(request.cookies.get(cookie_name(request)))

    def show(self, template: str, work: Callable[[Session, User | None], Context]) -> Response:
        """Answer with a page, reading and rendering in one snapshot. Blocks."""
        with self.web.services.snapshot() as session:
            user = self.web.identities.user_of(session, self.login)
            return html(self.request, template, user=user, login=self.login, **work(session, user))

    @property
    def address(self) -> str:
        """Tell where the request comes from; empty where that is unknown."""
        return self.request.client.host if self.request.client else ""

    def show_own(self, template: str, work: Callable[[Session, User], Context], *, status: int = 200) -> Response:
        """Answer with a page for somebody logged in; others go to the login first. Blocks."""
        with self.web.services.snapshot() as session:
            user = self.web.identities.user_of(session, self.login)
            if user is None:
                return see_other(f"/login?next={self.request.url.path}" if self.request.method == "GET" else "/login")
            return html(self.request, template, user=user, login=self.login, status=status, **work(session, user))

    def act(self, fields: Fields, work: Callable[[Session, Identity], str]) -> Response:
        """Change something for somebody logged in, then go to the page that `work` names. Blocks.

        Raises:
            CsrfFailed: The form was not sent from a page of ours.
        """
        self.check_form(fields)
        with self.web.services.transaction() as session:
            user = self.web.identities.user_of(session, self.login)
            if user is None:
                return see_other("/login")
            return see_other(work(session, Identity(user, None)))

    def check_form(self, fields: Fields) -> None:
        """Raise CsrfFailed unless the form was sent from a page of ours."""
        # Browsers say where a request comes from; a missing header is an old browser, which the token still holds.
        if self.request.headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none"):
            raise CsrfFailed
        check_csrf(self.login, fields.get("csrf"))


VisitDependency = Annotated[Visit, Depends(Visit)]


async def read_fields(request: Request) -> Fields:
    """Read a small urlencoded form.

    Raises:
        UnsupportedMediaType: It is another kind of body.
        UploadTooLarge: It is larger than a form of ours can be.
    """
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != "application/x-www-form-urlencoded":
        raise UnsupportedMediaType("Send the form as application/x-www-form-urlencoded.")
    body = bytearray()
    async for chunk in request.stream():
        body += chunk
        if len(body) > MAX_FORM_BYTES:
            raise UploadTooLarge(MAX_FORM_BYTES)
    return dict(parse_qsl(body.decode("utf-8", "replace"), keep_blank_values=True))


FieldsDependency = Annotated[Fields, Depends(read_fields)]


def see_other(address: str) -> RedirectResponse:
    """Send the browser to another page of ours by GET."""
    return RedirectResponse(address, 303)


def local_address(address: str) -> str:
    """Keep an address for a redirect only if it is a path on this server."""
    safe = address.startswith("/") and not address.startswith(("//", "/\\"))
    return address if safe and address.isprintable() else "/"
