"""Commands about users, teams and tokens."""

import argparse
import secrets
import sys
from datetime import UTC, datetime, timedelta

from server import accounts, passwords
from server.admin.command import Outcome, Subparsers, actor, add, counted, table, whole_number
from server.admin.listing import listing
from server.services import Services

MOST_DAYS = 36_500
"""A century."""


def add_commands(subparsers: Subparsers) -> None:
    """Add this module's commands."""
    user = add(subparsers, "create-user", create_user)
    user.add_argument("email")
    user.add_argument("--name", required=True, help="as shown to others")
    user.add_argument("--maintainer", action="store_true", help="may see and do everything")
    user.add_argument("--password-stdin", action="store_true", help="read the password from standard input")
    renewed = add(subparsers, "set-password", set_password)
    renewed.add_argument("email")
    renewed.add_argument("--password-stdin", action="store_true", help="read the password from standard input")
    disabled = add(subparsers, "disable-user", disable_user)
    disabled.add_argument("email")
    enabled = add(subparsers, "enable-user", enable_user)
    enabled.add_argument("email")
    add(subparsers, "list-users", list_users)
    team = add(subparsers, "create-team", create_team)
    team.add_argument("team", help="short name for addresses: letters, digits, hyphens")
    team.add_argument("--name", required=True, help="as shown on leaderboards")
    team.add_argument("--member", action="append", default=[], metavar="EMAIL", help="may be given several times")
    member = add(subparsers, "add-member", add_member)
    member.add_argument("team")
    member.add_argument("email")
    removed = add(subparsers, "remove-member", remove_member)
    removed.add_argument("team")
    removed.add_argument("email")
    add(subparsers, "list-teams", list_teams)
    token = add(subparsers, "create-token", create_token)
    token.add_argument("email", help="who it acts for")
    token.add_argument("team", help="for which of that user's teams")
    token.add_argument("--name", default="cs3d-admin", help="what it is for")
    days = whole_number(1, MOST_DAYS)
    token.add_argument("--days", type=days, metavar="N", help="ends after N days (default: never)")
    listed = add(subparsers, "list-tokens", list_tokens)
    listed.add_argument("email")
    revoked = add(subparsers, "revoke-token", revoke_token)
    revoked.add_argument("token", type=whole_number(1), metavar="ID", help="as list-tokens shows it")


def create_user(args: argparse.Namespace, services: Services) -> Outcome:
    """Create an account; without --password-stdin a password is generated and shown once."""
    password = _password(args)
    password_hash = passwords.hashed(password)
    with services.transaction() as session:
        user = accounts.create_user(
            session,
            email=args.email,
            name=args.name,
            password_hash=password_hash,
            is_maintainer=args.maintainer,
            actor=actor(),
        )
        data = {"id": user.id, "email": user.email, "name": user.name, "maintainer": user.is_maintainer}
    text = f"Created {'maintainer' if args.maintainer else 'user'} {args.email}."
    if not args.password_stdin:
        data["password"] = password
        text += f" Password, shown only now: {password}"
    return Outcome(data=data, text=text)


def set_password(args: argparse.Namespace, services: Services) -> Outcome:
    """Give a user another password; without --password-stdin it is generated and shown once."""
    password = _password(args)
    password_hash = passwords.hashed(password)
    with services.transaction() as session:
        accounts.set_password(session, accounts.find_user(session, args.email), password_hash, actor=actor())
    shown = {} if args.password_stdin else {"password": password}
    text = f"Password of {args.email} set." + "".join(f" Shown only now: {value}" for value in shown.values())
    return Outcome(data={"email": args.email, **shown}, text=text)


def disable_user(args: argparse.Namespace, services: Services) -> Outcome:
    """End a user's access: passwords, login sessions and tokens no longer work. Submissions stay."""
    with services.transaction() as session:
        accounts.disable_user(session, accounts.find_user(session, args.email), actor=actor())
    return Outcome(data={"email": args.email, "disabled": True}, text=f"{args.email} has no access any more.")


def enable_user(args: argparse.Namespace, services: Services) -> Outcome:
    """Give a disabled user access again: password and tokens work as before, login sessions stay ended."""
    with services.transaction() as session:
        user = accounts.find_user(session, args.email)
        was_disabled = user.disabled_at is not None
        accounts.enable_user(session, user, actor=actor())
        working = sum(defect is None for defect in accounts.defects_of(session, user).values())
    data = {"email": args.email, "disabled": False, "was_disabled": was_disabled, "working_tokens": working}
    text = f"{args.email} was not disabled; nothing was changed."
    if was_disabled:
        text = f"{args.email} has access again, with the password and {counted(working, 'token')} of before."
        text += f" In wrong hands? cs3d-admin set-password {args.email}, cs3d-admin list-tokens {args.email}"
    return Outcome(data=data, text=text)


