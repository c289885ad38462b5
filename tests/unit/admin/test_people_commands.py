"""Commands about users, teams and tokens: what is given, and what ends it."""

import io
from typing import Any

import pytest
import sqlalchemy as sa

from server import accounts, audit
from server.api.identity import Identities
from server.errors import NotAuthenticated
from server.services import Services
from tests.unit.admin.filled import Admin, Refused, Says, populate


def test_a_removed_member_acts_for_the_team_no_more(admin: Admin, services: Services, refused: Refused) -> None:
    """Taking a user out of a team ends the user's tokens for it; a second time there is nobody to take out."""
    populate(admin)
    secret = admin("create-token", "ann@example.org", "lab")["token"]
    assert admin("remove-member", "lab", "ann@example.org") == {"team": "lab", "email": "ann@example.org"}
    with services.snapshot() as session, pytest.raises(NotAuthenticated):
        accounts.authenticate_token(session, secret)
    assert refused("remove-member", "lab", "ann@example.org")[0] == 1


def test_tokens_are_listed_and_revoked(admin: Admin, services: Services, refused: Refused) -> None:
    """A maintainer sees a user's tokens without their secrets, and ends one by its id."""
    populate(admin)
    made: list[dict[str, Any]] = [
        admin("create-token", "ann@example.org", "lab", "--name", name) for name in ("laptop", "cluster")
    ]
    listed = admin("list-tokens", "ann@example.org")["tokens"]
    assert [(one["id"], one["name"], one["team"], one["expires"]) for one in listed] == [
        (made[1]["id"], "cluster", "lab", "never"),
        (made[0]["id"], "laptop", "lab", "never"),
    ]
    admin("revoke-token", str(made[0]["id"]))
    with services.snapshot() as session:
        with pytest.raises(NotAuthenticated):
            accounts.authenticate_token(session, made[0]["token"])
        assert accounts.authenticate_token(session, made[1]["token"]).name == "cluster"
    assert [one["name"] for one in admin("list-tokens", "ann@example.org")["tokens"]] == ["cluster"]
    assert refused("revoke-token", "999")[0] == 1


def test_a_generated_password_is_shown_once_and_works(admin: Admin, services: Services) -> None:
    """`create-user` prints a password with which the user can log in."""
    created = admin("create-user", "Ann@Example.org", "--name", "Ann", "--maintainer")
    with services.transaction() as session:
        user = accounts.authenticate_password(session, "ann@example.org", created["password"])
        assert user.is_maintainer


