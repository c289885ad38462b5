"""Numbers on the command line: what cannot be is wrong usage, and one thing is not several."""

import socket

import pytest
from rich.console import Console

from server.admin import demo
from server.admin.command import counted
from tests.unit.admin.filled import Admin, Refused, Says


@pytest.mark.parametrize(
    "command",
    [
        "serve --port 70000",
        "serve --port 0",
        "serve --port -1",
        "serve --port eighty",
        "demo --port 65536",
        "worker --concurrency 0",
        "worker --concurrency -2",
        "create-token ann@example.org lab --days 0",
        "create-token ann@example.org lab --days -3",
        "create-token ann@example.org lab --days 99999999",
        "revoke-token 0",
        "revoke-token 99999999999999999999",
        "grant cs3d test lab 0 --reason r",
        "grant cs3d test lab 99999999999999999999 --reason r",
        "rescore start cs3d test --version 0",
        "rescore start cs3d test --version 99999999999999999999",
        "audit --limit 0",
    ],
)
def test_numbers_out_of_range_are_wrong_usage(refused: Refused, command: str) -> None:
    """Before anything is opened: status 2, and the message says what may be given."""
    status, said = refused(*command.split())
    assert (status, "is not a whole number from 1 to " in said) == (2, True), said


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--submissions-per-day", "-1"], "submissions_per_day must be from 0 to 1000000"),
        (["--submissions-per-day", "99999999999999999999"], "submissions_per_day must be from 0 to 1000000"),
        (["--rejections-per-day", "0"], "rejections_per_day must be from 1 to 1000000"),
        (["--max-attempts", "0"], "max_attempts must be from 1 to 1000000"),
        (["--shards", "99999999999999999999"], "shards must be from 1"),
    ],
)
def test_rules_out_of_range_are_refused(admin: Admin, refused: Refused, options: list[str], said: str) -> None:
    """A phase that could not be is not created."""
    admin("create-benchmark", "cs3d", "--title", "Cityscapes 3D")
    status, message = refused("create-phase", "cs3d", "test", "--title", "Test", *options)
    assert (status, said in message) == (1, True), message
    assert admin("list-phases") == {"phases": []}


def test_the_demo_looks_no_further_than_the_last_port() -> None:
    """With port 65535 taken it takes any free one."""
    with socket.socket() as taken:
        taken.bind((demo.HOST, 65535))
        taken.listen()
        assert 0 < demo._free_port(65535, Console(quiet=True)) < 65535


def test_one_is_not_many(admin: Admin, says: Says) -> None:
    """A team has 0 members, 1 member or 2 members."""
    for name in ("ann", "bob"):
        admin("create-user", f"{name}@example.org", "--name", name)
    ann, bob = ["--member", "ann@example.org"], ["--member", "bob@example.org"]
    assert says("create-team", "none", "--name", "N") == "Created team none with 0 members.\n"
    assert says("create-team", "one", "--name", "N", *ann) == "Created team one with 1 member.\n"
    assert says("create-team", "two", "--name", "N", *ann, *bob) == "Created team two with 2 members.\n"
    assert [counted(number, "box", "boxes") for number in (1, 2)] == ["1 box", "2 boxes"]