def list_users(args: argparse.Namespace, services: Services) -> Outcome:
    """List every user with their teams."""
    del args
    with services.snapshot() as session:
        rows = [
            {
                "id": user.id,
                "email": user.email,
                "name": user.name,
                "teams": sorted(membership.team.slug for membership in user.memberships),
                "maintainer": user.is_maintainer,
                "created_at": user.created_at,
                "disabled_at": user.disabled_at,
            }
            for user in accounts.list_users(session)
        ]
    return listing("users", rows)


def _password(args: argparse.Namespace) -> str:
    """Read or generate a password."""
    return sys.stdin.readline().rstrip("\n") if args.password_stdin else secrets.token_urlsafe(12)


def create_team(args: argparse.Namespace, services: Services) -> Outcome:
    """Create a team with its members."""
    with services.transaction() as session:
        members = [accounts.find_user(session, email) for email in args.member]
        team = accounts.create_team(session, slug=args.team, name=args.name, members=members, actor=actor())
        data = {"id": team.id, "team": team.slug, "name": team.name, "members": [user.email for user in members]}
    return Outcome(data=data, text=f"Created team {args.team} with {counted(len(members), 'member')}.")


def add_member(args: argparse.Namespace, services: Services) -> Outcome:
    """Put a user into a team."""
    with services.transaction() as session:
        team, user = accounts.find_team(session, args.team), accounts.find_user(session, args.email)
        accounts.add_member(session, team, user, actor=actor())
        data = {"team": team.slug, "email": user.email}
    return Outcome(data=data, text=f"{args.email} is in team {args.team}.")


def remove_member(args: argparse.Namespace, services: Services) -> Outcome:
    """Take a user out of a team; what was sent for it stays, tokens for it no longer work."""
    with services.transaction() as session:
        team, user = accounts.find_team(session, args.team), accounts.find_user(session, args.email)
        accounts.remove_member(session, team, user, actor=actor())
    return Outcome(data={"team": args.team, "email": args.email}, text=f"{args.email} is not in team {args.team} now.")


def list_teams(args: argparse.Namespace, services: Services) -> Outcome:
    """List every team with its members."""
    del args
    with services.snapshot() as session:
        rows = [
            {
                "id": team.id,
                "team": team.slug,
                "name": team.name,
                "created_at": team.created_at,
                "members": sorted(membership.user.email for membership in team.memberships),
            }
            for team in accounts.list_teams(session)
        ]
    return listing("teams", rows)


def create_token(args: argparse.Namespace, services: Services) -> Outcome:
    """Create an API token of a user for a team; it is shown once."""
    expires_at = datetime.now(UTC) + timedelta(days=args.days) if args.days is not None else None
    with services.transaction() as session:
        token, secret = accounts.create_token(
            session,
            user=accounts.find_user(session, args.email),
            team=accounts.find_team(session, args.team),
            name=args.name,
            expires_at=expires_at,
            actor=actor(),
        )
        data = {"id": token.id, "token": secret, "expires_at": expires_at.isoformat() if expires_at else None}
    return Outcome(data=data, text=f"Token, shown only now: {secret}")


def list_tokens(args: argparse.Namespace, services: Services) -> Outcome:
    """List a user's API tokens that were not revoked, and which of them do not work; their secrets are not kept."""
    columns = ("id", "team", "name", "created", "expires", "state")
    with services.snapshot() as session:
        user = accounts.find_user(session, args.email)
        defects = accounts.defects_of(session, user)
        rows = [
            [
                token.id,
                token.team.slug,
                token.name,
                _day(token.created_at),
                _day(token.expires_at),
                defects[token.id] or "works",
            ]
            for token in accounts.tokens_of(session, user)
        ]
    data = {"tokens": [dict(zip(columns, row, strict=True)) for row in rows]}
    return Outcome(data=data, tables=[table(*columns, rows=rows)] if rows else [], text="" if rows else "No tokens.")


def _day(time: datetime | None) -> str:
    return time.date().isoformat() if time else "never"


def revoke_token(args: argparse.Namespace, services: Services) -> Outcome:
    """End an API token."""
    with services.transaction() as session:
        token = accounts.find_token(session, args.token)
        accounts.revoke_token(session, token, actor=actor())
        data = {"id": token.id, "email": token.user.email, "team": token.team.slug}
    return Outcome(data=data, text=f"Token {args.token} of {data['email']} no longer works.")
