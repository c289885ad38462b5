"""Log in and out; the account with its API tokens."""

from datetime import timedelta
from typing import Annotated

from fastapi import APIRouter, Path
from sqlalchemy.orm import Session
from starlette.responses import Response

from server import accounts, database, passwords
from server.api.identity import Identity
from server.errors import InvalidField, NotAuthenticated, NotFound
from server.models import Team, Token, User
from server.pages.rendering import Context, html
from server.pages.visits import FieldsDependency, Visit, VisitDependency, local_address, see_other

router = APIRouter(include_in_schema=False)

TOKEN_DAYS = (30, 90, 365)
"""Lifetimes offered for a new token."""


@router.get("/login")
def login_form(visit: VisitDependency) -> Response:
    """Show the form; it gets a session of its own, so that its CSRF token holds."""
    return _login_form(visit, next_=visit.request.query_params.get("next", "/"))


@router.post("/login")
def log_in(visit: VisitDependency, fields: FieldsDependency) -> Response:
    """Check the password (0.3 s, on a thread) and begin a session."""
    visit.check_form(fields)
    identities = visit.web.identities
    email = fields.get("email", "")
    identities.check_rate("login", visit.address)
    try:
        with visit.web.services.snapshot() as session:
            user = accounts.authenticate_password(session, email, fields.get("password", ""))
            login = identities.new_login(user)
    except NotAuthenticated as error:
        identities.count_failure("login", visit.address)
        return _login_form(visit, next_=fields.get("next", "/"), email=email, error=str(error), status=401)
    response = see_other(local_address(fields.get("next", "/")))
    identities.set_cookie(visit.request, response, login)
    return response


@router.post("/logout")
def log_out(visit: VisitDependency, fields: FieldsDependency) -> Response:
    """End the session and every other one of this user: a cookie that somebody copied ends with them."""
    visit.check_form(fields)
    with visit.web.services.transaction() as session:
        user = visit.web.identities.user_of(session, visit.login)
        if user is not None:
            accounts.end_sessions(session, user, actor=Identity(user, None).actor)
    response = see_other("/")
    visit.web.identities.set_cookie(visit.request, response, visit.web.identities.new_login(None))
    return response


@router.get("/account")
def account(visit: VisitDependency) -> Response:
    """Show the user's teams and tokens."""
    changed = visit.request.query_params.get("password") == "changed"
    return visit.show_own("account.html", lambda session, user: _account(session, user) | {"password_changed": changed})


@router.post("/account/password")
def change_password(visit: VisitDependency, fields: FieldsDependency) -> Response:
    """Replace the user's password, who must know the one of before; every other session ends."""
    visit.check_form(fields)
    identities = visit.web.identities
    identities.check_rate("login", visit.address)
    try:
        with visit.web.services.snapshot() as session:
            user = identities.user_of(session, visit.login)
            if user is None:
                return see_other("/login")
            accounts.authenticate_password(session, user.email, fields.get("current", ""))
        password_hash = passwords.hashed(fields.get("new", ""))
        with visit.web.services.transaction() as session:
            user = identities.user_of(session, visit.login)
            if user is None:
                return see_other("/login")
            accounts.set_password(session, user, password_hash, actor=Identity(user, None).actor)
            login = identities.new_login(user)
    except NotAuthenticated:
        identities.count_failure("login", visit.address)
        return _password_form(visit, "The current password is wrong.", 401)
    except InvalidField as error:
        return _password_form(visit, f"The new {error}.", 422)
    response = see_other("/account?password=changed")
    identities.set_cookie(visit.request, response, login)
    return response


@router.post("/account/tokens")
def make_token(visit: VisitDependency, fields: FieldsDependency) -> Response:
    """Make a token and show its secret, this once."""
    visit.check_form(fields)
    with visit.web.services.transaction() as session:
        user = visit.web.identities.user_of(session, visit.login)
        if user is None:
            return see_other("/login")
        _, secret = accounts.create_token(
            session,
            user=user,
            team=_own_team(session, user, fields.get("team", "")),
            name=fields.get("name", ""),
            expires_at=database.now(session) + timedelta(days=_days(fields.get("days", ""))),
            actor=Identity(user, None).actor,
        )
        session.flush()
        context = _account(session, user) | {"secret": secret}
        response = html(visit.request, "account.html", user=user, login=visit.login, status=201, **context)
        response.headers["Cache-Control"] = "no-store"
        return response


@router.post("/account/tokens/{token_id}/revoke")
def revoke_token(
    token_id: Annotated[int, Path(ge=1, lt=1 << 31)], visit: VisitDependency, fields: FieldsDependency
) -> Response:
    """End one of the user's tokens."""

    def work(session: Session, identity: Identity) -> str:
        token = session.get(Token, token_id)
        if token is None or token.user_id != identity.user.id:
            raise NotFound("you have no such token")
        accounts.revoke_token(session, token, actor=identity.actor)
        return "/account"

    return visit.act(fields, work)


def _login_form(visit: Visit, *, next_: str, email: str = "", error: str = "", status: int = 200) -> Response:
    login = visit.login or visit.web.identities.new_login(None)
    context = {"next": local_address(next_), "email": email, "error": error}
    response = html(visit.request, "login.html", user=None, login=login, status=status, **context)
    if visit.login is None:
        visit.web.identities.set_cookie(visit.request, response, login)
    return response


def _password_form(visit: Visit, error: str, status: int) -> Response:
    """Show the account with the reason why the password stays."""
    return visit.show_own(
        "account.html", lambda session, user: _account(session, user) | {"password_error": error}, status=status
    )


def _account(session: Session, user: User) -> Context:
    return {
        "teams": accounts.teams_of(session, user),
        "tokens": accounts.tokens_of(session, user),
        "days": TOKEN_DAYS,
        "secret": None,
        "password_error": "",
        "password_changed": False,
        "fewest_characters": passwords.FEWEST_CHARACTERS,
        "now": database.now(session),
    }


def _own_team(session: Session, user: User, slug: str) -> Team:
    found = next((team for team in accounts.teams_of(session, user) if team.slug == slug), None)
    if found is None:
        raise InvalidField("team: choose one of your teams")
    return found


def _days(text: str) -> int:
    days = next((days for days in TOKEN_DAYS if str(days) == text), None)
    if days is None:
        raise InvalidField(f"days: choose one of {', '.join(map(str, TOKEN_DAYS))}")
    return days
