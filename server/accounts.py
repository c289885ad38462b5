"""Users, teams and tokens: who may act, and how they prove who they are."""

import hashlib
import re
import secrets
from datetime import datetime
from urllib.parse import urlsplit

import sqlalchemy as sa
from sqlalchemy.orm import Session, joinedload, selectinload

from server import audit, database, passwords
from server.errors import Conflict, Forbidden, InvalidField, NotAuthenticated, NotFound
from server.models import Membership, Team, Token, User

SECRET_PREFIX = "cs3d_"  # noqa: S105 - the public beginning of every token, so that leaked ones can be found
SLUG = re.compile(r"[a-z0-9](?:[a-z0-9._\-]{0,62}[a-z0-9])?")
"""Forms have it as their pattern, too; browsers want the hyphen escaped."""

MAX_URL_CHARACTERS = 500


def checked_slug(field: str, slug: str) -> str:
    """Return `slug` if it can stand in a URL.

    Raises:
        InvalidField: It cannot.
    """
    if not SLUG.fullmatch(slug):
        message = (
            f"{field} {slug[:80]!r} cannot be used: give 1 to 64 lower-case letters, digits, dots, hyphens or"
            " underscores, the first and the last a letter or a digit"
        )
        raise InvalidField(message)
    return slug


def checked_text(field: str, text: str, *, max_length: int) -> str:
    """Return `text` without space at its ends if it has 1 to `max_length` printable characters.

    Raises:
        InvalidField: It has not.
    """
    text = text.strip()
    if not 1 <= len(text) <= max_length or not text.isprintable():
        message = f"{field} must have 1 to {max_length} printable characters"
        raise InvalidField(message)
    return text


def checked_url(field: str, url: str) -> str:
    """Return `url` without space at its ends if it can stand in a link to another site: no script, no place of ours.

    Raises:
        InvalidField: It cannot.
    """
    url = url.strip()
    try:
        parts = urlsplit(url)
        usable = parts.scheme in ("http", "https") and bool(parts.hostname)
    except ValueError:
        usable = False
    if not usable or not url.isprintable() or " " in url or len(url) > MAX_URL_CHARACTERS:
        message = f"{field} must be an address like https://example.org, of {MAX_URL_CHARACTERS} characters at most"
        raise InvalidField(message)
    return url


def create_user(
    session: Session, *, email: str, name: str, password_hash: str | None, is_maintainer: bool = False, actor: str
) -> User:
    """Create an account with a password of which this is the hash (`passwords.hashed`, before the transaction).

    Raises:
        InvalidField: The address cannot be used.
        Conflict: There is an account with this address.
    """
    email = checked_text("email", email, max_length=254).lower()
    if not re.fullmatch(r"[^@\s]+@[^@\s]+", email):
        message = f"email {email!r} is not an address; give one like name@example.org"
        raise InvalidField(message)
    if session.scalar(sa.select(User.id).where(User.email == email)):
        message = f"there is an account for {email}; log in with it or use another address"
        raise Conflict(message)
    user = User(
        email=email,
        name=checked_text("name", name, max_length=200),
        password_hash=password_hash,
        is_maintainer=is_maintainer,
        created_at=database.now(session),
    )
    session.add(user)
    session.flush()
    audit.record(session, actor=actor, action="user.created", subject=audit.subject_of(user), maintainer=is_maintainer)
    return user


def set_password(session: Session, user: User, password_hash: str, *, actor: str) -> None:
    """Replace a user's password by one of which this is the hash (`passwords.hashed`, before the transaction).

    Raises:
        Conflict: The user is disabled.
    """
    _require_access(user)
    user.password_hash = password_hash
    audit.record(session, actor=actor, action="user.password_set", subject=audit.subject_of(user))


def disable_user(session: Session, user: User, *, actor: str) -> None:
    """End a user's access until `enable_user`; nothing happens when it has ended already."""
    if user.disabled_at is None:
        user.disabled_at = database.now(session)
        audit.record(session, actor=actor, action="user.disabled", subject=audit.subject_of(user))