def test_a_password_may_come_from_standard_input(
    admin: Admin, services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With --password-stdin the first line is the password, and it is not printed."""
    monkeypatch.setattr("sys.stdin", io.StringIO("a long password\n"))
    created = admin("create-user", "ann@example.org", "--name", "Ann", "--password-stdin")
    assert "password" not in created
    with services.transaction() as session:
        assert accounts.authenticate_password(session, "ann@example.org", "a long password").name == "Ann"


def test_tokens_act_for_a_team(admin: Admin, services: Services) -> None:
    """A token works for the team it was made for, and only members get one."""
    admin("create-user", "ann@example.org", "--name", "Ann")
    admin("create-team", "lab", "--name", "The Lab")
    admin("add-member", "lab", "ann@example.org")
    created = admin("create-token", "ann@example.org", "lab", "--days", "30")
    with services.transaction() as session:
        token = accounts.authenticate_token(session, created["token"])
        assert (token.user.email, token.team.slug) == ("ann@example.org", "lab")
        assert token.expires_at is not None


def test_a_password_is_replaced_and_access_ended(admin: Admin, services: Services) -> None:
    """The new password logs in, the old one does not; a disabled user has neither password nor token."""
    old = admin("create-user", "ann@example.org", "--name", "Ann")["password"]
    admin("create-team", "lab", "--name", "The Lab", "--member", "ann@example.org")
    secret = admin("create-token", "ann@example.org", "lab")["token"]
    new = admin("set-password", "ann@example.org")["password"]
    with services.transaction() as session:
        assert accounts.authenticate_password(session, "ann@example.org", new).name == "Ann"
        with pytest.raises(NotAuthenticated):
            accounts.authenticate_password(session, "ann@example.org", old)
        assert accounts.authenticate_token(session, secret).name == "cs3d-admin"
    admin("disable-user", "ann@example.org")
    with services.transaction() as session:
        with pytest.raises(NotAuthenticated):
            accounts.authenticate_password(session, "ann@example.org", new)
        with pytest.raises(NotAuthenticated):
            accounts.authenticate_token(session, secret)


def test_a_disabled_user_is_enabled_again(admin: Admin, services: Services) -> None:
    """The password and tokens of before work again, a login session of before does not; both steps are in the trail."""
    populate(admin)
    password = admin("set-password", "ann@example.org")["password"]
    secret = admin("create-token", "ann@example.org", "lab")["token"]
    identities = Identities(services.settings)
    with services.snapshot() as session:
        old = identities.new_login(accounts.find_user(session, "ann@example.org"))
        assert identities.user_of(session, old) is not None
    admin("disable-user", "ann@example.org")
    enabled = admin("enable-user", "ann@example.org")
    assert enabled == {"email": "ann@example.org", "disabled": False, "was_disabled": True, "working_tokens": 1}
    with services.snapshot() as session:
        user = accounts.authenticate_password(session, "ann@example.org", password)
        assert accounts.authenticate_token(session, secret).user == user
        assert identities.user_of(session, old) is None
        assert identities.user_of(session, identities.new_login(user)) == user
        actions = [event.action for event in audit.trail(session, audit.subject_of(user))]
    assert actions == ["user.created", "user.password_set", "user.disabled", "user.enabled"]


def test_who_is_not_disabled_is_not_enabled(admin: Admin, says: Says, refused: Refused) -> None:
    """Nothing happens and nothing is written; an unknown user is refused."""
    admin("create-user", "ann@example.org", "--name", "Ann")
    assert says("enable-user", "ann@example.org") == "ann@example.org was not disabled; nothing was changed.\n"
    assert admin("audit", "--action", "user.enabled")["events"] == []
    assert refused("enable-user", "bob@example.org")[0] == 1


@pytest.mark.parametrize("command", ["set-password ann@example.org", "create-token ann@example.org lab"])
def test_a_disabled_user_is_given_nothing(admin: Admin, refused: Refused, command: str) -> None:
    """A password or token that could not work is refused, and the message names what helps."""
    populate(admin)
    admin("disable-user", "ann@example.org")
    assert refused(*command.split()) == (
        1,
        "cs3d-admin: ann@example.org is disabled; run `cs3d-admin enable-user ann@example.org` first\n",
    )
    assert [event["action"] for event in admin("audit", "--action", "token")["events"]] == []
    assert admin("audit", "--action", "user.password_set")["events"] == []
    admin("enable-user", "ann@example.org")
    admin(*command.split())


def test_tokens_that_do_not_work_are_marked(admin: Admin, services: Services, says: Says) -> None:
    """Expired, of a team that the user left, or of a disabled user: the list says which, and agrees with the server."""
    populate(admin)
    admin("create-team", "left", "--name", "Left", "--member", "ann@example.org")
    secrets = {
        name: admin("create-token", "ann@example.org", "lab", "--name", name)["token"] for name in ("good", "old")
    }
    secrets["left"] = admin("create-token", "ann@example.org", "left", "--name", "left")["token"]
    admin("remove-member", "left", "ann@example.org")
    with services.transaction() as session:
        session.execute(sa.text("UPDATE token SET expires_at = created_at WHERE name = 'old'"))

    def states() -> dict[str, str]:
        return {one["name"]: one["state"] for one in admin("list-tokens", "ann@example.org")["tokens"]}

    def works(secret: str) -> bool:
        with services.snapshot() as session:
            try:
                accounts.authenticate_token(session, secret)
            except NotAuthenticated:
                return False
        return True

    assert states() == {"good": "works", "old": "expired", "left": "user not in team"}
    assert {name: works(secret) for name, secret in secrets.items()} == {"good": True, "old": False, "left": False}
    admin("disable-user", "ann@example.org")
    assert set(states().values()) == {"user disabled"}
    assert "user disabled" in says("list-tokens", "ann@example.org")
