"""Commands that end what was given: memberships, tokens, places on a leaderboard."""

from pathlib import Path
from typing import Any

import pytest

from server import accounts
from server.admin.main import main
from server.errors import NotAuthenticated
from server.services import Services
from tests.unit.admin.test_commands import Admin, _populate, admin, data_dir, services

__all__ = ["admin", "data_dir", "services"]


def _refused(data_dir: Path, *arguments: str) -> int:
    return main([*arguments, "--data-dir", str(data_dir)])


def test_a_removed_member_acts_for_the_team_no_more(
    admin: Admin, services: Services, data_dir: Path, tmp_path: Path
) -> None:
    """Taking a user out of a team ends the user's tokens for it; a second time there is nobody to take out."""
    _populate(admin, tmp_path)
    secret = admin("create-token", "ann@example.org", "lab")["token"]
    assert admin("remove-member", "lab", "ann@example.org") == {"team": "lab", "email": "ann@example.org"}
    with services.snapshot() as session, pytest.raises(NotAuthenticated):
        accounts.authenticate_token(session, secret)
    assert _refused(data_dir, "remove-member", "lab", "ann@example.org") == 1
    services.close()


def test_tokens_are_listed_and_revoked(admin: Admin, services: Services, data_dir: Path, tmp_path: Path) -> None:
    """A maintainer sees a user's tokens without their secrets, and ends one by its id."""
    _populate(admin, tmp_path)
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
    assert _refused(data_dir, "revoke-token", "999") == 1
    services.close()