def enable_user(session: Session, user: User, *, actor: str) -> None:
    """Give a disabled user access again; nothing happens when the user has it.

    The password and the tokens of before work again, login sessions of before do not.
    """
    if user.disabled_at is not None:
        user.disabled_at = None
        user.session_version += 1
        audit.record(session, actor=actor, action="user.enabled", subject=audit.subject_of(user))


def _require_access(user: User) -> None:
    if user.disabled_at is not None:
        message = f"{user.email} is disabled; run `cs3d-admin enable-user {user.email}` first"
        raise Conflict(message)


def end_sessions(session: Session, user: User, *, actor: str) -> None:
    """End every login session of a user, whoever holds its cookie. Tokens stay."""
    user.session_version += 1
    audit.record(session, actor=actor, action="user.logged_out", subject=audit.subject_of(user))


def create_team(session: Session, *, slug: str, name: str, members: list[User], actor: str) -> Team:
    """Create a team with its first members.

    Raises:
        Conflict: The slug is taken.
    """
    slug = checked_slug("team", slug)
    if session.scalar(sa.select(Team.id).where(Team.slug == slug)):
        message = f"there is a team {slug!r}; choose another name"
        raise Conflict(message)
    team = Team(slug=slug, name=checked_text("name", name, max_length=200), created_at=database.now(session))
    session.add(team)
    session.flush()
    audit.record(session, actor=actor, action="team.created", subject=audit.subject_of(team), slug=slug)
    for user in members:
        add_member(session, team, user, actor=actor)
    return team


def add_member(session: Session, team: Team, user: User, *, actor: str) -> None:
    """Put a user into a team; nothing happens when the user is in it."""
    if session.get(Membership, (team.id, user.id)):
        return
    session.add(Membership(team_id=team.id, user_id=user.id, created_at=database.now(session)))
    session.flush()
    audit.record(session, actor=actor, action="team.joined", subject=audit.subject_of(team), user=user.id)


def remove_member(session: Session, team: Team, user: User, *, actor: str) -> None:
    """Take a user out of a team; what the user sent for it stays, tokens for it no longer work.

    Raises:
        NotFound: The user is not in the team.
    """
    membership = session.get(Membership, (team.id, user.id))
    if membership is None:
        message = f"{user.email} is not in team {team.slug}"
        raise NotFound(message)
    session.delete(membership)
    session.flush()
    audit.record(session, actor=actor, action="team.left", subject=audit.subject_of(team), user=user.id)


def is_member(session: Session, *, team_id: int, user_id: int) -> bool:
    """Say whether the user is in the team."""
    return session.get(Membership, (team_id, user_id)) is not None


def teams_of(session: Session, user: User) -> list[Team]:
    """List a user's teams by name."""
    return list(
        session.scalars(sa.select(Team).join(Membership).where(Membership.user_id == user.id).order_by(Team.name))
    )


def create_token(
    session: Session, *, user: User, team: Team, name: str, expires_at: datetime | None, actor: str
) -> tuple[Token, str]:
    """Create an API token.

    Returns:
        The row and the secret. The secret is shown now or never: only its SHA-256 is kept.

    Raises:
        Forbidden: The user is not in the team.
        Conflict: The user is disabled.
    """
    _require_access(user)
    if not is_member(session, team_id=team.id, user_id=user.id):
        message = f"{user.email} is not in team {team.slug}; a maintainer can add members"
        raise Forbidden(message)
    secret = SECRET_PREFIX + secrets.token_urlsafe(32)
    token = Token(
        user=user,
        team=team,
        name=checked_text("name", name, max_length=200),
        secret_sha256=_digest(secret),
        created_at=database.now(session),
        expires_at=expires_at,
    )
    session.add(token)
    session.flush()
    audit.record(session, actor=actor, action="token.created", subject=audit.subject_of(token), user=user.id)
    return token, secret


def revoke_token(session: Session, token: Token, *, actor: str) -> None:
    """End a token; nothing happens when it was ended before."""
    if token.revoked_at is None:
        token.revoked_at = database.now(session)
        audit.record(session, actor=actor, action="token.revoked", subject=audit.subject_of(token))


