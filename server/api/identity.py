"""Who asks: a bearer token on the API, a signed session cookie on the pages.

The API takes the cookie too, so that our own pages can use it; whatever changes something then also needs the
session's CSRF token in a header, which another site cannot read or send.
"""

import hashlib
import hmac
import math
import secrets
import time
from dataclasses import dataclass
from http import HTTPMethod

import itsdangerous
from limits import RateLimitItemPerMinute
from limits.storage import MemoryStorage
from limits.strategies import MovingWindowRateLimiter
from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response

from server import accounts
from server.api.errors import CsrfFailed, MissingToken, TooManyRequests
from server.errors import NotAuthenticated
from server.models import Team, Token, User
from server.settings import Settings

SESSION_S = 14 * 24 * 3600
CSRF_HEADER = "x-csrf-token"
FAILURES_PER_MINUTE = RateLimitItemPerMinute(20)
"""Wrong tokens or passwords from one address."""

_SAFE = {HTTPMethod.GET, HTTPMethod.HEAD, HTTPMethod.OPTIONS}


@dataclass(frozen=True, slots=True)
class Credentials:
    """What a request says about its sender; nothing is believed yet."""

    token: str | None
    cookie: str | None
    csrf_header: str | None
    safe: bool
    """True for methods that change nothing."""
    address: str


@dataclass(frozen=True, slots=True)
class Identity:
    """Who asks, once believed."""

    user: User
    team: Team | None
    """The team a token acts for; None for a session, whose user chooses among their teams."""

    @property
    def actor(self) -> str:
        """Name in the audit trail."""
        return f"user:{self.user.id}"


@dataclass(frozen=True, slots=True)
class LoginSession:
    """The content of a session cookie; `user_id` is None before the login."""

    user_id: int | None
    csrf: str
    fingerprint: str = ""
    """Of the password hash and the version of the user's sessions: changing either ends every session."""


def credentials_of(request: Request) -> Credentials:
    """Read the credentials of a request.

    Raises:
        MissingToken: There is an Authorization header of another kind than Bearer.
    """
    header = request.headers.get("authorization")
    token = None
    if header is not None:
        kind, _, token = header.partition(" ")
        if kind.lower() != "bearer" or not token.strip():
            raise MissingToken
    return Credentials(
        token=token.strip() if token else None,
        cookie=request.cookies.get(cookie_name(request)),
        csrf_header=request.headers.get(CSRF_HEADER),
        safe=request.method in _SAFE,
        address=request.client.host if request.client else "",
    )


def cookie_name(request: Request) -> str:
    """Name the session cookie; over HTTPS with the prefix that binds it to this very host."""
    return "__Host-session" if request.url.scheme == "https" else "session"


class Identities:
    """Checks credentials and makes session cookies."""

    def __init__(self, settings: Settings) -> None:
        """Sign with the installation's key.

        Failures are counted in this process alone: several processes allow so many times more, which helps nobody
        against 256-bit tokens and argon2, and no request has to wait for a Redis that is down.
        """
        self._signer = itsdangerous.URLSafeTimedSerializer(settings.signing_key(), salt="cs3d-session")
        self._failures = MovingWindowRateLimiter(MemoryStorage())

    def identify(self, session: Session, credentials: Credentials) -> Identity | None:
        """Find out who asks; None for nobody.

        Raises:
            NotAuthenticated: The token is wrong, expired or revoked.
            CsrfFailed: A session wants to change something without its CSRF token.
            TooManyRequests: Too many wrong tokens came from this address.
        """
        if credentials.token is not None:
            token = self._check_token(session, credentials.token, credentials.address)
            return Identity(token.user, token.team)
        login = self.read_cookie(credentials.cookie)
        user = self.user_of(session, login)
        if login is None or user is None:
            return None
        if not credentials.safe:
            check_csrf(login, credentials.csrf_header)
        return Identity(user, None)

    def require(self, session: Session, credentials: Credentials) -> Identity:
        """Find out who asks, refusing nobody."""
        identity = self.identify(session, credentials)
        if identity is None:
            raise MissingToken
        return identity

    def user_of(self, session: Session, login: LoginSession | None) -> User | None:
        """Find the user of a session that is still good."""
        user = session.get(User, login.user_id) if login is not None and login.user_id is not None else None
        if login is None or user is None or user.disabled_at is not None:
            return None
        return user if hmac.compare_digest(login.fingerprint, _fingerprint(user)) else None

    def read_cookie(self, cookie: str | None) -> LoginSession | None:
        """Open a session cookie; None when it is missing, forged or too old."""
        try:
            user_id, csrf, fingerprint = self._signer.loads(cookie or "", max_age=SESSION_S)
        except (itsdangerous.BadSignature, ValueError, TypeError):
            return None
        return LoginSession(user_id, csrf, fingerprint)

    def new_login(self, user: User | None) -> LoginSession:
        """Begin a session, with a CSRF token of its own."""
        return LoginSession(user.id if user else None, secrets.token_urlsafe(24), _fingerprint(user) if user else "")

    def set_cookie(self, request: Request, response: Response, login: LoginSession) -> None:
        """Send the session cookie."""
        response.set_cookie(
            cookie_name(request),
            self._signer.dumps([login.user_id, login.csrf, login.fingerprint]),
            max_age=SESSION_S,
            secure=request.url.scheme == "https",
            httponly=True,
            samesite="lax",
        )

    def check_rate(self, purpose: str, address: str) -> None:
        """Refuse an address with too many failures behind it."""
        if not self._failures.test(FAILURES_PER_MINUTE, purpose, address):
            reset_s = self._failures.get_window_stats(FAILURES_PER_MINUTE, purpose, address).reset_time - time.time()
            raise TooManyRequests(retry_after_s=max(1, math.ceil(reset_s)))

    def count_failure(self, purpose: str, address: str) -> None:
        """Remember a failure of an address."""
        self._failures.hit(FAILURES_PER_MINUTE, purpose, address)

    def _check_token(self, session: Session, secret: str, address: str) -> Token:
        try:
            return accounts.authenticate_token(session, secret)
        except NotAuthenticated:
            # Only now: somebody else's wrong tokens from the same address (a proxy, a university) must not lock out a
            # good one.
            self.check_rate("token", address)
            self.count_failure("token", address)
            raise


def check_csrf(login: LoginSession | None, given: str | None) -> None:
    """Raise CsrfFailed unless the token given is the session's."""
    if login is None or not given or not hmac.compare_digest(login.csrf.encode(), given.encode()):
        raise CsrfFailed


def _fingerprint(user: User) -> str:
    return hashlib.sha256(f"{user.session_version}:{user.password_hash or ''}".encode()).hexdigest()[:16]