def tokens_of(session: Session, user: User) -> list[Token]:
    """List a user's tokens that were not revoked, latest first, with their teams."""
    query = sa.select(Token).where(Token.user_id == user.id, Token.revoked_at.is_(None))
    return list(session.scalars(query.options(joinedload(Token.team)).order_by(Token.id.desc())))


def defects_of(session: Session, user: User) -> dict[int, str | None]:
    """Say of every token in `tokens_of` why it does not work; None: it does."""
    at, teams = database.now(session), {team.id for team in teams_of(session, user)}
    return {
        token.id: _defect(
            token,
            is_over=token.expires_at is not None and token.expires_at <= at,
            is_in_team=token.team_id in teams,
        )
        for token in tokens_of(session, user)
    }


def _defect(token: Token, *, is_over: bool, is_in_team: bool) -> str | None:
    """Give the first reason why a token does not work."""
    reasons = {
        "revoked": token.revoked_at is not None,
        "user disabled": token.user.disabled_at is not None,
        "expired": is_over,
        "user not in team": not is_in_team,
    }
    return next((reason for reason, holds in reasons.items() if holds), None)


def find_token(session: Session, token_id: int) -> Token:
    """Find a token by its id.

    Raises:
        NotFound: There is none.
    """
    token = session.get(Token, token_id)
    if token is None:
        message = f"there is no token {token_id}; `cs3d-admin list-tokens EMAIL` lists a user's"
        raise NotFound(message)
    return token


def authenticate_token(session: Session, secret: str) -> Token:
    """Find who a bearer token stands for.

    Raises:
        NotAuthenticated: The token is unknown, expired or revoked, or its user is disabled or left the team.
    """
    token = session.scalar(sa.select(Token).where(Token.secret_sha256 == _digest(secret)))
    if token is None or not _usable(session, token):
        message = "the token is unknown, expired or revoked; create a new one on your account page"
        raise NotAuthenticated(message)
    return token


def _usable(session: Session, token: Token) -> bool:
    is_over = token.expires_at is not None and token.expires_at <= database.now(session)
    is_in_team = is_member(session, team_id=token.team_id, user_id=token.user_id)
    return _defect(token, is_over=is_over, is_in_team=is_in_team) is None


def authenticate_password(session: Session, email: str, password: str) -> User:
    """Find the user with this address and password. Takes about 0.3 s: keep it off the event loop.

    Raises:
        NotAuthenticated: There is no such user, the password is wrong or the account is disabled.
        Unavailable: Too many passwords are being checked.
    """
    user = session.scalar(sa.select(User).where(User.email == email.strip().lower()))
    is_right = passwords.is_right(password, user.password_hash if user else None)
    if user is None or not is_right or user.disabled_at is not None:
        message = "e-mail address or password is wrong; a maintainer can set a new password"
        raise NotAuthenticated(message)
    return user


def find_user(session: Session, email: str) -> User:
    """Find a user by e-mail address.

    Raises:
        NotFound: There is none.
    """
    user = session.scalar(sa.select(User).where(User.email == email.strip().lower()))
    if user is None:
        message = f"there is no user {email!r}; create it with `cs3d-admin create-user`"
        raise NotFound(message)
    return user


def list_users(session: Session) -> list[User]:
    """List every user with their teams, by e-mail address."""
    teams = selectinload(User.memberships).joinedload(Membership.team)
    return list(session.scalars(sa.select(User).options(teams).order_by(User.email)))


def list_teams(session: Session) -> list[Team]:
    """List every team with its members, by slug."""
    members = selectinload(Team.memberships).joinedload(Membership.user)
    return list(session.scalars(sa.select(Team).options(members).order_by(Team.slug)))


def find_team(session: Session, slug: str) -> Team:
    """Find a team by its slug.

    Raises:
        NotFound: There is none.
    """
    team = session.scalar(sa.select(Team).where(Team.slug == slug))
    if team is None:
        message = f"there is no team {slug!r}; create it with `cs3d-admin create-team`"
        raise NotFound(message)
    return team


def _digest(secret: str) -> str:
    return hashlib.sha256(secret.encode("utf-8", "surrogatepass")).hexdigest()
